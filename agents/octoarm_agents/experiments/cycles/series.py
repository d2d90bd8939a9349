"""Excerpts of a closed loop's run for the figures, and where on the cycle it is."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from octoarm_agents.common.orbit import turn_time, upward_crossings
from octoarm_agents.experiments.runner import round_numbers
from octoarm_env.arrays import Float


def excerpt(
    begin: int, outputs: Float, target: Float, lengths: Float | None = None, *, every: int = 5
) -> dict[str, Any]:
    """Every few steps of a run, to seven digits: they are for looking at."""
    series: dict[str, Any] = {
        "step": list(range(begin, begin + len(outputs), every)),
        "outputs_deg": round_numbers(outputs[::every].T),
        "target_deg": round_numbers(target[::every].T),
    }
    if lengths is not None:
        # Spring 1 of five compartments from the base to the tip.
        columns = 4 * np.linspace(0, lengths.shape[1] // 4 - 1, 5).round().astype(int)
        series["compartments"] = (1 + columns // 4).tolist()
        series["lengths_metres"] = round_numbers(lengths[::every, columns].T)
    return series


def align_orbit(outputs: Float, orbit: Float, turn: float) -> Float:
    """The target in time with some outputs (T, 2), at the phase at which it fits them best."""
    count = len(orbit)
    phases = np.arange(len(outputs)) / turn * count

    def shifted(shift: int) -> Float:
        positions = phases + shift
        whole = np.floor(positions).astype(int)
        part = (positions - whole)[:, np.newaxis]
        at: Float = (1 - part) * orbit[whole % count] + part * orbit[(whole + 1) % count]
        return at

    errors = [float(np.square(shifted(k) - outputs).sum()) for k in range(0, count, 8)]
    best = 8 * int(np.argmin(errors))
    near = range(best - 8, best + 9)
    return shifted(min(near, key=lambda k: float(np.square(shifted(k) - outputs).sum())))


def phase_shift(before: Float, after: Float, between: int) -> float | None:
    """By how much the turns of `after` are late, in turns from -0.5 to 0.5.

    Args:
        before: (T,), an output that turns steadily.
        after: (S,), the same later.
        between: steps from the begin of `before` to that of `after`.

    Returns:
        None if one of them does not turn.
    """
    turn = turn_time(before)
    first, last = upward_crossings(before), upward_crossings(after)
    if not len(last) or not math.isfinite(turn):
        return None
    turns = (between + float(last[0]) - float(first[0])) / turn
    return turns - round(turns)
