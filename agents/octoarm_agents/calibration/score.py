"""How well a body does what the paper reports: one number, small for a good body.

With r the ratios of the body's mean squared errors to those of Table 2 (Task 1 at R = 60), and c
the limit cycles of which the paper's own training makes something else than the paper reports (an
outcome that depends on the noise seed counts in part),

    score = 10 c + Σ max(ln r, -0.1) + 0.5 max(0, ln r_worst) + Σ max(0, ln(0.1 / r)).

The outcomes come first. A task that is done better than by the paper's body gains almost nothing,
so that no task pays for another; the third term weighs the worst one more; one that is done more
than ten times better is that of another body, and costs. A body that cannot be used at all scores
worse than any that can, by how far it got, so that a search finds its way out of there too.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from octoarm_agents.calibration.evaluation import Judgement
from octoarm_agents.calibration.outcomes import count_contradictions, plain_outcomes
from octoarm_agents.common.lanes import record_arms
from octoarm_agents.common.whole import whole_number
from octoarm_agents.experiments.emulation.protocol import (
    INITIAL_STEPS,
    PAPER,
    RANGE,
    TASKS,
    TrialInput,
    check_timestep,
    record_many,
    score_features,
)
from octoarm_env import LIMIT_CYCLES, Arm, ArmParameters, DomainError

FAILURE = 50.0
"""A score from here on is that of a body that left its domain; ln r sums up to 10 where the readout
gives no more than the linear regressor of Table 2."""

OUTCOME_WEIGHT = 10.0
LARGEST_GAIN = 0.1
WORST_WEIGHT = 0.5
SMALLEST_RATIO = 0.1
"""Of the score: the weight of a limit cycle that ends otherwise than in the paper, the largest gain
from an error below the paper's, the weight of the worst task, the ratio below which an error is too
small."""

SCORE = (
    f"{OUTCOME_WEIGHT:g} (limit cycles that end otherwise than in the paper)"
    f" + Σ max(ln r, -{LARGEST_GAIN:g}) + {WORST_WEIGHT:g} max(0, ln r of the worst task)"
    f" + Σ max(0, ln({SMALLEST_RATIO:g} / r)),"
    f" r = mean squared error / that of Table 2, Task 1 at R = {RANGE:g} degrees;"
    f" from {FAILURE:g} on: the body left its domain"
)
"""The score in words, for the file of a calibration."""

TEACHER_STEPS = 10_000
"""Steps for which a teacher forces the resting arm: onto the cycle, and several turns of it."""


def initial_steps(trials: int) -> list[int]:
    """T_ini of so many runs of Task 1, evenly over the range of section 2.2.1.

    Args:
        trials: number of runs, at least 1; a single one is in the middle.
    """
    trials = whole_number("trials", trials, 1)
    if trials == 1:
        return [INITIAL_STEPS // 2]
    return [round(value) for value in np.linspace(0, INITIAL_STEPS, trials)]


_drive = functools.lru_cache(maxsize=8)(TrialInput.of_sines)


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
    too_good = sum(max(0.0, math.log(SMALLEST_RATIO) - value) for value in logarithms)
    return min(gains + WORST_WEIGHT * max(0.0, *logarithms) + too_good, FAILURE)


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
    noise_seeds: int = 0,
) -> list[Judgement]:
    """Judge bodies by the paper's training, by Task 1, and by whether they can be taught at all.

    Together they take less time than one by one, and memory for the spring lengths of all: 11 MB a
    body of 20 compartments. No body's result depends on the others.

    Args:
        bodies: to judge.
        initial: T_ini.
        amplitudes: R by cycle, which a body must be able to follow on a direct base [degrees].
        noise_seeds: trainings of each limit cycle, see `plain_outcomes`; 0: none.
    """
    cycles = list((amplitudes or {}).items())
    judged = [Judgement() for _ in bodies]
    arms: dict[int, Arm] = {}

    def fail(index: int, stage: str, part: float, remaining: int, **more: str) -> None:
        judged[index].score = FAILURE + remaining - part
        judged[index].failure = {"stage": stage, "part": part} | more
        arms.pop(index, None)

    for index, body in enumerate(bodies):
        try:
            check_timestep(body)
            arms[index] = Arm(body)
        except ValueError as error:  # no static equilibrium
            fail(index, "rest", 0.0, 1 + len(cycles), message=str(error))
    measured = measure_task1(list(arms.values()), [initial] * len(arms))
    for index, outcome in zip(list(arms), measured, strict=True):
        if isinstance(outcome, DomainError):
            fail(index, "task1", outcome.step / _drive(initial).test.stop, 1 + len(cycles))
        else:
            judged[index].ratios, judged[index].score = outcome, score_ratios(outcome)
    for stage, (target, amplitude) in enumerate(cycles):
        steps = follow_teachers(list(arms.values()), [target] * len(arms), [amplitude] * len(arms))
        for index, made in zip(list(arms), steps, strict=True):
            if made < TEACHER_STEPS:
                fail(index, target, made / TEACHER_STEPS, len(cycles) - stage)
    for index in arms if noise_seeds else ():
        judged[index].outcomes = outcomes = plain_outcomes(bodies[index], noise_seeds)
        score = judged[index].score + OUTCOME_WEIGHT * count_contradictions(outcomes)
        judged[index].score = min(score, FAILURE)
    return judged
