"""Who reaches with muscles: goals, baselines, networks, and the commands for them."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from octoarm_agents.cli import app
from octoarm_agents.comparison.reaching import compare_reaching
from octoarm_agents.policies import reaching
from octoarm_agents.policies.network import Network
from octoarm_agents.policies.reaching import (
    BASELINES,
    GoalPolicy,
    HoldStill,
    Nearest,
    evaluate_reaching,
    held_out_goals,
    load_reaching,
    sample_reachable,
    search_goals,
    thin,
    train_goals,
    validation_goals,
)
from typer.testing import CliRunner

from octoarm_env.reach import OctoArmReachVectorEnv, ReachSettings, reachable_goals


def small_policy(seed: int = 0) -> GoalPolicy:
    random = np.random.default_rng(seed)
    shapes = [(86, 8), (8, 25)]
    layers = tuple(
        (random.normal(size=(wide, deep)).astype(np.float32), np.zeros(wide, np.float32))
        for deep, wide in shapes
    )
    network = Network(np.full(86, 0.02), np.full(86, 50.0), 10.0, layers, "relu", "tanh")
    return GoalPolicy(network, ReachSettings(), {"algorithm": "none"})


def test_no_goal_is_both_for_learning_and_for_judging() -> None:
    learnt, judged = (set(map(tuple, each)) for each in (train_goals(), held_out_goals()))
    assert learnt | judged == set(map(tuple, reachable_goals()))
    assert not learnt & judged
    assert len(judged) > 300
    searched, validated = (set(map(tuple, each)) for each in (search_goals(), validation_goals()))
    assert searched | validated == learnt
    assert not searched & validated
    assert len(validated) > 250


@pytest.fixture(scope="module")
def samples() -> Any:
    """The first of those that the shipped goals are made of."""
    return sample_reachable(512, 0)


def test_shipped_goals_are_what_the_command_samples(samples: Any) -> None:
    """Its first 512 samples, of which one in every cube is kept, are the first goals."""
    activations, tips = samples
    assert activations.shape == (512, 25)
    assert (activations >= 0).all()
    assert (activations <= 1).all()
    kept = thin(tips)
    np.testing.assert_allclose(reachable_goals()[: len(kept)], kept, atol=2e-5)


def test_baselines_are_judged_alike() -> None:
    goals = held_out_goals()[:12]
    told = {name: evaluate_reaching(BASELINES[name], goals) for name in ("still", "wave")}
    for each in told.values():
        assert 0 <= each["held"] <= each["success"] <= each["ever"] <= 1
    rest = np.array([0.0, 0.0, 0.4016])
    still = evaluate_reaching(HoldStill(), goals)
    assert still == told["still"]
    assert still["distance"] == pytest.approx(
        np.median(np.linalg.norm(goals - rest, axis=1)), abs=1e-4
    )


def test_who_holds_the_activation_of_a_goal_reaches_it(
    samples: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reaching, "sample_reachable", lambda count, seed: samples)
    told = evaluate_reaching(Nearest(), samples[1][:16])
    assert told["success"] == 1.0


def test_a_policy_is_kept_in_a_file(tmp_path: Any) -> None:
    policy = small_policy()
    policy.save(tmp_path / "p.npz")
    again = GoalPolicy.load(tmp_path / "p.npz")
    assert again.settings == policy.settings
    envs = OctoArmReachVectorEnv(3)
    seen, _ = envs.reset(seed=0)
    np.testing.assert_array_equal(again.predict(seen)[0], policy.predict(seen)[0])
    one = {key: value[1] for key, value in seen.items()}
    np.testing.assert_allclose(policy.predict(one)[0], policy.predict(seen)[0][1], atol=1e-6)
    envs.step(policy.predict(seen)[0])
    (tmp_path / "bad.npz").write_bytes((tmp_path / "p.npz").read_bytes()[:500])
    for name in ("bad.npz", "none.npz"):
        with pytest.raises((ValueError, OSError), match=name):
            GoalPolicy.load(tmp_path / name)
    with pytest.raises(ValueError, match=r"\.npz"):
        policy.save(tmp_path / "p.zip")


def test_the_agent_that_comes_along_reaches() -> None:
    policy = load_reaching()
    told = evaluate_reaching(policy)
    assert told["success"] > 0.9
    # Another machine's linear algebra rounds otherwise.
    assert told["success"] == pytest.approx(policy.training["success"], abs=0.02)


@pytest.mark.parametrize("algorithm", ["sac", "ppo"])
def test_training_gives_what_stable_baselines3_does(algorithm: Any, tmp_path: Any) -> None:
    pytest.importorskip("stable_baselines3")
    from octoarm_agents.rl import reaching as training

    kept: dict[str, Any] = {}
    export = training.export_goal_network

    def spy(model: Any, envs: Any) -> Network:
        kept.update(model=model, envs=envs)
        return export(model, envs)

    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Box's precision, in stable-baselines3's spaces
        patch.setattr(training, "export_goal_network", spy)
        patch.setattr(training, "evaluate_reaching", lambda policy, goals: {"success": 0.0})
        summary = training.train_reaching(algorithm, tmp_path, steps=3_300, evaluations=1)
        assert json.loads((tmp_path / "training.json").read_text())["finished"]
        assert summary["curve"][-1]["steps"] >= 3_300
        policy = GoalPolicy.load(tmp_path / "policy.npz")
        seen, _ = OctoArmReachVectorEnv(4).reset(seed=5)
        normal = kept["envs"].normalize_obs({key: each.copy() for key, each in seen.items()})
        expected, _ = kept["model"].predict(normal, deterministic=True)
    if algorithm == "ppo":
        expected = (np.clip(expected, -1, 1) + 1) / 2
    np.testing.assert_allclose(policy.predict(seen)[0], expected, atol=2e-5)


SMALL = {
    "sac": {"learning_starts": 440, "batch_size": 16, "train_freq": 9, "buffer_size": 1_000},
    "ppo": {"n_steps": 50, "batch_size": 100, "n_epochs": 1},
}


def small(algorithm: str) -> Any:
    """Hyper-parameters with which a test trains."""
    from octoarm_agents.rl.hyperparameters import REACH_ID, Hyperparameters

    start = Hyperparameters.load(algorithm, env_id=REACH_ID)
    changes = SMALL[algorithm] | {"policy_kwargs": {"net_arch": [8]}, "learning_rate": "lin_0.001"}
    return replace(start, num_envs=4, arguments=start.arguments | changes)


@pytest.mark.parametrize("algorithm", ["sac", "ppo"])
def test_a_killed_training_goes_on_as_if_nothing_had_been(
    algorithm: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("stable_baselines3")
    from octoarm_agents.rl import reaching as training

    class Killed(BaseException):
        """Ends a training as a kill does: nothing else is written."""

    doomed = False

    def judge(policy: GoalPolicy, goals: Any) -> dict[str, float]:
        if doomed and policy.training["steps"] > 1_500:
            raise Killed
        return evaluate_reaching(policy, goals[:3])

    warnings.simplefilter("ignore")  # Box's precision, in stable-baselines3's spaces
    monkeypatch.setattr(training, "evaluate_reaching", judge)
    # Killed before the third evaluation it goes on from the second, after 313 steps of each arm: in
    # the middle of its episode of 100, when SAC's buffer is written over for the first time.
    call: dict[str, Any] = {"steps": 2_500, "seed": 3, "evaluations": 4}
    call["hyperparameters"] = small(algorithm)
    whole = training.train_reaching(algorithm, tmp_path / "whole", **call)
    doomed = True
    with pytest.raises(Killed):
        training.train_reaching(algorithm, tmp_path / "killed", **call)
    doomed = False
    begun = json.loads((tmp_path / "killed" / "training.json").read_text())
    assert not begun["finished"]
    assert len(begun["curve"]) == 2
    with pytest.raises(ValueError, match="holds a training: resume it"):
        training.train_reaching(algorithm, tmp_path / "killed", **call)
    with pytest.raises(ValueError, match="seed is 3 there and 4 here"):
        training.train_reaching(algorithm, tmp_path / "killed", resume=True, **call | {"seed": 4})
    resumed = training.train_reaching(algorithm, tmp_path / "killed", resume=True, **call)
    assert resumed["finished"]
    assert resumed["resumed"] == 1

    def results(summary: dict[str, Any]) -> list[dict[str, float]]:
        return [{key: each[key] for key in each if key != "seconds"} for each in summary["curve"]]

    assert results(resumed) == results(whole)
    one, other = (GoalPolicy.load(tmp_path / name / "policy.npz") for name in ("whole", "killed"))
    for (weights, bias), (weights_too, bias_too) in zip(
        one.network.layers, other.network.layers, strict=True
    ):
        np.testing.assert_array_equal(weights, weights_too)
        np.testing.assert_array_equal(bias, bias_too)
    # What has ended is not trained again.
    assert training.train_reaching(algorithm, tmp_path / "killed", resume=True, **call) == resumed


def test_commands(samples: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reaching, "sample_reachable", lambda *given: samples)
    runner = CliRunner()
    told = runner.invoke(
        app, ["reach", "goals", "--samples", "512", "--out", str(tmp_path / "g.npy")]
    )
    assert told.exit_code == 0, told.output
    assert "goals of 512 samples" in told.output
    np.testing.assert_allclose(np.load(tmp_path / "g.npy")[0], reachable_goals()[0], atol=2e-5)
    small_policy().save(tmp_path / "p.npz")
    told = runner.invoke(app, ["reach", "evaluate", str(tmp_path / "p.npz"), "--steps", "21"])
    assert told.exit_code == 0, told.output
    assert "held-out goals" in told.output
    told = runner.invoke(app, ["reach", "evaluate", "nobody"])
    assert told.exit_code == 2
    assert "nobody" in told.output


def test_comparison_and_film(samples: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reaching, "sample_reachable", lambda *given: samples)
    monkeypatch.setattr(reaching, "held_out_goals", lambda: reachable_goals()[:4])
    runner = CliRunner()
    told = runner.invoke(app, ["reach", "compare", str(tmp_path), "--out", str(tmp_path)])
    assert told.exit_code == 2
    assert "octoarm reach train" in " ".join(told.output.replace("│", " ").split())
    point = {"steps": 10, "seconds": 1.0, "success": 0.5, "held": 0.25, "ever": 1.0}
    for seed in range(2):
        curve = [point | {"distance": 0.01 + seed}]
        training = {"algorithm": "sac", "seed": seed, "finished": True, "curve": curve}
        training |= {"parameters": 9, "hyperparameters": {}}
        (tmp_path / f"sac-{seed}").mkdir()
        (tmp_path / f"sac-{seed}" / "training.json").write_text(json.dumps(training))
    told = runner.invoke(app, ["reach", "compare", str(tmp_path), "--out", str(tmp_path)])
    assert told.exit_code == 0, told.output
    found = json.loads((tmp_path / "reaching.json").read_text())
    assert found["agents"]["sac"]["success"]["values"] == [0.5, 0.5]
    assert set(found["baselines"]) == set(BASELINES)
    judged_elsewhere = training | {"algorithm": "sac", "validation": True}
    for name, each in {"ppo-0": training | {"algorithm": "ppo"}, "sac-0": judged_elsewhere}.items():
        (tmp_path / "others" / name).mkdir(parents=True)
        (tmp_path / "others" / name / "training.json").write_text(json.dumps(each))
    again = compare_reaching(tmp_path / "others", tmp_path)
    assert set(again["agents"]) == {"sac", "ppo"}
    assert again["agents"]["sac"] == found["agents"]["sac"]
    (tmp_path / "sac-1" / "training.json").write_text(json.dumps(training | {"steps": 20}))
    with pytest.raises(ValueError, match="other steps than seed 0"):
        compare_reaching(tmp_path, tmp_path)
    assert (tmp_path / "reaching.png").stat().st_size > 10_000
    out = tmp_path / "wave.gif"
    told = runner.invoke(app, ["reach", "film", "wave", "--episodes", "1", "--out", str(out)])
    assert told.exit_code == 0, told.output
    assert out.read_bytes()[:3] == b"GIF"
    told = runner.invoke(app, ["reach", "film", "wave", "--out", str(tmp_path / "wave.txt")])
    assert told.exit_code == 2
