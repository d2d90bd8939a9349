"""Training: reproducible, resumable after a kill, and kept as what was trained."""

from __future__ import annotations

import functools
import json
import multiprocessing
import os
import pickle
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
import yaml
from octoarm_agents.policies import NetworkPolicy, load_policy
from octoarm_agents.rl import ALGORITHMS, Hyperparameters, Training, judging, train, tuning
from octoarm_agents.rl.checkpoint import read_checkpoint
from octoarm_agents.rl.hyperparameters import algorithm_class, hyperparameter_file
from octoarm_agents.rl.tuning import sample, tune_algorithm
from optuna.trial import FixedTrial

from octoarm_env import ArmParameters

SMALL: dict[str, dict[str, Any]] = {
    "ppo": {"n_steps": 16, "batch_size": 32, "n_epochs": 1},
    "recurrent_ppo": {"n_steps": 16, "batch_size": 32, "n_epochs": 1},
    "sac": {"learning_starts": 32, "batch_size": 16, "buffer_size": 200, "gradient_steps": 1},
    "tqc": {"learning_starts": 32, "batch_size": 16, "buffer_size": 200, "gradient_steps": 1},
}
STEPS = 256


@pytest.fixture(autouse=True, scope="module")
def short_evaluations() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(judging, "JUDGED_STEPS", 20)
        yield


SEEN = 0.02 + 1e-3 * np.random.default_rng(0).normal(size=(20, 80))


def entries(algorithm: str) -> dict[str, Any]:
    """The algorithm's own hyper-parameters, but with small networks and batches."""
    found = Hyperparameters.load(algorithm).entries() | SMALL[algorithm] | {"n_envs": 4}
    found["policy_kwargs"] = found["policy_kwargs"] | {"net_arch": [8]}
    if algorithm == "recurrent_ppo":
        found["policy_kwargs"]["lstm_hidden_size"] = 8
    return found


def small(algorithm: str, **changes: Any) -> Training:
    """A training of a second."""
    arguments = {"steps": STEPS, "seed": 1, "evaluations": 4, "episodes": 2} | changes
    given = Hyperparameters.from_entries(entries(algorithm))
    return Training.make(algorithm, "quadratic", hyperparameters=given, **arguments)


def steady(algorithm: str, **changes: Any) -> Training:
    """The same without anything that falls over the training."""
    training = small(algorithm, **changes)
    given = training.hyperparameters | {"learning_rate": 1e-3, "n_timesteps": 9}
    return replace(training, hyperparameters=given)


class Trained(NamedTuple):
    summary: dict[str, Any]
    folder: Path

    @property
    def returns(self) -> list[tuple[int, float]]:
        return returns(self.summary)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Training], Trained]:
    """Give a training that nothing interrupted; each is made once."""

    @functools.cache
    def trained(text: str) -> Trained:
        folder = tmp_path_factory.mktemp("whole")
        return Trained(train(pickle.loads(bytes.fromhex(text)), folder), folder)

    return lambda training: trained(pickle.dumps(training).hex())


def returns(summary: dict[str, Any]) -> list[tuple[int, float]]:
    return [(point["steps"], point["return"]) for point in summary["curve"]]


def actions(folder: Path, kept: str = "final.npz") -> Any:
    return load_policy(folder / kept).predict(SEEN)[0]


class Killed(BaseException):
    """Ends a training as a kill does: nothing else is written."""


def train_and_break(training: Training, out: Path, stop: int) -> None:
    def progress(done: int, value: float) -> None:
        if done >= stop:
            raise Killed

    with pytest.raises(Killed):
        train(training, out, progress=progress)


def train_and_die(training: Training, out: Path) -> None:
    def progress(done: int, value: float) -> None:
        if done >= 150:
            os.kill(os.getpid(), signal.SIGKILL)

    train(training, out, progress=progress)


def check_resumed(training: Training, out: Path, expected: Trained) -> None:
    assert (out / "checkpoint.zip").exists()
    assert not (out / "training.json").exists()
    resumed = train(training, out, resume=True)
    assert resumed["resumed"] == 1
    assert returns(resumed) == expected.returns
    assert resumed["best"]["return"] == expected.summary["best"]["return"]
    np.testing.assert_array_equal(actions(out), actions(expected.folder))
    # What has ended is not trained again.
    assert train(training, out, resume=True) == resumed


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_broken_off_and_resumed_as_if_never_interrupted(
    algorithm: str, tmp_path: Path, whole: Any
) -> None:
    training = small(algorithm)
    assert len(whole(training).returns) == 4
    train_and_break(training, tmp_path, 150)
    check_resumed(training, tmp_path, whole(training))


def test_killed_and_resumed_in_another_process(tmp_path: Path, whole: Any) -> None:
    training = small("ppo")
    # Forked, with PyTorch imported already.
    process = multiprocessing.get_context("fork").Process(
        target=train_and_die, args=(training, tmp_path)
    )
    process.start()
    process.join(600)
    assert process.exitcode == -signal.SIGKILL
    check_resumed(training, tmp_path, whole(training))


def test_noise_is_trained_with_and_resumed(tmp_path: Path, whole: Any) -> None:
    noisy = small("ppo", noise=1e-4)
    assert whole(noisy).returns != whole(small("ppo")).returns
    train_and_break(noisy, tmp_path, 150)
    check_resumed(noisy, tmp_path, whole(noisy))
    with pytest.raises(ValueError, match=r"noise is 0\.0001 there and 0\.0 here"):
        train(small("ppo"), tmp_path, resume=True)
    with pytest.raises(ValueError, match=r"noise = -1e-06: expected a number of metres"):
        small("ppo", noise=-1e-6)


def test_the_body_is_named(tmp_path: Path) -> None:
    env = {"arm": "inertial", "actuator": "servo", "amplitude": 20.0}
    summary = train(small("ppo", env=env), tmp_path)
    assert summary["training"]["env"] == env
    assert load_policy(tmp_path / "best.npz").parameters == ArmParameters.preset("inertial")


def test_broken_off_before_the_first_evaluation(tmp_path: Path, whole: Any) -> None:
    training = small("ppo")
    train_and_break(training, tmp_path, 0)
    assert returns(train(training, tmp_path, resume=True)) == whole(training).returns


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_extended_as_if_it_had_been_longer_from_the_beginning(
    algorithm: str, tmp_path: Path, whole: Any
) -> None:
    longer = whole(steady(algorithm))
    half = steady(algorithm, steps=STEPS // 2, evaluations=2)
    assert returns(train(half, tmp_path)) == longer.returns[:2]
    extended = train(steady(algorithm), tmp_path, resume=True, extend=True)
    assert returns(extended) == longer.returns
    assert extended["best"]["return"] == longer.summary["best"]["return"]
    assert extended["training"] == longer.summary["training"]
    assert extended["extended"] == [
        {"from_steps": STEPS // 2, "to_steps": STEPS, "schedules": []},
    ]
    for kept in ("final.npz", "best.npz"):
        np.testing.assert_array_equal(actions(tmp_path, kept), actions(longer.folder, kept))
    # It is now a training of so many steps as any other.
    assert train(steady(algorithm), tmp_path, resume=True) == extended
    with pytest.raises(ValueError, match=f"steps is {STEPS} there and {STEPS // 2} here"):
        train(half, tmp_path, resume=True, extend=True)


def test_an_extension_of_what_was_broken_off_goes_on(tmp_path: Path, whole: Any) -> None:
    half = steady("ppo", steps=STEPS // 2, evaluations=2)
    train_and_break(half, tmp_path, 64)
    extended = train(steady("ppo"), tmp_path, resume=True, extend=True)
    assert returns(extended) == whole(steady("ppo")).returns
    assert load_policy(tmp_path / "final.npz").training["extended"] == [
        {"from_steps": STEPS // 2, "to_steps": STEPS, "schedules": []}
    ]


def test_what_depends_on_the_length_of_a_training_is_named(tmp_path: Path, whole: Any) -> None:
    shutil.copytree(whole(small("ppo")).folder, tmp_path / "longer")
    with pytest.warns(UserWarning, match=r"learning_rate of ppo falls to zero .* 256 .* 320"):
        extended = train(small("ppo", steps=320), tmp_path / "longer", resume=True, extend=True)
    assert extended["extended"][0]["schedules"] == ["learning_rate"]
    assert extended["final"]["steps"] == 320


def test_folders_with_other_trainings_are_refused(tmp_path: Path, whole: Any) -> None:
    given, folder = steady("ppo"), whole(steady("ppo")).folder
    with pytest.raises(ValueError, match="holds a training: resume it"):
        train(given, folder)
    with pytest.raises(ValueError, match="extend = True: expected resume"):
        train(given, folder, extend=True)
    longer = steady("ppo", steps=512)
    for wanted, extend, message in (
        (replace(given, seed=2), False, "another training: seed is 1 there and 2 here"),
        (longer, False, "steps is 256 there and 512 here"),
        (replace(longer, seed=2), True, "another training: seed is 1 there and 2 here"),
        (replace(given, evaluations=2), True, "evaluations is 4 there and 2 here"),
    ):
        with pytest.raises(ValueError, match=message):
            train(wanted, folder, resume=True, extend=extend)
    found = (folder / "checkpoint.zip").read_bytes()
    for content in (b"", found[:1000]):
        (tmp_path / "checkpoint.zip").write_bytes(content)
        with pytest.raises(ValueError, match="no complete checkpoint"):
            train(given, tmp_path, resume=True)


def test_the_same_seed_gives_the_same_curve(tmp_path: Path, whole: Any) -> None:
    again = train(small("ppo"), tmp_path / "again")
    assert returns(again) == whole(small("ppo")).returns
    other = train(small("ppo", seed=2), tmp_path / "other")
    assert returns(other) != returns(again)


def test_evaluations_do_not_disturb_the_training(tmp_path: Path, whole: Any) -> None:
    train(small("sac", evaluations=1), tmp_path)
    np.testing.assert_array_equal(actions(tmp_path), actions(whole(small("sac")).folder))


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_what_is_kept_acts_as_the_model_does(algorithm: str, whole: Any) -> None:
    summary, folder = whole(small(algorithm))
    policy = load_policy(folder / "final.npz")
    assert isinstance(policy, NetworkPolicy)
    assert (policy.algorithm, policy.seed) == (algorithm, 1)
    assert policy.parameter_count == summary["parameters"]
    model = algorithm_class(algorithm).load(folder / "final_model.zip", device="cpu")
    with (folder / "vecnormalize.pkl").open("rb") as file:
        normalization = pickle.load(file)
    random = np.random.default_rng(2)
    state = other = None
    starts = np.ones(6, dtype=bool)
    for step in range(5):
        seen = 0.02 + 1e-3 * random.normal(size=(6, 80))
        actions, state = policy.predict(seen, state, starts)
        expected, other = model.predict(
            normalization.normalize_obs(seen), other, starts, deterministic=True
        )
        # Single precision, summed in another order.
        np.testing.assert_allclose(actions, expected, atol=2e-5)
        starts = np.arange(6) == step
    # Actions that differ from each other, or nothing was compared.
    assert np.ptp(actions, axis=0).min() > 1e-4


def test_the_best_policy_is_kept(whole: Any) -> None:
    summary, folder = whole(small("ppo"))
    best = max(summary["curve"], key=lambda point: point["return"])
    assert summary["best"] == best
    kept = load_policy(folder / "best.npz")
    assert kept.training["return"] == best["return"]
    assert kept.training["trained_steps"] == best["steps"]
    assert sorted(path.name for path in folder.iterdir()) == [
        "best.npz",
        "checkpoint.zip",
        "final.npz",
        "final_model.zip",
        "training.json",
        "vecnormalize.pkl",
    ]
    assert json.loads((folder / "training.json").read_text(encoding="utf-8")) == summary


def test_trains_on_another_body_and_gives_the_threads_back(tmp_path: Path) -> None:
    body = ArmParameters(arm_density=1100.0)
    before = torch.get_num_threads()
    train(small("ppo", steps=64, evaluations=1, env={"arm": body, "amplitude": 15.0}), tmp_path)
    assert torch.get_num_threads() == before
    policy = load_policy(tmp_path / "final.npz")
    assert policy.parameters == body
    assert policy.settings["amplitude"] == 15.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"steps": 0}, "steps = 0"),
        ({"num_envs": 0}, "num_envs = 0"),
        ({"seed": -1}, "seed = -1"),
        ({"evaluations": True}, "evaluations = True"),
        ({"episodes": 1.5}, "episodes = 1.5"),
    ],
)
def test_bad_trainings(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Training.make("ppo", "quadratic", **changes)


def test_bad_algorithm_and_target(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="algorithm = 'dqn': expected one of"):
        Training.make("dqn", "quadratic")
    with pytest.raises(ValueError, match="target = 'square'"):
        train(Training.make("ppo", "square", steps=10), tmp_path)


class TestHyperparameters:
    @pytest.mark.parametrize("algorithm", ALGORITHMS)
    def test_every_algorithm_has_its_file(self, algorithm: str) -> None:
        given = Hyperparameters.load(algorithm)
        content = yaml.safe_load(hyperparameter_file(algorithm).read_text(encoding="utf-8"))
        assert list(content) == ["OctoArm-v0"]
        assert given.entries() == content["OctoArm-v0"]
        assert given.normalize["norm_obs"] is True
        # The zoo's linear schedule would go below zero in the last, surplus rollout.
        if "n_steps" in given.arguments:
            assert given.steps % (given.num_envs * given.arguments["n_steps"]) == 0

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("OctoArm-v0: [", "is no YAML"),
            ("Pendulum-v1: {}", "no entry 'OctoArm-v0'"),
            ("OctoArm-v0: {n_timesteps: 100}", "'policy' is missing"),
            ("OctoArm-v0: {n_timesteps: 1e6, policy: MlpPolicy}", "n_timesteps = '1e6'"),
            ("OctoArm-v0: {n_timesteps: 10, n_envs: 0, policy: MlpPolicy}", "n_envs = 0"),
            ("OctoArm-v0: {n_timesteps: 10, policy: M, normalize: 3}", "normalize = 3"),
            ("OctoArm-v0: {n_timesteps: 10, policy: M, env_kwargs: 3}", "env_kwargs = 3"),
            ("OctoArm-v0: {n_timesteps: 10, policy: M, env_wrapper: x}", "wrappers and callbacks"),
        ],
    )
    def test_bad_files(self, text: str, message: str, tmp_path: Path) -> None:
        (tmp_path / "ppo.yml").write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=message):
            Hyperparameters.load("ppo", tmp_path / "ppo.yml")

    def test_wrong_arguments_are_named(self, tmp_path: Path) -> None:
        given = Hyperparameters.from_entries(entries("ppo") | {"depth": 3})
        training = Training.make("ppo", "quadratic", hyperparameters=given)
        with pytest.raises(ValueError, match=r"hyper-parameters of ppo: .*depth"):
            train(training, tmp_path)

    def test_schedules_fall_to_zero(self) -> None:
        rate = Hyperparameters.load("ppo").model_arguments()["learning_rate"]
        assert rate(1.0) == pytest.approx(2 * rate(0.5))
        assert rate(0.0) == rate(-0.01) == 0.0


@pytest.mark.parametrize("resume", [False, True])
def test_the_folder_of_another_engine_s_training_is_refused(tmp_path: Path, resume: bool) -> None:
    """Both have the same folder if none is named."""
    (tmp_path / "rllib_checkpoint.pkl").touch()
    (tmp_path / "best.npz").write_bytes(b"its best")
    with pytest.raises(ValueError, match="holds a training by rllib: choose another folder"):
        train(Training.make("ppo", "quadratic"), tmp_path, resume=resume)
    assert (tmp_path / "best.npz").read_bytes() == b"its best"


def test_tuning_tries_and_goes_on(tmp_path: Path) -> None:
    # So few steps that nothing is learnt from them yet.
    first = tune_algorithm("sac", tmp_path, trials=1, steps=32)
    assert [each["number"] for each in first["trials"]] == [0]
    # The first trial is the present file.
    present = Hyperparameters.load("sac")
    assert first["best"]["hyperparameters"] == present.entries()
    reported = []
    second = tune_algorithm(
        "sac", tmp_path, trials=2, steps=32, report=lambda trial, best: reported.append(trial)
    )
    assert reported == second["trials"][1:]
    assert second["trials"][:1] == first["trials"]
    assert len(second["trials"]) == 2
    complete = [each for each in second["trials"] if not each["pruned"]]
    assert second["best"]["value"] == max(each["value"] for each in complete)
    tuned = Hyperparameters.load("sac", tmp_path / "sac.yml")
    assert tuned.entries() == second["best"]["hyperparameters"]
    with pytest.raises(ValueError, match="expected at least one"):
        tune_algorithm("sac", tmp_path)
    with pytest.raises(ValueError, match="trials = 0"):
        tune_algorithm("sac", tmp_path, trials=0)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_what_is_tried_first_is_what_the_file_holds(algorithm: str) -> None:
    start = Hyperparameters.load(algorithm)
    drawn = sample(FixedTrial(tuning._present(algorithm, start)), algorithm, start).entries()
    # What the file leaves to stable-baselines3.
    assert drawn.pop("top_quantiles_to_drop_per_net", 2) == 2
    assert drawn == start.entries()


class TestCommand:
    def test_train_evaluate_resume(self, octoarm: Any, tmp_path: Path) -> None:
        file, out = tmp_path / "small.yml", tmp_path / "out"
        file.write_text(yaml.safe_dump({"OctoArm-v0": entries("ppo")}), encoding="utf-8")
        arguments = ["train", "ppo", "--target", "van_der_pol", "--steps", 64, "--out", out]
        arguments += ["--evaluations", 1, "--hyperparameters", file]
        done = octoarm(*arguments)
        assert done.exit_code == 0, done.output
        assert "of 500" in done.output
        assert list((out / "tensorboard").iterdir())
        policy = load_policy(out / "best.npz")
        assert policy.settings["target"] == "van_der_pol"
        again = octoarm(*arguments)
        assert again.exit_code == 2
        assert "holds a training: resume it (--resume)" in again.output
        assert octoarm(*arguments, "--resume").exit_code == 0
        arguments[arguments.index(64)] = 128
        with pytest.warns(UserWarning, match="learning_rate of ppo"):
            longer = octoarm(*arguments, "--resume")
        assert longer.exit_code == 0, longer.output
        assert "Trained 128 steps" in longer.output
        shown = octoarm(
            "evaluate", out / "best.npz", "--episodes", 2, "--out", tmp_path / "figures.json"
        )
        assert shown.exit_code == 0, shown.output
        figures = json.loads((tmp_path / "figures.json").read_text(encoding="utf-8"))
        assert [row["agent"] for row in figures["rows"]][1:] == ["hold", "clock"]
        assert figures["rows"][2]["return"] > 499.9

    def test_bodies_vary(self, octoarm: Any, tmp_path: Path) -> None:
        file, out = tmp_path / "small.yml", tmp_path / "out"
        file.write_text(yaml.safe_dump({"OctoArm-v0": entries("ppo")}), encoding="utf-8")
        arguments = ["train", "ppo", "--steps", 64, "--out", out, "--evaluations", 1]
        arguments += ["--hyperparameters", file, "--bodies", 3, "--body-seed", 5]
        arguments += ["--vary", "longitudinal_stiffness=0.8,1.2", "--vary", "arm_density=0.9,1"]
        done = octoarm(*arguments)
        assert done.exit_code == 0, done.output
        trained = json.loads((out / "training.json").read_text(encoding="utf-8"))["training"]
        factors = {"longitudinal_stiffness": [0.8, 1.2], "arm_density": [0.9, 1.0]}
        assert trained["env"] == {"vary": factors, "bodies": 3, "body_seed": 5}
        training = Training.make("ppo", "quadratic", env=trained["env"])
        judges = judging.Judge(training, tmp_path, None).judges
        bodies = {judges.reset(seed=seed)[1]["body"][0] for seed in range(20)}
        assert bodies == {0, 1, 2}
        assert octoarm(*arguments, "--resume").exit_code == 0

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (("ppo", "--vary", "arm_density"), "NAME=LOW,HIGH"),
            (("ppo", "--vary", "colour=0.9,1"), "colour"),
            (("dqn",), "dqn"),
            (("ppo", "--steps", 0), "0 is not between 1 and"),
            (("ppo", "--target", "square"), "square"),
            (("ppo", "--hyperparameters", "missing.yml"), "missing.yml"),
        ],
    )
    def test_bad_options(
        self, octoarm: Any, tmp_path: Path, arguments: tuple[Any, ...], message: str
    ) -> None:
        done = octoarm("train", *arguments, "--out", tmp_path / "out")
        assert done.exit_code == 2
        assert message in done.output

    def test_bodies_that_do_not_fit(self, octoarm: Any, tmp_path: Path, whole: Any) -> None:
        ArmParameters(compartments=10).to_json(tmp_path / "short.json")
        policy = whole(small("ppo")).folder / "best.npz"
        done = octoarm("evaluate", policy, "--arm", tmp_path / "short.json")
        assert done.exit_code == 2
        assert "short.json has 10 compartments" in done.output

    def test_bad_policies(self, octoarm: Any, tmp_path: Path) -> None:
        (tmp_path / "bad.npz").write_bytes(b"nothing")
        for name, message in (
            (tmp_path / "missing.npz", "cannot open"),
            (tmp_path / "bad.npz", "not a complete policy file"),
            ("ppo/square", "'ppo/square' is neither a file nor one of"),
        ):
            done = octoarm("evaluate", name)
            assert done.exit_code == 2
            assert message in done.output


@pytest.mark.long
def test_killed_at_any_moment(tmp_path: Path) -> None:
    """The first policy appears, and the process dies: what is there can be loaded."""
    training = small("ppo", steps=100_000, evaluations=500)
    code = (
        "import pickle, sys; from pathlib import Path; from octoarm_agents.rl import train;"
        "train(pickle.loads(bytes.fromhex(sys.argv[2])), Path(sys.argv[1]))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path), pickle.dumps(training).hex()]
    )
    try:
        while not (tmp_path / "best.npz").exists():
            assert process.poll() is None
        os.kill(process.pid, signal.SIGKILL)
    finally:
        process.kill()
        process.wait()
    load_policy(tmp_path / "best.npz")
    assert read_checkpoint(tmp_path / "checkpoint.zip")["training"]["steps"] == 100_000
