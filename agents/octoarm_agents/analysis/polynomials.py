"""Polynomials of an input that are orthonormal under its own distribution."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.polynomial import hermite_e, legendre

from octoarm_env.arrays import Float

Family = Literal["legendre", "hermite", "empirical"]

_REJECTED = 0.01
"""A distribution is given up if its Kolmogorov-Smirnov test gives a smaller probability."""


@dataclass(frozen=True)
class InputDistribution:
    """What one column of the input is distributed like, and whether it is independent in time.

    Attributes:
        family: polynomials that fit it: "legendre" (uniform), "hermite" (normal), or "empirical"
            (made orthonormal over the samples themselves).
        uniform_probability: of the Kolmogorov-Smirnov test against the uniform distribution between
            the smallest and the largest sample.
        normal_probability: of the test against the normal distribution of the same mean and
            standard deviation. Both distributions are fitted, so the tests reject a little less
            often than their probability says.
        different_values: how many; polynomials of this degree or higher do not exist.
        largest_autocorrelation: largest absolute autocorrelation, all delays asked for.
        autocorrelation_delay: the delay of it.
        autocorrelation_limit: what it exceeds with probability 0.001 if the input is independent.
    """

    family: Family
    uniform_probability: float
    normal_probability: float
    different_values: int
    largest_autocorrelation: float
    autocorrelation_delay: int
    autocorrelation_limit: float

    @property
    def independent(self) -> bool:
        """Whether the autocorrelations are what independent samples have."""
        return self.largest_autocorrelation <= self.autocorrelation_limit

    def to_dict(self) -> dict[str, Any]:
        """All as plain numbers for a JSON file."""
        return asdict(self) | {"independent": self.independent}


def describe_input(
    values: Float, max_delay: int, family: Family | None = None
) -> InputDistribution:
    """Test one input (T,) for its distribution and for memory of its own up to `max_delay` rows.

    Args:
        values: not constant.
        max_delay: at least 1.
        family: take these polynomials whatever the tests say.

    Raises:
        ValueError: an unknown family.
    """
    from scipy.stats import kstest, norm

    if family is not None and family not in get_args(Family):
        raise ValueError(f"family = {family!r}: expected one of {sorted(get_args(Family))}")
    low, width = float(values.min()), float(np.ptp(values))
    uniform = float(kstest(values, "uniform", args=(low, width)).pvalue)
    normal = float(kstest(values, "norm", args=(values.mean(), values.std())).pvalue)
    if family is None:
        family = "empirical"
        if max(uniform, normal) >= _REJECTED:
            family = "legendre" if uniform >= normal else "hermite"
    centred = values - values.mean()
    power = float(centred @ centred)
    delays = np.arange(1, min(max_delay, len(values) - 2) + 1)
    correlations = np.array([abs(float(centred[k:] @ centred[:-k])) / power for k in delays])
    limit = float(norm.isf(0.001 / (2 * len(delays)))) / len(values) ** 0.5
    return InputDistribution(
        family=family,
        uniform_probability=uniform,
        normal_probability=normal,
        different_values=len(np.unique(values)),
        largest_autocorrelation=float(correlations.max()),
        autocorrelation_delay=int(delays[correlations.argmax()]),
        autocorrelation_limit=limit,
    )


def correlated_inputs(inputs: Float, max_delay: int) -> tuple[int, int, float] | None:
    """The two inputs (T, k) with the largest correlation at any delay up to `max_delay` rows.

    Returns:
        Their numbers, counted from 0, and the absolute value of the correlation; None if it is not
        larger than independent inputs have with a probability of 0.001.
    """
    from scipy.stats import norm

    scaled = (inputs - inputs.mean(axis=0)) / inputs.std(axis=0)
    rows, count = inputs.shape
    longest = min(max_delay, rows - 2)
    correlations = np.array(
        [np.abs(scaled[k:].T @ scaled[: rows - k]) / rows for k in range(longest + 1)]
    )
    correlations[:, np.eye(count, dtype=bool)] = 0.0
    _, *pair = np.unravel_index(int(correlations.argmax()), correlations.shape)
    # At delay 0 each pair is there twice.
    tests = count * (count - 1) * (2 * longest + 1) // 2
    limit = float(norm.isf(0.001 / (2 * max(tests, 1)))) / rows**0.5
    first, second = sorted(map(int, pair))
    value = float(correlations.max())
    return (first, second, value) if value > limit else None


def orthonormal_polynomials(values: Float, degree: int, family: Family) -> Float:
    """Polynomials of degree 0 … `degree` at the samples (T,), each of mean square 1.

    Legendre polynomials take the samples' range as [-1, 1], Hermite polynomials the samples' mean
    and standard deviation; empirical ones are orthonormal over the samples to rounding, and zero
    from the degree on that is the number of different values.

    Returns:
        (degree + 1, T).
    """
    orders = np.arange(degree + 1)
    if family == "legendre":
        low, high = values.min(), values.max()
        scaled = (2 * values - (low + high)) / (high - low)
        factors = np.sqrt(2 * orders + 1)
        return factors[:, np.newaxis] * legendre.legvander(scaled, degree).T
    scaled = (values - values.mean()) / values.std()
    if family == "hermite":
        factors = 1 / np.sqrt(np.cumprod(np.maximum(orders, 1.0)))
        return factors[:, np.newaxis] * hermite_e.hermevander(scaled, degree).T
    return _empirical(scaled, degree)


def _empirical(scaled: Float, degree: int) -> Float:
    """Stieltjes' procedure: each polynomial is x times the last, made orthogonal to all before."""
    polynomials = np.zeros((degree + 1, len(scaled)))
    polynomials[0] = 1.0
    for order in range(1, degree + 1):
        candidate = scaled * polynomials[order - 1]
        size = np.sqrt(np.mean(candidate**2))
        for _ in range(2):  # the second pass removes what rounding left of the first
            overlaps = polynomials[:order] @ candidate / len(scaled)
            candidate = candidate - overlaps @ polynomials[:order]
        norm = np.sqrt(np.mean(candidate**2))
        if norm <= 1e-9 * max(size, 1.0):
            break
        polynomials[order] = candidate / norm
    return polynomials
