"""What the base is driven with in Task 1: In(t) and the angles it becomes (Eqs. 16-17)."""

from __future__ import annotations

import math

import numpy as np

from octoarm_agents.common.whole import whole_number
from octoarm_env.arrays import Float

TIMESTEP = 0.001
"""dt of Eqs. 17 and 23 [s]; the arm of every experiment makes one physics step in it."""

FREQUENCIES = (2.11, 3.73, 4.33)
"""f_1, f_2, f_3 of Eq. 17 [Hz]."""

PEAK = 0.2
"""Factor of Eq. 17, and the largest value that `smooth_noise` can take."""


def product_of_sines(steps: int, *, timestep: float = TIMESTEP) -> Float:
    """In(t) of Eq. 17: 0.2 sin(2π f_1 t dt) sin(2π f_2 t dt) sin(2π f_3 t dt).

    By the product formulas this is four sinusoids, of f_1 + f_2 - f_3 = 1.51, 2.71, 5.95 and
    10.17 Hz: all of its past is a linear function of eight delayed values.

    Args:
        steps: T, number of timesteps, from t = 0.
        timestep: dt [s].

    Returns:
        (T,), within ±0.2, without unit.

    Raises:
        ValueError: a negative number of steps.
    """
    steps = whole_number("steps", steps)
    time = np.arange(steps) * timestep
    signal = np.full(steps, PEAK)
    for frequency in FREQUENCIES:
        signal *= np.sin(2 * np.pi * frequency * time)
    return signal


def smooth_noise(steps: int, random: np.random.Generator, *, hold: int = 50) -> Float:
    """An input without repetition: independent values, one every `hold` steps, joined smoothly.

    The values are independent and uniform in [-0.2, 0.2]. A base that follows at once cannot jump
    from one to the next, so half a cosine wave carries each over to the next: the angle's rate is
    continuous and zero at the values themselves. Steps of 50 ms put the input's power below 10 Hz,
    like that of Eq. 17. The first value is zero, where the resting arm's base is.

    Args:
        steps: T, number of timesteps.
        random: gives the values.
        hold: timesteps from one value to the next, at least 1.

    Returns:
        (T,), within ±0.2, without unit.

    Raises:
        ValueError: a negative number of steps, or a hold below 1.
    """
    steps = whole_number("steps", steps)
    hold = whole_number("hold", hold, 1)
    values = random.uniform(-PEAK, PEAK, steps // hold + 2)
    values[0] = 0.0
    index, phase = np.divmod(np.arange(steps), hold)
    weight = 0.5 - 0.5 * np.cos(np.pi * phase / hold)
    signal: Float = (1 - weight) * values[index] + weight * values[index + 1]
    return signal


def base_angles(signal: Float, amplitude: float, peak: float | None = None) -> Float:
    """Base angles θ = φ = Scale · In with Scale = R / max|In| (Eq. 16).

    Args:
        signal: In, (T,).
        amplitude: R, the largest angle [degrees].
        peak: max|In| over the whole experiment, when `signal` is a part of it; the default is the
            maximum over `signal`.

    Returns:
        (T, 2), θ and φ [degrees], within ±R.

    Raises:
        ValueError: an amplitude that is negative or not finite, a signal that is not a sequence of
            numbers, is zero throughout, or exceeds the peak.
    """
    if not (amplitude >= 0 and math.isfinite(amplitude)):
        raise ValueError(f"amplitude = {amplitude}: expected a number of degrees, not negative")
    if signal.ndim != 1:
        raise ValueError(f"signal must have shape (T,), got {signal.shape}")
    largest = float(np.abs(signal).max(initial=0.0))
    peak = largest if peak is None else peak
    if not (peak > 0 and peak >= largest):
        raise ValueError(f"peak = {peak}: expected at least max|In| = {largest}, and above zero")
    angle = amplitude / peak * signal
    return np.column_stack((angle, angle))
