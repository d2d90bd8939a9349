"""Commands on a Ray cluster of two nodes on this machine: the same files, whatever happens."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cluster_calls
import numpy as np
import pytest
import torch
from cluster_calls import count_others, die_on, fail, meet
from matplotlib.figure import Figure
from octoarm_agents.benchmark import cluster as benchmark
from octoarm_agents.common import workers
from octoarm_agents.common.trials import run_trials
from octoarm_agents.common.workers import Cluster, map_unordered
from octoarm_agents.comparison import Comparison, TestPlan, compare
from octoarm_agents.policies import load_policy
from octoarm_agents.policies.evaluation import JUDGED_EPISODES, JUDGING_SEED, evaluate_policy
from octoarm_agents.rl import Hyperparameters, Training
from octoarm_agents.rl.tuning import tune_algorithm

from octoarm_env import ArmParameters

ray = pytest.importorskip("ray", reason='a cluster needs pip install "octoarm-agents[ray]"')
cluster_utils = pytest.importorskip("ray.cluster_utils")
rllib = pytest.importorskip("octoarm_agents.rl.rllib")

pytestmark = [
    # Of Ray's own, as its processes end.
    pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning"),
    pytest.mark.filterwarnings("ignore:subprocess .* is still running:ResourceWarning"),
    # Of RLlib's own, in a process that builds a second algorithm.
    pytest.mark.filterwarnings("ignore:.*Overriding environment rllib-single:UserWarning"),
]

OF_THE_MACHINE = {"machine", "seconds", "training_seconds", "inference_us"}
"""What differs from run to run: times, and what they were taken on."""


@pytest.fixture(scope="module")
def nodes() -> Iterator[Any]:
    """Two nodes with a processor each; the first one is the head."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        # For the trials below; the packages themselves are installed on every node.
        patch.setenv("PYTHONPATH", str(Path(__file__).parent), prepend=os.pathsep)
        started = cluster_utils.Cluster(
            initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False}
        )
        try:
            started.add_node(num_cpus=1)
            yield started
        finally:
            ray.shutdown()
            started.shutdown()


@pytest.fixture
def cluster(nodes: Any) -> Cluster:
    return Cluster.connect(nodes.address)


def contents(folder: Path) -> dict[str, Any]:
    """All JSON files of a folder, but for what is of the machine."""

    def without(value: Any) -> Any:
        if isinstance(value, dict):
            kept = {key: each for key, each in value.items() if key not in OF_THE_MACHINE}
            return {key: without(each) for key, each in kept.items()}
        return [without(each) for each in value] if isinstance(value, list) else value

    files = sorted(folder.rglob("*.json*"))
    assert files
    return {
        file.relative_to(folder).as_posix(): [
            without(json.loads(line))
            for line in (
                file.read_text(encoding="utf-8").splitlines()
                if file.suffix == ".jsonl"
                else [file.read_text(encoding="utf-8")]
            )
        ]
        for file in files
    }


@pytest.mark.parametrize(
    "command",
    [
        ("reproduce", "table2", "--trials", 2),
        ("calibrate", "body", "--evaluations", 3, "--lift-sign", "+1", "--noise-seeds", 0),
        (
            *("analyse", "arm", "--sweep", "range", "--values", "20", "--samples", 400),
            *("--washout", 50, "--max-delay", 5, "--delays", "5,3"),
        ),
    ],
    ids=lambda command: command[0],
)
def test_files_are_equal_to_local_ones(
    command: tuple[object, ...],
    nodes: Any,
    octoarm: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Pictures are drawn from the files, here, wherever those come from.
    monkeypatch.setattr(Figure, "savefig", lambda figure, file, **_: Path(file).touch())
    where = {"local": ("--jobs", 1), "cluster": ("--cluster", nodes.address, "--jobs", 2)}
    for name, options in where.items():
        result = octoarm(*command, *options, "--out", tmp_path / name)
        assert result.exit_code == 0, result.output
    assert contents(tmp_path / "cluster") == contents(tmp_path / "local")


PLAN = TestPlan(episodes=1, steps=60, long_steps=100, after=80)


def test_a_comparison_is_equal_to_a_local_one(cluster: Cluster, tmp_path: Path) -> None:
    body = tmp_path / "body.json"
    ArmParameters().replace(arm_density=1042.0).to_json(body)
    folders = tmp_path / "local", tmp_path / "cluster"
    for jobs, out in zip((1, Cluster(1)), folders, strict=True):
        comparison = Comparison(
            agents=("readout_pinv", "ppo", "clock"),
            targets=("quadratic",),
            seeds=1,
            budget=0.002,
            plan=PLAN,
            jobs=jobs,
            env={"arm": str(body)},
        )
        compare(comparison, out, progress=False)
    local, spread = (contents(out / "results") for out in folders)
    assert spread == local
    assert len(local) == 3
    local, spread = (
        {name: content for name, content in contents(out).items() if "runs/" not in name}
        for out in folders
    )
    assert spread == local
    # The trainings have come along, whole.
    names = [
        sorted(path.relative_to(out).as_posix() for path in (out / "runs").rglob("*"))
        for out in folders
    ]
    assert names[0] == names[1]
    for agent in ("readout_pinv", "ppo"):
        weights = [
            np.load(out / "runs" / f"{agent}-quadratic-0" / "best.npz", allow_pickle=False)
            for out in folders
        ]
        for key in weights[0].files:
            if weights[0][key].dtype.kind == "f":
                np.testing.assert_array_equal(*(each[key] for each in weights))
    # What a training has left here goes along too: it is not trained again.
    kept = folders[1] / "results" / "ppo-quadratic-0.json"
    before = json.loads(kept.read_text(encoding="utf-8"))
    kept.unlink()
    compare(comparison, folders[1], progress=False)
    assert json.loads(kept.read_text(encoding="utf-8"))["training"] == before["training"]


def test_what_a_call_costs(
    nodes: Any, octoarm: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(benchmark, "STEPS", 10)
    out = tmp_path / "cluster.json"
    options = ("--cluster", nodes.address, "--seconds", 0.1, "--rounds", 1, "--out", out)
    result = octoarm("benchmark", *options)
    assert result.exit_code == 0, result.output
    content = json.loads(out.read_text(encoding="utf-8"))
    assert set(content["contenders"]) == set(benchmark.PLACES)
    for row in content["contenders"].values():
        assert row[benchmark.EMPTY]["min"] > 0
        assert row[benchmark.TRIAL]["min"] > 0
    assert set(content["ratios"]) == {"ray_beyond", "ray_over", "ray_scaling", "scaling"}


def test_a_killed_node_loses_nothing_and_doubles_nothing(
    nodes: Any, cluster: Cluster, tmp_path: Path
) -> None:
    node = nodes.add_node(num_cpus=1)
    log = tmp_path / "log"
    log.touch()
    trials = [{"trial": k, "doomed": node.node_id, "log": str(log)} for k in range(8)]

    def begun() -> list[list[str]]:
        return [line.split() for line in log.read_text(encoding="utf-8").splitlines()]

    def kill() -> None:
        while all(doomed == "0" for _, doomed in begun()):
            time.sleep(0.05)
        nodes.remove_node(node, allow_graceful=False)

    killer = threading.Thread(target=kill)
    killer.start()
    # A processor more than the nodes that stay have.
    results = run_trials(
        die_on, ArmParameters(), trials, folder=tmp_path / "trials", jobs=Cluster(cluster.jobs + 1)
    )
    killer.join()
    lost = {trial for trial, doomed in begun() if doomed == "1"}
    assert lost
    assert {trial for trial, doomed in begun() if doomed == "0"} == set("01234567")
    files = [json.loads(each.read_text("utf-8")) for each in (tmp_path / "trials").iterdir()]
    assert sorted(each["result"]["trial"] for each in files) == list(range(8))
    local = [{**each, "doomed": ""} for each in trials]
    assert results == run_trials(die_on, ArmParameters(), local, folder=tmp_path / "local", jobs=1)


def test_an_error_ends_the_other_calls(cluster: Cluster, tmp_path: Path) -> None:
    (tmp_path / "first").mkdir()
    calls = [(str(tmp_path / "first"), name) for name in ("waits", "fails")]
    with pytest.raises(ValueError, match=r"\Ano such luck\Z"):
        list(map_unordered(fail, calls, cluster))
    # Both processors are free again.
    (tmp_path / "second").mkdir()
    calls = [(str(tmp_path / "second"), name, 2) for name in "ab"]
    assert sorted(map_unordered(meet, calls, cluster)) == [(0, "a"), (1, "b")]


def test_no_more_calls_at_once_than_asked_for(cluster: Cluster, tmp_path: Path) -> None:
    calls = [(str(tmp_path), k) for k in range(4)]
    assert sorted(map_unordered(count_others, calls, Cluster(1))) == [(k, 0) for k in range(4)]


def test_a_node_with_other_packages_is_named(
    cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    installed = workers.installed()
    monkeypatch.setattr(workers, "installed", lambda: installed | {"numpy": "1.0"})
    with pytest.raises(RuntimeError, match=r"the node .* has other packages: .*instead of 1\.0"):
        list(map_unordered(abs, [(-1,)], cluster))


def test_an_interrupt_leaves_what_is_finished(nodes: Any, tmp_path: Path) -> None:
    folder = tmp_path / "trials"
    run = subprocess.Popen(
        [sys.executable, cluster_calls.__file__, str(folder), nodes.address],
        stderr=subprocess.PIPE,
        env=os.environ | {"RAY_USAGE_STATS_ENABLED": "0"},
        text=True,
    )
    while run.poll() is None and len(list(folder.glob("*.json"))) < 2:
        time.sleep(0.05)
    run.send_signal(signal.SIGINT)
    _, errors = run.communicate(timeout=120)
    assert run.returncode != 0
    assert errors.rstrip().endswith("KeyboardInterrupt")
    files = [json.loads(file.read_text(encoding="utf-8")) for file in folder.glob("*.json")]
    assert sorted(each["result"]["trial"] for each in files) == [0, 1]


def test_an_address_where_nothing_answers_is_named(
    nodes: Any, octoarm: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    for address, reason in (("127.0.0.1:1", "refused"), ("nonsense", "Invalid address")):
        result = octoarm("reproduce", "table2", "--cluster", address, "--out", tmp_path)
        assert result.exit_code == 2
        assert f"cluster = '{address}': no Ray cluster answers there" in result.output
        assert reason in result.output


def test_a_search_goes_on_here_and_there(nodes: Any, octoarm: Any, tmp_path: Path) -> None:
    # So few steps that nothing is learnt from them yet.
    command = ("tune", "sac", "--steps", 32, "--out", tmp_path)
    for first, trials, where in ((0, 1, ("--cluster", nodes.address)), (1, 2, ())):
        result = octoarm(*command, *where, "--trials", trials)
        assert result.exit_code == 0, result.output
        study = json.loads((tmp_path / "study.json").read_text("utf-8"))
        assert [each["number"] for each in study["trials"]] == list(range(trials))
        for trial in study["trials"]:
            told = f"trial {trial['number']}: {'given up' if trial['pruned'] else ''}"
            assert result.output.count(told) == (trial["number"] >= first)
    # What the file of today holds was tried first, and is worth there what it is worth here.
    here = tune_algorithm("sac", tmp_path / "here", trials=1, steps=32)
    for name in ("parameters", "value"):
        assert study["trials"][0][name] == here["trials"][0][name]
    assert study["trials"][0]["returns"] == pytest.approx(here["trials"][0]["returns"])


def test_rllib_trains_and_goes_on(
    nodes: Any, octoarm: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = ("train", "ppo", "--engine", "rllib", "--cluster", nodes.address)
    command = (*command, "--evaluations", 2, "--steps", 2048, "--out", tmp_path)

    start = rllib.Judge.start

    def stop(judge: Any) -> None:
        start(judge)
        if judge.curve:
            raise KeyboardInterrupt

    # After the first evaluation, and the checkpoint.
    monkeypatch.setattr(rllib.Judge, "start", stop)
    assert octoarm(*command, "--workers", 0).exit_code != 0
    monkeypatch.undo()
    assert not (tmp_path / "training.json").exists()
    # It goes on elsewhere: in a process that has not seen the environment yet.
    command = (*command, "--workers", 1)
    refused = octoarm(*command)
    assert refused.exit_code == 2
    assert "resume it" in refused.output
    assert octoarm(*command, "--resume").exit_code == 0
    training = json.loads((tmp_path / "training.json").read_text("utf-8"))
    assert [point["steps"] for point in training["curve"]] == [1024, 2048]
    best = (tmp_path / "best.npz").read_bytes()
    assert octoarm(*command, "--resume").exit_code == 0
    assert (tmp_path / "best.npz").read_bytes() == best
    (tmp_path / "rllib_checkpoint.pkl").write_bytes(b"rubbish")
    damaged = octoarm(*command, "--resume")
    assert damaged.exit_code == 2
    assert "is damaged" in damaged.output
    for name, point in (("best", training["best"]), ("final", training["final"])):
        policy = load_policy(tmp_path / f"{name}.npz")
        returns = evaluate_policy(policy, policy, episodes=JUDGED_EPISODES, seed=JUDGING_SEED)
        assert returns["return"] == point["return"]


def test_an_exported_network_acts_as_rllib_does(cluster: Cluster) -> None:
    config = rllib.ppo_config(Training.make("ppo", "lissajous", num_envs=2), workers=0)
    algorithm = config.build_algo()
    try:
        given = config.env_config
        lengths = given["mean"] + np.linspace(-12, 12, 240).reshape(3, 80) / given["scale"]
        seen = np.clip((lengths - given["mean"]) * given["scale"], -10, 10)
        outputs = algorithm.get_module().forward_inference(
            {"obs": torch.as_tensor(seen, dtype=torch.float32)}
        )
        expected = outputs["action_dist_inputs"][:, :2].numpy()
        actions, _ = rllib.export_network(algorithm).actions(lengths, None)
        assert np.abs(expected).max() > 0.05
        np.testing.assert_allclose(actions, np.clip(expected, -1, 1), atol=1e-5)
    finally:
        algorithm.stop()


NAMED = replace(Hyperparameters.load("ppo"), arguments={"use_sde": True})


@pytest.mark.parametrize("resume", [False, True])
def test_rllib_leaves_another_engine_s_training_alone(tmp_path: Path, resume: bool) -> None:
    (tmp_path / "checkpoint.zip").touch()
    with pytest.raises(ValueError, match="holds a training by sb3: choose another folder"):
        rllib.train(Training.make("ppo", "quadratic"), tmp_path, resume=resume)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"algorithm": "sac"}, "algorithm = 'sac': with RLlib expected 'ppo'"),
        ({"hyperparameters": NAMED}, "further hyper-parameters = {'use_sde': True}"),
        ({"num_envs": 3}, "num_envs = 3: expected a multiple of 2"),
    ],
)
def test_what_rllib_cannot_do_is_refused(more: dict[str, Any], message: str) -> None:
    training = Training.make(**{"algorithm": "ppo", "target": "quadratic"} | more)
    with pytest.raises(ValueError, match=message):
        rllib.ppo_config(training, workers=2)
