"""Arms driven side by side: several at once take little longer than one alone."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np

from octoarm_env import Arm, ArmBatch, DomainError
from octoarm_env.arrays import Float

Recording = Float | DomainError

LANES = 8
"""Arms that one thread steps at once; a group of them takes as long however few there are."""

_FEWEST = 3
"""Arms from which on a group is faster than each of them alone."""


def record_arms(arms: Sequence[Arm], angles: Sequence[Float]) -> list[Recording]:
    """Drive every arm along commands of its own, all in one thread.

    Args:
        arms: of any bodies; their states are copied, so that one may be given several times.
        angles: θ and φ of each arm, (T, 2) [degrees]; T > 0 may differ from arm to arm.

    Returns:
        For each arm what `Arm.run` gives it alone, to the bit: its spring lengths after each step,
        (T, 4 n) [m], or the error that stopped it, whose ``lengths`` may be None.

    Raises:
        ValueError: angles that are not finite or beyond ±3600 degrees.
    """
    alike: dict[int, list[int]] = {}
    for index, arm in enumerate(arms):
        alike.setdefault(arm.parameters.compartments, []).append(index)
    recordings: dict[int, Recording] = {}
    for indices in alike.values():
        for begin in range(0, len(indices), LANES):
            group = indices[begin : begin + LANES]
            record = _record_alone if len(group) < _FEWEST else _record_together
            recorded = record([arms[index] for index in group], [angles[index] for index in group])
            recordings.update(zip(group, recorded, strict=True))
    return [recordings[index] for index in range(len(arms))]


def _record_alone(arms: Sequence[Arm], angles: Sequence[Float]) -> list[Recording]:
    recordings: list[Recording] = []
    for arm, commands in zip(arms, angles, strict=True):
        try:
            recordings.append(copy.deepcopy(arm).run(commands))
        except DomainError as error:
            recordings.append(error)
    return recordings


def _record_together(arms: Sequence[Arm], angles: Sequence[Float]) -> list[Recording]:
    """Record arms of as many compartments each."""
    steps = [len(commands) for commands in angles]
    longest = max(steps)
    padded = [np.pad(each, ((0, longest - len(each)), (0, 0)), mode="edge") for each in angles]
    run = ArmBatch(arms, threads=1).run(np.stack(padded))
    recordings: list[Recording] = []
    for lengths, own, failure in zip(run.lengths, steps, run.failures, strict=True):
        # What happens beyond its own commands is nothing to an arm.
        if failure is None or failure.step >= own:
            recordings.append(lengths[:own])
        else:
            recordings.append(failure)
    return recordings
