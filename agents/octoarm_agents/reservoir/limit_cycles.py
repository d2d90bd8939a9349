"""The limit cycles of Task 2 (Nakajima et al. 2013, section 2.2.2) as discrete signals in degrees.

A cycle is a planar flow x1(τ), x2(τ) whose own time τ advances by 0.01 a physics step. The two
oscillators (Eqs. 27 and 28) are integrated by the classical Runge-Kutta method at that step; the
Lissajous curve (Eq. 29) is evaluated. All are scaled so that, on the settled cycle, the variable
with the larger range reaches ±R degrees.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

__all__ = ["LIMIT_CYCLES", "LISSAJOUS", "QUADRATIC", "VAN_DER_POL", "LimitCycle"]

Float = NDArray[np.float64]
Flow = Callable[[float, float], tuple[float, float]]

TIME_PER_STEP = 0.01
"""Time of the cycle that passes in one physics step (section 2.2.2)."""

_START = (0.01, 0.01)
"""Where the oscillators start. On the cycle they would throw the resting base by R degrees within
one physics step."""

_SETTLING_TIME = 100.0
"""By then both oscillators are on their cycle to rounding: they attract at a rate of about 1."""

_FINE_STEP = 0.005
"""Step of the Runge-Kutta method on the settled cycle; its chords stray 2e-5 of R from the arc."""


@dataclass(frozen=True)
class LimitCycle:
    """A planar limit cycle.

    Attributes:
        name: the name used on the command line and by ``gym.make("OctoArm-v0", target=...)``.
        flow: x1, x2 to their time derivatives; None for the curve of Eq. 29, which is explicit.
    """

    name: str
    flow: Flow | None = None

    def signal(self, steps: int, amplitude: float) -> Float:
        """The signal from its start near the origin, one row a physics step.

        The Lissajous curve passes through the origin and starts there; the oscillators start at
        (0.01, 0.01), before scaling, and spiral out to their cycle within about a second.

        Args:
            steps: number of rows T, at least 1.
            amplitude: R, the largest angle on the settled cycle [degrees].

        Returns:
            (T, 2), x1 and x2 [degrees].
        """
        if steps < 1:
            raise ValueError(f"steps = {steps}: expected at least 1")
        if self.flow is None:
            samples = _lissajous(TIME_PER_STEP * np.arange(steps, dtype=np.float64))
        else:
            samples = _integrate(self.flow, _START, TIME_PER_STEP, steps)
        return self.scale(amplitude) * samples

    def orbit(self, amplitude: float) -> Float:
        """One turn of the settled cycle, finely sampled at equal intervals of time.

        Args:
            amplitude: R, the largest angle [degrees].

        Returns:
            (K, 2) [degrees], K above 1000; the curve closes from the last row to the first.
        """
        return self.scale(amplitude) * self._turn[1]

    def scale(self, amplitude: float) -> float:
        """Degrees per unit of x1 and x2 that bring the settled cycle to ±`amplitude` degrees."""
        if not (amplitude > 0 and math.isfinite(amplitude)):
            raise ValueError(f"amplitude = {amplitude}: expected a positive number of degrees")
        return amplitude / float(np.abs(self._turn[1]).max())

    @property
    def period(self) -> float:
        """Physics steps of one turn of the settled cycle; not a whole number."""
        return self._turn[0] / TIME_PER_STEP

    @cached_property
    def _turn(self) -> tuple[float, Float]:
        """Period in the cycle's own time, and one turn in its own units, (K, 2)."""
        if self.flow is None:
            count = round(2 * math.pi / _FINE_STEP)
            return 2 * math.pi, _lissajous(2 * math.pi / count * np.arange(count, dtype=np.float64))
        settled = _integrate(
            self.flow, _START, TIME_PER_STEP, round(_SETTLING_TIME / TIME_PER_STEP)
        )
        start = (float(settled[-1, 0]), float(settled[-1, 1]))
        # Both oscillators turn in less than 8; two turns hold two equal crossings of x1 = 0.
        fine = _integrate(self.flow, start, _FINE_STEP, round(16.0 / _FINE_STEP))
        x1 = fine[:, 0]
        ups = np.flatnonzero((x1[:-1] < 0) & (x1[1:] >= 0))
        crossings = ups - x1[ups] / (x1[ups + 1] - x1[ups])
        return float(crossings[1] - crossings[0]) * _FINE_STEP, fine[ups[0] + 1 : ups[1] + 1]


def _integrate(flow: Flow, start: tuple[float, float], step: float, count: int) -> Float:
    """`count` samples of the flow from `start` on, by the classical Runge-Kutta method."""
    samples = np.empty((count, 2))
    x, y = start
    half = 0.5 * step
    # Plain floats: for two numbers they are ten times faster than arrays.
    for row in range(count):
        samples[row] = x, y
        a1, b1 = flow(x, y)
        a2, b2 = flow(x + half * a1, y + half * b1)
        a3, b3 = flow(x + half * a2, y + half * b2)
        a4, b4 = flow(x + step * a3, y + step * b3)
        x += step / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        y += step / 6 * (b1 + 2 * b2 + 2 * b3 + b4)
    return samples


def _van_der_pol(x1: float, x2: float) -> tuple[float, float]:
    return x2, -x1 + (1 - x1 * x1) * x2


def _quadratic(x1: float, x2: float) -> tuple[float, float]:
    square = x1 * x1 + x2 * x2
    return x1 + x2 - 5 * x1 * square, -2 * x1 + x2 - x2 * square


def _lissajous(time: Float) -> Float:
    return np.stack((np.sin(2 * time), np.sin(time)), axis=1)


VAN_DER_POL = LimitCycle("van_der_pol", _van_der_pol)
"""Eq. 27."""
QUADRATIC = LimitCycle("quadratic", _quadratic)
"""Eq. 28."""
LISSAJOUS = LimitCycle("lissajous")
"""Eq. 29 with f_1 = 2, f_2 = 1."""

LIMIT_CYCLES = {cycle.name: cycle for cycle in (QUADRATIC, VAN_DER_POL, LISSAJOUS)}
"""All by name."""
