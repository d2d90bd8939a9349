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
from collections.abc import Mapping, Sequence
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
    check_timestep,
    record_many,
    score_features,
)
from octoarm_agents.reservoir.emulation import emulation_targets
from octoarm_agents.reservoir.inputs import product_of_sines
from octoarm_agents.reservoir.recording import record_arms
from octoarm_env import LIMIT_CYCLES, Arm, ArmParameters, DomainError

__all__ = [
    "FAILURE",
    "TEACHER_STEPS",
    "evaluate_bodies",
    "evaluate_body",
    "follow_teachers",
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


def measure_task1(
    arms: Sequence[Arm], starts: Sequence[int]
) -> list[dict[str, float] | DomainError]:
    """Errors of the readouts of several arms as ratios to those of Table 2.

    Args:
        arms: at rest; they are left as they are, so that one may be given several times.
        starts: T_ini of each, 0 to `INITIAL_STEPS`.

    Returns:
        For each arm the ratio of each of `TASKS`, below 1 where it is better than the paper's; or
        the error that says where it left its domain. No arm's result depends on the others.

    Raises:
        ValueError: a body of another timestep than the paper's.
    """
    drives = [_drive(initial) for initial in starts]
    recordings = record_many(arms, drives, [RANGE] * len(drives))
    results: list[dict[str, float] | DomainError] = []
    for drive, recording in zip(drives, recordings, strict=True):
        if isinstance(recording, DomainError):
            results.append(recording)
            continue
        # Sums split over threads are rounded otherwise.
        with threadpool_limits(1):
            scores, _ = score_features(recording, drive)
        results.append({task: scores["test"][task] / PAPER[task]["arm"][0] for task in TASKS})
    return results


def score_ratios(ratios: Mapping[str, float]) -> float:
    """The score of a body that stayed in its domain; see above, at most `FAILURE`."""
    logarithms = [math.log(ratio) for ratio in ratios.values()]
    gains = sum(max(value, -LARGEST_GAIN) for value in logarithms)
    return min(gains + WORST_WEIGHT * max(0.0, *logarithms), FAILURE)


def follow_teachers(
    arms: Sequence[Arm], targets: Sequence[str], amplitudes: Sequence[float]
) -> list[int]:
    """Steps for which arms on direct bases can be forced along limit cycles.

    Args:
        arms: at rest; they are left as they are, so that one may be given several times.
        targets: name of the cycle of each.
        amplitudes: R of each, its largest angle [degrees].

    Returns:
        For each arm `TEACHER_STEPS` if it stays in its domain, else the steps until it left it.
    """
    angles = [
        LIMIT_CYCLES[target].signal(TEACHER_STEPS, amplitude)
        for target, amplitude in zip(targets, amplitudes, strict=True)
    ]
    return [
        recording.step if isinstance(recording, DomainError) else TEACHER_STEPS
        for recording in record_arms(arms, angles)
    ]


def evaluate_bodies(
    bodies: Sequence[ArmParameters],
    initial: int,
    amplitudes: Mapping[str, float] | None = None,
) -> list[dict[str, Any]]:
    """Judge bodies by Task 1, and by whether they can be taught some cycles at all.

    Together they take less time than one by one, and memory for the spring lengths of all: 11 MB a
    body of 20 compartments. No body's result depends on the others.

    Args:
        bodies: to judge.
        initial: T_ini.
        amplitudes: R by cycle, which a body must be able to follow on a direct base [degrees].

    Returns:
        For each body ``score``; ``ratios`` by task, None if the arm left its domain in Task 1;
        ``failure``: None, or where (``stage``: ``"rest"``, ``"task1"`` or a cycle) and after which
        ``part`` of it. The score of a failure is `FAILURE` plus the stages that were not completed.
    """
    cycles = list((amplitudes or {}).items())
    results: dict[int, dict[str, Any]] = {}
    arms: dict[int, Arm] = {}
    for index, body in enumerate(bodies):
        try:
            check_timestep(body)
            arms[index] = Arm(body)
        except ValueError as error:  # no static equilibrium
            results[index] = _failed(None, "rest", 0.0, 1 + len(cycles))
            results[index]["failure"]["message"] = str(error)
    ratios: dict[int, dict[str, float]] = {}
    measured = measure_task1(list(arms.values()), [initial] * len(arms))
    for index, outcome in zip(list(arms), measured, strict=True):
        if isinstance(outcome, DomainError):
            part = outcome.step / _drive(initial).test.stop
            results[index] = _failed(None, "task1", part, 1 + len(cycles))
            del arms[index]
        else:
            ratios[index] = outcome
    for stage, (target, amplitude) in enumerate(cycles):
        steps = follow_teachers(list(arms.values()), [target] * len(arms), [amplitude] * len(arms))
        for index, made in zip(list(arms), steps, strict=True):
            if made < TEACHER_STEPS:
                part = made / TEACHER_STEPS
                results[index] = _failed(ratios[index], target, part, len(cycles) - stage)
                del arms[index]
    for index in arms:
        score = score_ratios(ratios[index])
        results[index] = {"score": score, "ratios": ratios[index], "failure": None}
    return [results[index] for index in range(len(bodies))]


def evaluate_body(
    parameters: ArmParameters, initial: int, amplitudes: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """Judge one body, see `evaluate_bodies`."""
    return evaluate_bodies([parameters], initial, amplitudes)[0]


def _failed(
    ratios: dict[str, float] | None, stage: str, part: float, remaining: int
) -> dict[str, Any]:
    return {
        "score": FAILURE + remaining - part,
        "ratios": ratios,
        "failure": {"stage": stage, "part": part},
    }
