"""The three systems that Task 1 emulates (section 2.2.1, Eqs. 19-23).

Every function gives ``targets[t] = y(t + 1)``: what a readout must say when it has seen the input
up to In(t). All history before t = 0, of the input and of the output, is zero.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from octoarm_agents.reservoir.inputs import TIMESTEP
from octoarm_env.arrays import Float

VOLTERRA_DELAYS = 201
"""τ runs from 0 to 200 timesteps in Eq. 22."""

_SCALE, _MEAN, _WIDTH = 1e-4, 0.1, 0.05
"""A [-], μ_1 = μ_2 [s] and σ_1 = σ_2 [s] of Eqs. 22-23."""


def second_order(signal: Float) -> Float:
    """The 2nd-order system: y(t+1) = 0.4 y(t) + 0.4 y(t) y(t-1) + 0.6 In³(t) + 0.1 (Eq. 19).

    Args:
        signal: In, (T,).

    Returns:
        (T,), y(t + 1).

    Raises:
        ValueError: an input that is not a finite sequence, or under which y grows without bound.
    """
    _check_signal(signal)
    now = before = 0.0
    outputs = []
    for drive in (0.6 * signal**3 + 0.1).tolist():
        now, before = 0.4 * now + 0.4 * now * before + drive, now
        outputs.append(now)
    return _finite(outputs, "2nd-order")


def tenth_order(signal: Float) -> Float:
    """The 10th-order system (Eqs. 20-21).

    y(t+1) = 0.3 y(t) + 0.05 y(t) Σ_{i=0..9} y(t-i) + 1.5 In(t-9) In(t) + 0.1.

    Args:
        signal: In, (T,).

    Returns:
        (T,), y(t + 1).

    Raises:
        ValueError: an input that is not a finite sequence, or under which y grows without bound.
    """
    _check_signal(signal)
    delayed = np.concatenate((np.zeros(9), signal))[: len(signal)]
    outputs = [0.0] * 10
    for drive in (1.5 * delayed * signal + 0.1).tolist():
        now = outputs[-1]
        outputs.append(0.3 * now + 0.05 * now * sum(outputs[-10:]) + drive)
    return _finite(outputs[10:], "10th-order")


def volterra(signal: Float) -> Float:
    """The discrete Volterra series (Eqs. 22-23).

    y(t+1) = A Σ_{τ_1, τ_2 = 0..200} h(τ_1, τ_2) In(t - τ_1) In(t - τ_2). With equal means and
    widths the kernel is a product h = g(τ_1) g(τ_2), and the double sum a square:
    y(t+1) = A (Σ_τ g(τ) In(t - τ))², g(τ) = exp(+(τ dt - μ)² / 2σ²).

    The exponent is *plus*, as printed. With minus, a Gaussian bell, the linear regressor's error
    is 110 times smaller than the one the paper reports.

    Args:
        signal: In, (T,).

    Returns:
        (T,), y(t + 1), not negative.

    Raises:
        ValueError: an input that is not a finite sequence.
    """
    _check_signal(signal)
    kernel = np.exp((np.arange(VOLTERRA_DELAYS) * TIMESTEP - _MEAN) ** 2 / (2 * _WIDTH**2))
    outputs: Float = _SCALE * np.convolve(signal, kernel)[: len(signal)] ** 2
    return outputs


SYSTEMS: dict[str, Callable[[Float], Float]] = {
    "second_order": second_order,
    "tenth_order": tenth_order,
    "volterra": volterra,
}
"""The systems by name, in the paper's order."""


def emulation_targets(signal: Float) -> Float:
    """All three systems under one input.

    Args:
        signal: In, (T,).

    Returns:
        (T, 3), y(t + 1) of each of `SYSTEMS`.

    Raises:
        ValueError: as the systems.
    """
    return np.column_stack([system(signal) for system in SYSTEMS.values()])


def _check_signal(signal: Float) -> None:
    if signal.ndim != 1 or len(signal) == 0:
        raise ValueError(f"signal must have shape (T,) with T at least 1, got {signal.shape}")
    if not np.isfinite(signal).all():
        index = int(np.flatnonzero(~np.isfinite(signal))[0])
        raise ValueError(f"signal[{index}] = {signal[index]}: all numbers must be finite")


def _finite(outputs: list[float], name: str) -> Float:
    values = np.array(outputs)
    if not np.isfinite(values).all():
        raise ValueError(f"the {name} system grows without bound under this input")
    return values
