"""How well a body does what the paper reports: one number, small for a good body.

With r the ratios of the body's mean squared errors to those of Table 2 (Task 1 at R = 60),

    score = Σ max(ln r, -0.1) + 0.5 max(0, ln r_worst).

A task that is done better than by the paper's body gains almost nothing, so that no task pays for
another; the second term weighs the worst one more. A body that cannot be used at all scores worse
than any that can, by how far it got, so that a search finds its way out of there too.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from octoarm_agents.experiments.task1 import (
    INITIAL_STEPS,
    PAPER,
    RANGE,
    TASKS,
    TEST_STEPS,
    TRAINING_STEPS,
    WASHOUT_STEPS,
    Drive,
    record_lengths,
    score_features,
)
from octoarm_agents.reservoir.emulation import emulation_targets
from octoarm_agents.reservoir.inputs import product_of_sines
from octoarm_env import LIMIT_CYCLES, Arm, ArmParameters, DomainError

__all__ = [
    "FAILURE",
    "TEACHER_STEPS",
    "evaluate_body",
    "follow_teacher",
    "initial_steps",
    "measure_task1",
    "score_ratios",
]

FAILURE = 50.0
"""A score from here on is that of a body that left its domain; ln r sums up to 10 where the readout
gives no more than the linear regressor of Table 2."""

LARGEST_GAIN = 0.1
WORST_WEIGHT = 0.5
"""Of the score: the largest gain from an error below the paper's, the weight of the worst task."""

TEACHER_STEPS = 10_000
"""Steps for which a teacher forces the resting arm: onto the cycle, and several turns of it."""


def initial_steps(count: int) -> list[int]:
    """T_ini of so many runs of Task 1, evenly over the range of section 2.2.1.

    Args:
        count: at least 1; a single one is in the middle.
    """
    if count < 1:
        raise ValueError(f"count = {count}: expected at least 1")
    if count == 1:
        return [INITIAL_STEPS // 2]
    return [round(value) for value in np.linspace(0, INITIAL_STEPS, count)]


@functools.lru_cache(maxsize=8)
def _drive(initial: int) -> Drive:
    """Task 1 with a given T_ini."""
    rest = WASHOUT_STEPS + TRAINING_STEPS + TEST_STEPS
    longest = product_of_sines(INITIAL_STEPS + rest)
    signal = longest[: initial + rest]
    return Drive(signal, emulation_targets(signal), initial, float(np.abs(longest).max()))


def measure_task1(parameters: ArmParameters, initial: int) -> dict[str, float]:
    """Errors of the body's readout as ratios to those of Table 2.

    Args:
        parameters: the body.
        initial: T_ini, 0 to `INITIAL_STEPS`.

    Returns:
        The ratio of each of `TASKS`; below 1 the body is better than the paper's.

    Raises:
        DomainError: the arm left its domain; `step` says when.
        ValueError: a body that cannot rest, or of another timestep than the paper's.
    """
    drive = _drive(initial)
    # Sums split over threads are rounded otherwise.
    with threadpool_limits(1):
        scores, _ = score_features(record_lengths(parameters, drive, RANGE), drive)
    return {task: scores["test"][task] / PAPER[task]["arm"][0] for task in TASKS}


def score_ratios(ratios: Mapping[str, float]) -> float:
    """The score of a body that stayed in its domain; see above, at most `FAILURE`."""
    logarithms = [math.log(ratio) for ratio in ratios.values()]
    gains = sum(max(value, -LARGEST_GAIN) for value in logarithms)
    return min(gains + WORST_WEIGHT * max(0.0, *logarithms), FAILURE)


def follow_teacher(parameters: ArmParameters, target: str, amplitude: float) -> int:
    """Steps for which the body on a direct base can be forced along a limit cycle.

    Args:
        parameters: the body.
        target: name of the cycle.
        amplitude: R, its largest angle [degrees].

    Returns:
        `TEACHER_STEPS` for a body that stays in its domain.

    Raises:
        ValueError: a body that cannot rest.
    """
    try:
        Arm(parameters).run(LIMIT_CYCLES[target].signal(TEACHER_STEPS, amplitude))
    except DomainError as error:
        return error.step
    return TEACHER_STEPS


def evaluate_body(
    parameters: ArmParameters, initial: int, amplitudes: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """Judge a body by Task 1, and by whether it can be taught some cycles at all.

    Args:
        parameters: the body.
        initial: T_ini.
        amplitudes: R by cycle, which the body must be able to follow on a direct base [degrees].

    Returns:
        ``score``; ``ratios`` by task, None if the arm left its domain in Task 1; ``failure``: None,
        or where (``stage``: ``"rest"``, ``"task1"`` or a cycle) and after which ``part`` of it. The
        score of a failure is `FAILURE` plus the stages that were not completed.
    """
    stages = 1 + len(amplitudes or {})
    try:
        ratios = measure_task1(parameters, initial)
    except DomainError as error:
        steps = _drive(initial).test.stop
        return _failed(None, "task1", error.step / steps, stages)
    except ValueError as error:  # no static equilibrium
        failed = _failed(None, "rest", 0.0, stages)
        failed["failure"]["message"] = str(error)
        return failed
    for index, (target, amplitude) in enumerate((amplitudes or {}).items()):
        part = follow_teacher(parameters, target, amplitude) / TEACHER_STEPS
        if part < 1:
            return _failed(ratios, target, part, stages - 1 - index)
    return {"score": score_ratios(ratios), "ratios": ratios, "failure": None}


def _failed(
    ratios: dict[str, float] | None, stage: str, part: float, remaining: int
) -> dict[str, Any]:
    return {
        "score": FAILURE + remaining - part,
        "ratios": ratios,
        "failure": {"stage": stage, "part": part},
    }
