"""Training: reproducible, resumable after a kill, and kept as what was trained."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from octoarm_agents.policies import NetworkPolicy, load_policy
from octoarm_agents.rl import ALGORITHMS, Hyperparameters, Training, train
from octoarm_agents.rl.checkpoint import read_checkpoint
from octoarm_agents.rl.hyperparameters import algorithm_class, hyperparameter_file
from octoarm_agents.rl.tuning import tune_algorithm

from octoarm_env import ArmParameters

SMALL: dict[str, dict[str, Any]] = {
    "ppo": {"n_steps": 32, "batch_size": 64, "n_epochs": 2},
    "recurrent_ppo": {"n_steps": 16, "batch_size": 64, "n_epochs": 2},
    "sac": {"learning_starts": 64, "batch_size": 32, "buffer_size": 1000, "gradient_steps": 1},
    "tqc": {"learning_starts": 64, "batch_size": 32, "buffer_size": 1000, "gradient_steps": 1},
}
STEPS = {"ppo": 512, "recurrent_ppo": 512, "sac": 200, "tqc": 200}


def small(algorithm: str, **changes: Any) -> Training:
    """The algorithm's own hyper-parameters, but batches and budget of a few seconds."""
    entries = Hyperparameters.load(algorithm).entries() | SMALL[algorithm] | {"n_envs": 4}
    if algorithm == "recurrent_ppo":
        entries["policy_kwargs"] = entries["policy_kwargs"] | {"lstm_hidden_size": 8}
    arguments = {"steps": STEPS[algorithm], "seed": 1, "evaluations": 4, "episodes": 2} | changes
    return Training.make(
        algorithm, "quadratic", hyperparameters=Hyperparameters.from_entries(entries), **arguments
    )


def returns(summary: dict[str, Any]) -> list[tuple[int, float]]:
    return [(point["steps"], point["return"]) for point in summary["curve"]]


KILLED = """
import os, pickle, signal, sys
from dataclasses import replace
from pathlib import Path
from octoarm_agents.rl import train

training, stop = pickle.loads(bytes.fromhex(sys.argv[2])), int(sys.argv[3])

def progress(done, value):
    if done >= stop:
        os.kill(os.getpid(), signal.SIGKILL)

train(training, Path(sys.argv[1]), progress=progress)
"""


def train_and_kill(training: Training, out: Path, stop: int) -> None:
    """Train in a process of its own that dies without warning after some steps."""
    packed = pickle.dumps(training).hex()
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(out), packed, str(stop)], check=False, timeout=300
    )
    assert done.returncode == -signal.SIGKILL


ON_AND_OFF_POLICY = [
    pytest.param(algorithm, marks=() if algorithm in ("ppo", "sac") else pytest.mark.long)
    for algorithm in ALGORITHMS
]
"""One algorithm of each kind; those that are trained like it take long."""


@pytest.mark.parametrize("algorithm", ON_AND_OFF_POLICY)
def test_killed_and_resumed_as_if_never_killed(algorithm: str, tmp_path: Path) -> None:
    training = small(algorithm)
    whole = train(training, tmp_path / "whole")
    assert len(whole["curve"]) == 4
    assert whole["final"]["steps"] >= training.steps
    train_and_kill(training, tmp_path / "killed", round(0.6 * training.steps))
    assert not (tmp_path / "killed" / "training.json").exists()
    resumed = train(training, tmp_path / "killed", resume=True)
    assert resumed["resumed"] == 1
    assert returns(resumed) == returns(whole)
    first, second = (load_policy(tmp_path / name / "final.npz") for name in ("whole", "killed"))
    seen = 0.02 + 1e-3 * np.random.default_rng(0).normal(size=(20, 80))
    np.testing.assert_array_equal(first.predict(seen)[0], second.predict(seen)[0])
    # What has ended is not trained again.
    assert returns(train(training, tmp_path / "killed", resume=True)) == returns(whole)


@pytest.mark.parametrize("stop", [0, pytest.param(200, marks=pytest.mark.long)])
def test_killed_before_the_first_evaluation(stop: int, tmp_path: Path) -> None:
    training = small("ppo")
    train_and_kill(training, tmp_path, stop)
    assert (tmp_path / "checkpoint.zip").exists()
    resumed = train(training, tmp_path, resume=True)
    assert returns(resumed) == returns(train(training, tmp_path / "whole"))


def steady(algorithm: str, **changes: Any) -> Training:
    """The same without anything that falls over the training."""
    training = small(algorithm, **changes)
    return replace(
        training,
        hyperparameters=training.hyperparameters | {"learning_rate": 1e-3, "n_timesteps": 9},
    )


@pytest.mark.parametrize("algorithm", ON_AND_OFF_POLICY)
def test_extended_as_if_it_had_been_longer_from_the_beginning(
    algorithm: str, tmp_path: Path
) -> None:
    steps = STEPS[algorithm]
    whole = train(steady(algorithm), tmp_path / "whole")
    half = steady(algorithm, steps=steps // 2, evaluations=2)
    finished = train(half, tmp_path / "part")
    assert returns(finished) == returns(whole)[:2]
    extended = train(steady(algorithm), tmp_path / "part", resume=True, extend=True)
    assert returns(extended) == returns(whole)
    assert extended["best"]["return"] == whole["best"]["return"]
    assert extended["training"] == whole["training"]
    assert extended["extended"] == [
        {"from_steps": steps // 2, "to_steps": steps, "schedules": []},
    ]
    seen = 0.02 + 1e-3 * np.random.default_rng(0).normal(size=(20, 80))
    for kept in ("final.npz", "best.npz"):
        first, second = (load_policy(tmp_path / name / kept) for name in ("whole", "part"))
        np.testing.assert_array_equal(first.predict(seen)[0], second.predict(seen)[0])
    # It is now a training of so many steps as any other.
    again = train(steady(algorithm), tmp_path / "part", resume=True)
    assert again == extended
    with pytest.raises(ValueError, match=f"steps is {steps} there and {steps // 2} here"):
        train(half, tmp_path / "part", resume=True, extend=True)


def test_an_extension_that_is_killed_goes_on(tmp_path: Path) -> None:
    whole = train(steady("ppo", steps=1024, evaluations=8), tmp_path / "whole")
    train_and_kill(steady("ppo"), tmp_path / "part", 300)
    extended = train(
        steady("ppo", steps=1024, evaluations=8), tmp_path / "part", resume=True, extend=True
    )
    assert returns(extended) == returns(whole)
    assert load_policy(tmp_path / "part" / "final.npz").training["extended"] == [
        {"from_steps": 512, "to_steps": 1024, "schedules": []}
    ]


def test_what_depends_on_the_length_of_a_training_is_named(tmp_path: Path) -> None:
    train(small("ppo"), tmp_path)
    with pytest.warns(UserWarning, match=r"learning_rate of ppo falls to zero .* 512 .* 1,024"):
        extended = train(small("ppo", steps=1024), tmp_path, resume=True, extend=True)
    assert extended["extended"][0]["schedules"] == ["learning_rate"]
    assert extended["final"]["steps"] == 1024


def test_only_the_length_may_differ(tmp_path: Path) -> None:
    train(steady("ppo", steps=128, evaluations=1), tmp_path)
    longer = steady("ppo", steps=256, evaluations=1)
    with pytest.raises(ValueError, match="steps is 128 there and 256 here"):
        train(longer, tmp_path, resume=True)
    with pytest.raises(ValueError, match="another training: seed is 1 there and 2 here"):
        train(replace(longer, seed=2), tmp_path, resume=True, extend=True)
    other = steady("ppo", steps=128, evaluations=2)
    with pytest.raises(ValueError, match="evaluations is 1 there and 2 here"):
        train(other, tmp_path, resume=True, extend=True)
    with pytest.raises(ValueError, match="extend = True: expected resume"):
        train(longer, tmp_path, extend=True)


def test_the_same_seed_gives_the_same_curve(tmp_path: Path) -> None:
    curves = [
        returns(train(small("ppo", seed=seed), tmp_path / str(run)))
        for run, seed in enumerate((3, 3, 4))
    ]
    assert curves[0] == curves[1] != curves[2]


def test_evaluations_do_not_disturb_the_training(tmp_path: Path) -> None:
    for count in (1, 4):
        train(small("sac", evaluations=count), tmp_path / str(count))
    first, second = (load_policy(tmp_path / name / "final.npz") for name in ("1", "4"))
    seen = np.full((1, 80), 0.021)
    np.testing.assert_array_equal(first.predict(seen)[0], second.predict(seen)[0])


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_what_is_kept_acts_as_the_model_does(algorithm: str, tmp_path: Path) -> None:
    training = small(algorithm, evaluations=1)
    summary = train(training, tmp_path)
    policy = load_policy(tmp_path / "final.npz")
    assert isinstance(policy, NetworkPolicy)
    assert (policy.algorithm, policy.seed) == (algorithm, 1)
    assert policy.parameter_count == summary["parameters"]
    model = algorithm_class(algorithm).load(tmp_path / "final_model.zip", device="cpu")
    with (tmp_path / "vecnormalize.pkl").open("rb") as file:
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


def test_the_best_policy_is_kept(tmp_path: Path) -> None:
    summary = train(small("ppo"), tmp_path)
    best = max(summary["curve"], key=lambda point: point["return"])
    assert summary["best"] == best
    kept = load_policy(tmp_path / "best.npz")
    assert kept.training["return"] == best["return"]
    assert kept.training["trained_steps"] == best["steps"]
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "best.npz",
        "checkpoint.zip",
        "final.npz",
        "final_model.zip",
        "training.json",
        "vecnormalize.pkl",
    ]
    assert json.loads((tmp_path / "training.json").read_text(encoding="utf-8")) == summary


def test_trains_on_another_body(tmp_path: Path) -> None:
    body = ArmParameters(arm_density=1100.0)
    train(small("ppo", steps=128, evaluations=1, env={"arm": body, "amplitude": 15.0}), tmp_path)
    policy = load_policy(tmp_path / "final.npz")
    assert policy.parameters == body
    assert policy.settings["amplitude"] == 15.0


def test_threads_are_given_back(tmp_path: Path) -> None:
    before = torch.get_num_threads()
    train(small("ppo", steps=128, evaluations=1), tmp_path)
    assert torch.get_num_threads() == before


def test_folders_with_other_trainings_are_refused(tmp_path: Path) -> None:
    train(small("ppo", steps=128, evaluations=1), tmp_path)
    with pytest.raises(ValueError, match="holds a training: resume it"):
        train(small("ppo", steps=128, evaluations=1), tmp_path)
    with pytest.raises(ValueError, match="another training: seed is 1 there and 2 here"):
        train(small("ppo", steps=128, evaluations=1, seed=2), tmp_path, resume=True)
    whole = (tmp_path / "checkpoint.zip").read_bytes()
    for content in (b"", whole[:1000]):
        (tmp_path / "checkpoint.zip").write_bytes(content)
        with pytest.raises(ValueError, match="no complete checkpoint"):
            train(small("ppo", steps=128, evaluations=1), tmp_path, resume=True)


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
        entries = Hyperparameters.load("ppo").entries() | {"depth": 3}
        training = Training.make(
            "ppo", "quadratic", hyperparameters=Hyperparameters.from_entries(entries)
        )
        with pytest.raises(ValueError, match=r"hyper-parameters of ppo: .*depth"):
            train(training, tmp_path)

    def test_schedules_fall_to_zero(self) -> None:
        rate = Hyperparameters.load("ppo").model_arguments()["learning_rate"]
        assert rate(1.0) == pytest.approx(2 * rate(0.5))
        assert rate(0.0) == rate(-0.01) == 0.0


def test_tuning_tries_and_goes_on(tmp_path: Path) -> None:
    first = tune_algorithm("ppo", tmp_path, trials=1, steps=600)
    assert [each["number"] for each in first["trials"]] == [0]
    # The first trial is the present file.
    present = Hyperparameters.load("ppo").arguments
    assert first["trials"][0]["parameters"]["gamma"] == present["gamma"]
    second = tune_algorithm("ppo", tmp_path, trials=2, steps=600)
    assert second["trials"][:1] == first["trials"]
    assert len(second["trials"]) == 2
    complete = [each for each in second["trials"] if not each["pruned"]]
    assert second["best"]["value"] == max(each["value"] for each in complete)
    tuned = Hyperparameters.load("ppo", tmp_path / "ppo.yml")
    assert tuned.entries() == second["best"]["hyperparameters"]
    with pytest.raises(ValueError, match="expected at least one"):
        tune_algorithm("ppo", tmp_path)
    with pytest.raises(ValueError, match="trials = 0"):
        tune_algorithm("ppo", tmp_path, trials=0)


class TestCommand:
    def test_train_evaluate_resume(self, octoarm: Any, tmp_path: Path) -> None:
        arguments = ["train", "ppo", "--target", "van_der_pol", "--steps", 2048, "--out", tmp_path]
        arguments += ["--evaluations", 1]
        done = octoarm(*arguments)
        assert done.exit_code == 0, done.output
        assert "of 500" in done.output
        assert list((tmp_path / "tensorboard").iterdir())
        policy = load_policy(tmp_path / "best.npz")
        assert policy.settings["target"] == "van_der_pol"
        again = octoarm(*arguments)
        assert again.exit_code == 2
        assert "holds a training: go on with --resume" in again.output
        assert octoarm(*arguments, "--resume").exit_code == 0
        arguments[arguments.index(2048)] = 3072
        with pytest.warns(UserWarning, match="learning_rate of ppo"):
            longer = octoarm(*arguments, "--resume")
        assert longer.exit_code == 0, longer.output
        assert "Trained 3,072 steps" in longer.output
        shown = octoarm(
            "evaluate", tmp_path / "best.npz", "--episodes", 2, "--out", tmp_path / "figures.json"
        )
        assert shown.exit_code == 0, shown.output
        figures = json.loads((tmp_path / "figures.json").read_text(encoding="utf-8"))
        assert [row["agent"] for row in figures["rows"]][1:] == ["hold", "clock"]
        assert figures["rows"][2]["return"] > 499.9

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
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

    def test_bodies_that_do_not_fit(self, octoarm: Any, tmp_path: Path) -> None:
        train(small("ppo", steps=128, evaluations=1), tmp_path / "out")
        ArmParameters(compartments=10).to_json(tmp_path / "short.json")
        done = octoarm("evaluate", tmp_path / "out" / "best.npz", "--arm", tmp_path / "short.json")
        assert done.exit_code == 2
        assert "short.json has 10 compartments" in done.output

    def test_bad_policies(self, octoarm: Any, tmp_path: Path) -> None:
        (tmp_path / "bad.npz").write_bytes(b"nothing")
        for name, message in (
            (tmp_path / "missing.npz", "cannot read"),
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
