"""How far a trajectory is from an orbit, how fast it turns; whether it holds it, and since when."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from octoarm_env.arrays import Float

_CHUNK = 1024
"""Points treated at a time, so that the table of all distances stays small."""


def orbit_distance(points: Float, orbit: Float) -> Float:
    """Distance of each point to a closed curve, in the unit of both.

    The curve is the polygon of its samples. Its nearest point lies on a chord with an end no
    farther away than the nearest sample is, plus half a chord; only such chords are tried.

    Args:
        points: (T, 2).
        orbit: (K, 2), samples in order; a chord joins the last to the first.

    Returns:
        (T,), not negative.
    """
    distances = np.empty(len(points))
    before, after = np.roll(orbit, 1, axis=0), np.roll(orbit, -1, axis=0)
    half_chord = 0.5 * float(np.hypot(*(after - orbit).T).max())
    norms = np.einsum("kc,kc->k", orbit, orbit)
    rounding = 1e-12 * float(norms.max())
    for begin in range(0, len(points), _CHUNK):
        chunk = points[begin : begin + _CHUNK]
        # |p - v|² = |p|² - 2 p·v + |v|², for all samples v at once.
        squares = norms - 2 * (chunk @ orbit.T)
        squares += np.einsum("tc,tc->t", chunk, chunk)[:, np.newaxis]
        nearest = np.sqrt(np.maximum(squares.min(axis=1), 0.0))
        limits = (nearest + half_chord) ** 2 * (1 + 1e-12) + rounding
        rows, columns = np.nonzero(squares <= limits[:, np.newaxis])
        candidates = np.minimum(
            _chord_distance(chunk[rows], orbit[columns], before[columns]),
            _chord_distance(chunk[rows], orbit[columns], after[columns]),
        )
        firsts = np.searchsorted(rows, np.arange(len(chunk)))
        distances[begin : begin + _CHUNK] = np.minimum.reduceat(candidates, firsts)
    return distances


def _chord_distance(points: Float, begins: Float, ends: Float) -> Float:
    """Distance of each point to its chord; all (T, 2)."""
    chords = ends - begins
    offsets = points - begins
    squares = np.einsum("tc,tc->t", chords, chords)
    along = np.einsum("tc,tc->t", offsets, chords)
    fractions = np.divide(along, squares, out=np.zeros_like(along), where=squares > 0)
    offsets -= np.clip(fractions, 0.0, 1.0)[:, np.newaxis] * chords
    distances: Float = np.hypot(offsets[:, 0], offsets[:, 1])
    return distances


def upward_crossings(signal: Float) -> Float:
    """Where a signal (T,) crosses zero upward, interpolated [samples]."""
    ups = np.flatnonzero((signal[:-1] < 0) & (signal[1:] >= 0))
    crossings: Float = ups - signal[ups] / (signal[ups + 1] - signal[ups])
    return crossings


def turn_time(signal: Float) -> float:
    """Mean time of a turn: samples between upward zero crossings, interpolated.

    Args:
        signal: (T,), an oscillation about zero with one upward crossing a turn.

    Returns:
        Samples a turn; NaN if the signal crosses zero upward fewer than twice.
    """
    crossings = upward_crossings(signal)
    if len(crossings) < 2:
        return float("nan")
    return float(crossings[-1] - crossings[0]) / (len(crossings) - 1)


def is_held(
    distance: Float | float, period: Float | float, *, distance_limit: float, period_limit: float
) -> NDArray[np.bool_]:
    """Whether arms hold a cycle: near its orbit, and turning at its pace.

    An arm at rest is near every orbit through the origin: how far it swings must be asked too.

    Args:
        distance: mean distance from the orbit, in amplitudes; infinite where an arm was lost.
        period: time of a turn in periods of the target; NaN where an arm does not turn.
        distance_limit: largest distance.
        period_limit: part by which the period may be off.
    """
    held: NDArray[np.bool_] = (distance <= distance_limit) & (np.abs(period - 1) <= period_limit)
    return held


def steps_to_return(distances: Float, limit: float) -> NDArray[np.int_]:
    """Steps until distances (T, …) stay within a limit; T where the last one is beyond it."""
    outside = distances > limit
    if len(outside) == 0:
        return np.zeros(outside.shape[1:], dtype=int)
    return np.where(outside.any(axis=0), len(outside) - np.argmax(outside[::-1], axis=0), 0)
