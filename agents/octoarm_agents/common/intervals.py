"""Mean, spread and comparison of errors over trials."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

_RESAMPLES = 10_000
_CONFIDENCE = 0.95


def summarise(values: Sequence[float]) -> dict[str, Any]:
    """``mean``, ``sd`` and bootstrap ``interval`` of values; None for what too few do not give.

    Args:
        values: one a trial; the standard deviation is that of the sample (divisor n - 1).
    """
    if not values:
        return {"mean": None, "sd": None, "interval": None}
    several = len(values) > 1
    return {
        "mean": float(np.mean(values)),
        "sd": float(np.std(values, ddof=1)) if several else None,
        "interval": bootstrap_interval(values) if several else None,
    }


def interquartile_mean(values: NDArray[np.float64], axis: int = -1) -> Any:
    """Mean of the middle half along an axis: a quarter of the values is left out at each end.

    As robust as a median against single bad trainings, and less wasteful (Agarwal et al. 2021,
    "Deep reinforcement learning at the edge of the statistical precipice"). Of five values the
    middle three count.
    """
    from scipy.stats import trim_mean

    return trim_mean(values, 0.25, axis=axis)


def bootstrap_interval(
    values: Sequence[float], statistic: Callable[..., Any] = np.mean
) -> list[float]:
    """95 % percentile bootstrap interval, always with the same resamples.

    Args:
        values: at least one.
        statistic: whose interval it is; takes an array and ``axis``.

    Returns:
        Low and high end.
    """
    sample = np.asarray(values)
    chosen = np.random.default_rng(0).integers(0, len(sample), (_RESAMPLES, len(sample)))
    tail = 50 * (1 - _CONFIDENCE)
    low, high = np.percentile(statistic(sample[chosen], axis=1), (tail, 100 - tail))
    return [float(low), float(high)]


def format_range(values: Sequence[float], digits: str) -> str:
    """Smallest to largest as text; one number where both read the same."""
    low, high = format(min(values), digits), format(max(values), digits)
    return low if low == high else f"{low} … {high}"


def welch_p_value(first: Sequence[float], second: Sequence[float]) -> float | None:
    """Two-sided p-value of Welch's t-test that two samples have the same mean.

    Args:
        first: a sample.
        second: another; their variances may differ.

    Returns:
        The p-value; None where either sample has fewer than two values, or neither varies.
    """
    from scipy.stats import ttest_ind

    if min(len(first), len(second)) < 2 or np.ptp(first) == np.ptp(second) == 0:
        return None
    return float(ttest_ind(first, second, equal_var=False).pvalue)
