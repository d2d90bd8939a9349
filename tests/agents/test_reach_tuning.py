"""The search for hyper-parameters of reaching: which goals it sees, and that it goes on."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("stable_baselines3")

from octoarm_agents.policies.reaching import evaluate_reaching, search_goals, validation_goals
from octoarm_agents.rl import reach_tuning, reaching
from octoarm_agents.rl.hyperparameters import REACH_ID, Hyperparameters
from octoarm_agents.rl.reach_tuning import sample, tune_reaching
from optuna.trial import FixedTrial

from octoarm_env.reach import OctoArmReachVectorEnv

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # Box's precision


def start(algorithm: str) -> Hyperparameters:
    return Hyperparameters.load(algorithm, env_id=REACH_ID)


@pytest.mark.parametrize("algorithm", ["sac", "ppo"])
def test_what_is_tried_first_is_what_the_file_holds(algorithm: Any) -> None:
    given = start(algorithm)
    present = reach_tuning._present(algorithm, given)
    assert sample(FixedTrial(present), algorithm, given).entries() == given.entries()


@pytest.mark.parametrize(
    "drawn", [{"schedule": "linear", "n_sampled_goal": 2, "width": 128, "ent_coef": "auto_0.01"}]
)
def test_what_is_drawn_is_what_is_trained_with(drawn: dict[str, Any]) -> None:
    given = start("sac")
    present = reach_tuning._present("sac", given)
    tried = sample(FixedTrial(present | drawn | {"learning_rate": 0.0005}), "sac", given)
    assert tried.arguments["learning_rate"] == "lin_0.0005"
    assert tried.arguments["replay_buffer_kwargs"]["n_sampled_goal"] == 2
    assert tried.arguments["policy_kwargs"]["net_arch"] == [128, 128]
    assert tried.arguments["ent_coef"] == "auto_0.01"
    # What is searched is no part of what was read.
    assert given == start("sac")


@pytest.fixture
def few_goals(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Judges on three goals; gives the goals that were to be judged on."""
    seen: list[Any] = []

    def judge(policy: Any, goals: Any) -> dict[str, float]:
        seen.append(goals)
        return evaluate_reaching(policy, goals[:3], steps=21)

    monkeypatch.setattr(reaching, "evaluate_reaching", judge)
    return seen


def test_a_search_tries_and_goes_on(
    few_goals: list[Any], octoarm: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On so few steps that nothing is learnt from them yet."""
    learnt: list[Any] = []

    def make(*arguments: Any, **given: Any) -> Any:
        learnt.append(given["goals"])
        return OctoArmReachVectorEnv(*arguments, **given)

    # The goals of the environment that is trained in, not of the one that judges.
    monkeypatch.setattr(reaching, "OctoArmReachVectorEnv", make)
    command = ("reach", "tune", "sac", "--steps", 400, "--out", tmp_path)
    studies = []
    for trials in (1, 2):
        result = octoarm(*command, "--trials", trials)
        assert result.exit_code == 0, result.output
        studies.append(json.loads((tmp_path / "study.json").read_text("utf-8")))
        for number in range(2):
            assert result.output.count(f"trial {number}: ") == (number == trials - 1)
    first, second = studies
    assert first["best"]["hyperparameters"] == start("sac").entries()
    assert [each["number"] for each in second["trials"]] == [0, 1]
    assert second["trials"][:1] == first["trials"]
    complete = [each for each in second["trials"] if not each["pruned"]]
    assert second["best"]["value"] == max(each["value"] for each in complete)
    for each in complete:
        assert each["value"] == each["values"][-1]
    tuned = Hyperparameters.load("sac", tmp_path / "reach_sac.yml", REACH_ID)
    assert tuned.entries() == second["best"]["hyperparameters"]
    # The held-out goals are neither learnt from nor judged on.
    assert len(learnt) == 2
    for goals in learnt:
        np.testing.assert_array_equal(goals, search_goals())
    for goals in few_goals:
        np.testing.assert_array_equal(goals, validation_goals())
    refused = octoarm(*command, "--trials", 2, "--jobs", 2)
    assert refused.exit_code == 2
    assert "only with --cluster" in refused.output


def test_a_trial_is_worth_what_it_reaches_and_holds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shares = iter([(0.25, 0.0), (0.5, 0.25), (1.0, 0.5)])

    def train(*arguments: Any, **given: Any) -> None:
        for success, held in shares:
            given["progress"]({"success": success, "held": held})

    monkeypatch.setattr(reach_tuning, "train_reaching", train)
    study = tune_reaching("sac", tmp_path, trials=1)
    assert study["trials"][0]["values"] == [0.125, 0.375, 0.75]
    assert study["best"]["value"] == 0.75
    with pytest.raises(ValueError, match="expected at least one"):
        tune_reaching("sac", tmp_path)
    with pytest.raises(ValueError, match="steps = 0"):
        tune_reaching("sac", tmp_path, trials=1, steps=0)


def test_training_takes_a_file_of_hyperparameters(
    few_goals: list[Any], octoarm: Any, tmp_path: Path
) -> None:
    given = start("ppo")
    changed = {"n_steps": 300, "batch_size": 400, "n_epochs": 1, "learning_rate": "lin_0.002"}
    entries = replace(given, num_envs=4, arguments=given.arguments | changed).entries()
    file = tmp_path / "mine.yml"
    command = ("reach", "train", "ppo", "--steps", 1000, "--evaluations", 3)
    command = (*command, "--hyperparameters", file)
    file.write_text(yaml.safe_dump({REACH_ID: entries}), encoding="utf-8")
    result = octoarm(*command, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    training = json.loads((tmp_path / "out" / "training.json").read_text("utf-8"))
    assert training["hyperparameters"] == entries
    assert training["envs"] == 4
    # A rollout is longer than all steps; the evaluations asked for are made all the same.
    assert [point["steps"] for point in training["curve"]] == [1200] * 3
    assert training["finished"]
    wrong = {
        "no entry 'OctoArmReach-v0'": {"OctoArm-v0": entries},
        "hyper-parameters of ppo: ": {REACH_ID: entries | {"tau": 0.1}},
        "replay_buffer_class = 'Other'": {REACH_ID: entries | {"replay_buffer_class": "Other"}},
    }
    for number, (reason, content) in enumerate(wrong.items()):
        file.write_text(yaml.safe_dump(content), encoding="utf-8")
        refused = octoarm(*command, "--out", tmp_path / str(number))
        assert refused.exit_code == 2
        assert reason in " ".join(refused.output.replace("│", " ").split())
