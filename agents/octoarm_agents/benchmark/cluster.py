"""What a call costs beside its own work: on a Ray cluster, and in processes of this machine."""

from __future__ import annotations

import functools

import numpy as np

from octoarm_agents.benchmark.turns import (
    Advance,
    Comparison,
    Contender,
    Result,
    fitted,
    take_turns,
    timed,
)
from octoarm_agents.common.workers import Cluster, Jobs, map_unordered
from octoarm_env import Arm

EMPTY, TRIAL = "milliseconds_per_empty_call", "milliseconds_per_trial"

HERE, PROCESSES = "this process", "2 processes, joblib"
RAY_ALONE, RAY = "Ray, 1 at once", "Ray, 2 at once"
PLACES: dict[str, Jobs] = {HERE: 1, PROCESSES: 2, RAY_ALONE: Cluster(1), RAY: Cluster(2)}

STEPS = 20_000
"""Physics steps of a trial: some thirty milliseconds of an idle processor."""

_CALLS = 4
"""Calls are made by so many, so that two at once are never short of one."""


def measure_cluster(
    seconds: float = 30.0, rounds: int = 11, advance: Advance | None = None
) -> Result:
    """Time empty calls, and trials of `STEPS` physics steps, in turns.

    This process must be connected to a cluster (`Cluster.connect`), best of two processors or more.
    Processes that start, and what they import, are not counted.

    Args:
        seconds: time for all slices together.
        rounds: slices of each contender.
        advance: called with a contender's name and the number of slices in all, after each slice.
    """
    contenders = [_contender(name, jobs) for name, jobs in PLACES.items()]
    result = take_turns(contenders, seconds, rounds, advance)
    result.comparisons = [
        Comparison("ray_beyond", "an empty call: Ray beyond joblib", RAY, PROCESSES, "ms"),
        Comparison("ray_over", "a trial, 2 at once: Ray / joblib", RAY, PROCESSES, figure=TRIAL),
        Comparison("ray_scaling", "a trial on Ray: 1 / 2 at once", RAY_ALONE, RAY, figure=TRIAL),
        Comparison("scaling", "a trial: here / in 2 processes", HERE, PROCESSES, figure=TRIAL),
    ]
    result.packages = ["joblib", "ray"]
    return result


def _contender(name: str, jobs: Jobs) -> Contender:
    empty, trial = (
        fitted(
            figure,
            1000 / _CALLS,
            timed(lambda: None, functools.partial(_compute, jobs, steps)),
            10_000,
        )
        for figure, steps in ((EMPTY, 0), (TRIAL, STEPS))
    )
    return Contender(name, lambda seconds: empty(seconds / 4) | trial(3 * seconds / 4))


def _compute(jobs: Jobs, steps: int, count: int) -> None:
    for _ in map_unordered(_move, [(steps,)] * (_CALLS * count), jobs):
        pass


def _move(steps: int) -> float:
    """Move an arm; its last length [m], 0 without a step."""
    if steps == 0:
        return 0.0
    return float(Arm().run(np.zeros((steps, 2)))[-1, -1])
