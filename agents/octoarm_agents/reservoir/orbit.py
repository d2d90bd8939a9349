"""How far a trajectory is from an orbit, and how fast it turns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["orbit_distance", "turn_time"]

Float = NDArray[np.float64]

_CHUNK = 2048
"""Points treated at a time, so that the table of all distances stays small."""


def orbit_distance(points: Float, orbit: Float) -> Float:
    """Distance of each point to a closed curve, in the unit of both.

    The nearest sample of the curve is sought, then the nearest point on the two chords that meet
    there. For a point nearer to the curve than the curve's turns are to each other this is the
    distance to the polygon; elsewhere it exceeds that by less than half a chord.

    Args:
        points: (T, 2).
        orbit: (K, 2), samples in order; a chord joins the last to the first.

    Returns:
        (T,), not negative.
    """
    distances = np.empty(len(points))
    half_squares = 0.5 * np.einsum("kc,kc->k", orbit, orbit)
    for begin in range(0, len(points), _CHUNK):
        chunk = points[begin : begin + _CHUNK]
        nearest = np.argmin(half_squares - chunk @ orbit.T, axis=1)
        vertex = orbit[nearest]
        before = orbit[nearest - 1]
        after = orbit[(nearest + 1) % len(orbit)]
        distances[begin : begin + _CHUNK] = np.minimum(
            _chord_distance(chunk, vertex, before), _chord_distance(chunk, vertex, after)
        )
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


def turn_time(signal: Float) -> float:
    """Mean time of a turn: samples between upward zero crossings, interpolated.

    Args:
        signal: (T,), an oscillation about zero with one upward crossing a turn.

    Returns:
        Samples a turn; NaN if the signal crosses zero upward fewer than twice.
    """
    ups = np.flatnonzero((signal[:-1] < 0) & (signal[1:] >= 0))
    if len(ups) < 2:
        return float("nan")
    crossings = ups - signal[ups] / (signal[ups + 1] - signal[ups])
    return float(crossings[-1] - crossings[0]) / (len(crossings) - 1)
