"""Rows as the measures need them: evenly spaced in time, without gaps, one for each input value."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from octoarm_agents.analysis.states import describe_gaps, name_column
from octoarm_env.arrays import Float, Integer

TIME_TOLERANCE = 0.2
"""How far an interval may be from the median one, or from a multiple of it, as a share of it."""

CHANGE = 0.05
"""An input has changed if it moved by more than this share of its standard deviation: a command
that was measured has noise. A change that is smaller is missed, which does no harm: the hold before
it is then taken for one of double length, and divided."""

MISFITS = 0.05
"""Largest share of holds of another length, where rows are lost say."""


def even_rows(times: Float, name: str, fill: int) -> tuple[Integer, float]:
    """Where rows belong on an evenly spaced clock, and its interval in the unit of `times`.

    Args:
        times: (T,), finite.
        name: of their column, for the error.
        fill: so many missing rows are allowed between two.

    Returns:
        Row numbers (T,), from 0 on, rising; where one is left out rows are missing.

    Raises:
        ValueError: times that do not rise, are not evenly spaced, or have longer gaps.
    """
    steps = np.diff(times)
    if not len(steps):
        return np.zeros(len(times), dtype=np.int64), 0.0
    back = np.flatnonzero(steps <= 0)
    if len(back):
        raise ValueError(
            f"time column {name!r}: {len(back)} of {len(steps)} times are not later than the one "
            f"before, the first in row {back[0] + 2}: expected times that rise, as finely resolved "
            "as the rows"
        )
    median = float(np.median(steps))
    regular = np.abs(steps / median - 1) <= TIME_TOLERANCE
    interval = float(steps[regular].mean())
    counts = np.rint(steps / interval)
    uneven = np.flatnonzero(np.abs(steps / interval - counts) > TIME_TOLERANCE)
    if len(uneven):
        raise ValueError(
            f"time column {name!r}: {len(uneven)} of {len(steps)} intervals are neither the usual "
            f"{median:.6g} nor a multiple of it, to {TIME_TOLERANCE:.0%}; the first is "
            f"{steps[uneven[0]]:.6g}, before row {uneven[0] + 2}: the measures need evenly spaced "
            "rows; interpolate them before, or leave --time-column out if the times are wrong"
        )
    missing = counts - 1
    if missing.max() > fill:
        gaps = np.flatnonzero(missing)
        raise ValueError(
            f"time column {name!r}: {missing.sum():.0f} rows are missing, in {len(gaps)} gaps, "
            f"the first before row {gaps[0] + 2}: --fill-gaps {missing.max():.0f} fills all; or "
            "cut the log at the longest ones"
        )
    return np.concatenate(([0], np.cumsum(counts))).astype(np.int64), interval


def without_gaps(
    values: Float, what: Literal["states", "input"], names: Sequence[str], fill: int
) -> tuple[Float, int]:
    """Values (T, k) with numbers in place of those that are missing or not finite.

    Args:
        values: of a log.
        what: States are filled on the straight line between the neighbours, an input with the last
            number before, as a command lasts; at the begin and the end both with the nearest.
        names: of the columns.
        fill: longest gap that is filled, in rows.

    Returns:
        The values, and how many were filled.

    Raises:
        ValueError: a longer gap; how many numbers are missing, and the remedy.
    """
    missing = ~np.isfinite(values)
    holes = np.flatnonzero(missing.any(axis=0))
    empty = np.flatnonzero(missing.all(axis=0))
    option = "--states-columns" if what == "states" else "--input-columns"
    if len(empty):
        raise ValueError(
            f"{what}: {len(empty)} of {values.shape[1]} columns have no numbers, the first is "
            f"{name_column(names[empty[0]])}: leave them out, with {option} in a text file"
        )
    longest = max((int(_run_lengths(missing[:, hole]).max()) for hole in holes), default=0)
    if longest > fill:
        raise ValueError(
            f"{describe_gaps(what, values, names)}. The longest gap has {longest} rows: "
            f"--fill-gaps {longest} fills all; or leave out the columns, with {option} in a text "
            "file, or the rows"
        )
    filled = values.copy()
    for hole in holes:
        present, gaps = np.flatnonzero(~missing[:, hole]), np.flatnonzero(missing[:, hole])
        if what == "input":
            last = np.maximum(np.searchsorted(present, gaps) - 1, 0)
            filled[gaps, hole] = values[present[last], hole]
        else:
            filled[gaps, hole] = np.interp(gaps, present, values[present, hole])
    return filled, int(missing.sum())


def held_rows(values: Float) -> int:
    """For how many rows each value of one input (T,) is held; 1 if it is not held.

    The usual length of the stretches without a change, if nearly all are about a multiple of it: of
    an input with few values a stretch may have several equal ones.
    """
    lengths = np.diff(_changes(values[:, np.newaxis]))
    if len(lengths) < 3:
        return 1
    hold = int(np.bincount(lengths).argmax())
    fits = _holds_within(lengths, hold) > 0
    return hold if float(fits.mean()) >= 0.9 else 1


def last_rows_of_holds(inputs: Float, hold: int) -> tuple[Integer, int]:
    """The last row of each hold of about `hold` rows, and how many holds have another length.

    A hold begins where an input changes, or where the one before ends; rows before the first whole
    one and after the last are left out.

    Raises:
        ValueError: too many stretches without a change are no multiple of the hold.
    """
    changes = _changes(inputs)
    if not len(changes):
        return np.arange(hold - 1, len(inputs), hold), 0
    lengths = np.diff(changes)
    holds = _holds_within(lengths, hold)
    misfits = np.flatnonzero(holds == 0)
    if len(misfits) > MISFITS * len(lengths):
        raise ValueError(
            f"--hold {hold}: in {len(misfits)} of {len(lengths)} stretches the input does not "
            f"change for another number of rows, first for {lengths[misfits[0]]} from row "
            f"{changes[misfits[0]] + 1} on; the shortest has {lengths.min()}, the longest "
            f"{lengths.max()}: the input must be the command, which changes once a hold"
        )
    holds[misfits] = np.maximum(np.rint(lengths[misfits] / hold), 1)
    whole = (changes[0] + _tolerance(hold)) // hold
    rows = [changes[0] - 1 - hold * np.arange(whole)[::-1]]
    for begin, length, count in zip(changes, lengths, holds, strict=False):
        rows.append(begin + np.rint(length * np.arange(1, count + 1) / count).astype(np.int64) - 1)
    whole = (len(inputs) - changes[-1] + _tolerance(hold)) // hold
    rows.append(np.minimum(changes[-1] + hold * np.arange(1, whole + 1), len(inputs)) - 1)
    found = np.concatenate(rows)
    return found[found >= 0], len(misfits)


def _changes(inputs: Float) -> Integer:
    """Rows in which any of the inputs (T, k) has another value than in the row before."""
    least = CHANGE * inputs.std(axis=0)
    return np.flatnonzero((np.abs(np.diff(inputs, axis=0)) > least).any(axis=1)) + 1


def _tolerance(hold: int) -> int:
    """By how many rows a hold may be longer or shorter: clocks of command and log differ."""
    return max(hold // 4, 1) if hold >= 3 else 0


def _holds_within(lengths: Integer, hold: int) -> Integer:
    """How many holds each stretch has; 0 if its length is no multiple, within the tolerance."""
    counts = np.rint(lengths / hold).astype(np.int64)
    fits = np.abs(lengths - counts * hold) <= _tolerance(hold)
    return np.where(fits, counts, 0)


def _run_lengths(flags: NDArray[np.bool_]) -> Integer:
    """Lengths of the stretches in which `flags` (T,) are set."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(np.int8)))
    return edges[1::2] - edges[::2]
