"""Counts and seeds wherever the agents' Python takes them: whole numbers, or an error by name."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from octoarm_agents.analysis.lyapunov import largest_lyapunov_exponent
from octoarm_agents.analysis.survey import SurveySettings
from octoarm_agents.calibration.score import initial_steps
from octoarm_agents.common.whole import whole_fields, whole_number
from octoarm_agents.comparison import Comparison, TestPlan
from octoarm_agents.comparison.agents import TrainingRun
from octoarm_agents.comparison.linear_search import LinearSearch
from octoarm_agents.demo import DemoSettings
from octoarm_agents.experiments.runner import RunSettings
from octoarm_agents.policies import load_trained
from octoarm_agents.policies.evaluation import evaluate_policy
from octoarm_agents.policies.rollout import HoldPolicy, Noise, Push, roll_out
from octoarm_agents.reservoir import train_policy
from octoarm_agents.reservoir.closed_loop import ClosedLoop
from octoarm_agents.reservoir.inputs import smooth_noise
from octoarm_agents.reservoir.teaching import Teaching
from octoarm_agents.rl import Training
from octoarm_agents.viewing.episode import Episode

from octoarm_env import Arm, OctoArmVectorEnv


def home() -> Any:
    return load_trained("readout_pinv", "quadratic")


CALLS: dict[str, tuple[str, Any]] = {
    "evaluate_policy steps": ("steps", lambda n: evaluate_policy("hold", home(), steps=n)),
    "evaluate_policy episodes": ("episodes", lambda n: evaluate_policy("hold", home(), episodes=n)),
    "roll_out": ("steps", lambda n: roll_out(HoldPolicy(), None, seed=0, steps=n)),  # type: ignore[arg-type]
    "roll_out seed": ("seed", lambda n: roll_out(HoldPolicy(), None, seed=n)),  # type: ignore[arg-type]
    "Episode": ("steps", lambda n: Episode("hold", OctoArmVectorEnv(1), seed=0, steps=n)),
    "Push": ("steps", lambda n: Push(1.0, steps=n)),
    "Noise": ("begin", lambda n: Noise(1e-5, begin=n)),
    "train_policy": ("steps", lambda n: train_policy(steps=n)),
    "Teaching": ("steps", lambda n: Teaching("quadratic", 90.0, 1e-4, steps=n)),
    "Teaching washout": ("washout", lambda n: Teaching("quadratic", 90.0, 1e-4, washout=n)),
    "ClosedLoop": ("steps", lambda n: ClosedLoop(Arm(), np.zeros((80, 2)), 90.0).run(n)),
    "input": ("steps", lambda n: smooth_noise(n, np.random.default_rng(0))),
    "Training": ("steps", lambda n: Training.make("ppo", "quadratic", steps=n)),
    "LinearSearch": ("population", lambda n: LinearSearch("quadratic", population=n)),
    "TestPlan": ("episodes", lambda n: TestPlan(episodes=n)),
    "Comparison": ("seeds", lambda n: Comparison(seeds=n)),
    "TrainingRun": ("seed", lambda n: TrainingRun("ppo", "quadratic", n, 1.0, Path())),
    "DemoSettings": ("steps", lambda n: DemoSettings(steps=n)),
    "RunSettings": ("trials", lambda n: RunSettings(Path(), trials=n)),
    "SurveySettings": ("samples", lambda n: SurveySettings(samples=n)),
    "initial_steps": ("trials", initial_steps),
    "lyapunov": ("steps", lambda n: largest_lyapunov_exponent(lambda s, k: s, np.ones(2), n)),
}


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize("value", [20_000.0, 1.5, "7", True, np.float64(3), -1], ids=repr)
def test_what_is_no_count_is_named(call: str, value: Any) -> None:
    name, function = CALLS[call]
    with pytest.raises(ValueError, match=rf"^{name} = .*: expected a whole number, at least \d"):
        function(value)


def test_whole_numbers_are_python_s() -> None:
    for value in (3, np.int64(3), np.uint8(3)):
        found = whole_number("steps", value, 3)
        assert (found, type(found)) == (3, int)
    with pytest.raises(ValueError, match="steps = 2: expected a whole number, at least 3"):
        whole_number("steps", 2, 3)


def test_fields_become_python_s_so_that_they_can_be_written_down() -> None:
    assert type(TestPlan(episodes=np.int64(4)).episodes) is int  # type: ignore[arg-type]

    @dataclass(frozen=True)
    class Some:
        given: int
        left_out: int | None = None

    some = Some(np.int64(2))  # type: ignore[arg-type]
    whole_fields(some, given=0, left_out=1)
    assert (type(some.given), some.left_out) == (int, None)
    with pytest.raises(ValueError, match="given = None: expected a whole number, at least 0"):
        whole_fields(Some(None), given=0)  # type: ignore[arg-type]
