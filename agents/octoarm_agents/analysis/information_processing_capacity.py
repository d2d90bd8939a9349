"""Information processing capacity (Dambre et al. 2012): functions of the past in the states.

The functions are products of orthonormal polynomials of the delayed inputs. For an independent
input they are orthonormal, so their capacities add up, to at most the number of independent states.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, groupby, islice
from typing import Any, NamedTuple

import numpy as np

from octoarm_agents.analysis.capacity import Capacities, StateBasis
from octoarm_agents.analysis.memory_capacity import delayed_inputs
from octoarm_agents.analysis.plain import plain
from octoarm_agents.analysis.polynomials import (
    Family,
    InputDistribution,
    describe_input,
    orthonormal_polynomials,
)
from octoarm_agents.analysis.states import Recording
from octoarm_agents.common.whole import whole_number
from octoarm_env.arrays import Float, Integer

MAXIMUM_TARGETS = 1_000_000

_BLOCK_NUMBERS = 1_000_000
"""Numbers in a block of targets: 8 MB, whatever the length of the recording."""


@dataclass(frozen=True, eq=False)
class InformationProcessingCapacity:
    """Capacities for all functions tried, summed by their degree and by the oldest input in them.

    Attributes:
        by_degree_and_oldest_delay: (D, K + 1); row d - 1 is total degree d, column k the functions
            whose oldest input is k rows old. Corrected for bias, insignificant ones left out.
        targets_by_degree: (D,), functions tried.
        significant_by_degree: (D,), functions whose capacity counts.
        unselected_by_degree: (D,), sums over all functions tried, significant or not: on average
            right, but uncertain; what the significant ones miss is spread over many functions.
        thresholds_by_degree: (D,), multiple of its bias that an uncorrected capacity must exceed.
        largest_delays_by_degree: (D,), the oldest input tried [rows].
        rank: of the states; no sum of capacities can exceed it.
        largest_possible_total: with the given sensor noise, at most `rank`.
        inputs: distribution of each.
        thresholds_from: "chi-square", or how many shuffled inputs.
    """

    by_degree_and_oldest_delay: Float
    targets_by_degree: tuple[int, ...]
    significant_by_degree: tuple[int, ...]
    unselected_by_degree: tuple[float, ...]
    thresholds_by_degree: tuple[float, ...]
    largest_delays_by_degree: tuple[int, ...]
    rank: int
    largest_possible_total: float
    inputs: tuple[InputDistribution, ...]
    thresholds_from: str

    @property
    def by_degree(self) -> Float:
        """Sums for the total degrees 1 … D, (D,)."""
        sums: Float = self.by_degree_and_oldest_delay.sum(axis=1)
        return sums

    @property
    def total(self) -> float:
        """The sum of all capacities."""
        return float(self.by_degree_and_oldest_delay.sum())

    @property
    def linear(self) -> float:
        """The sum for degree 1, delay 0 included."""
        return float(self.by_degree[0])

    @property
    def nonlinear(self) -> float:
        """The sum for all degrees above 1."""
        return float(self.by_degree[1:].sum())

    @property
    def counts(self) -> list[str]:
        """How many of the functions of each degree count, in words."""
        pairs = zip(self.significant_by_degree, self.targets_by_degree, strict=True)
        return [f"{counted} of {tried}" for counted, tried in pairs]

    def to_dict(self) -> dict[str, Any]:
        """All as plain numbers for a JSON file."""
        return plain(self) | {
            "total": self.total,
            "linear": self.linear,
            "nonlinear": self.nonlinear,
            "by_degree": self.by_degree.tolist(),
            "inputs": [each.to_dict() for each in self.inputs],
        }


def count_targets(delays: Sequence[int], inputs: int = 1) -> int:
    """Number of functions: products of total degree d of inputs at most ``delays[d - 1]`` old."""
    return sum(
        math.comb(inputs * (delay + 1) + degree - 1, degree)
        for degree, delay in enumerate(delays, start=1)
    )


def information_processing_capacity(
    recording: Recording,
    delays: Sequence[int],
    washout: int = 0,
    noise: float = 0.0,
    significance: float = 1e-4,
    surrogates: int = 0,
    family: Family | None = None,
    seed: int = 0,
    advance: Callable[[float], None] | None = None,
) -> InformationProcessingCapacity:
    """Measure the capacities for all polynomials of the past up to a degree and a delay.

    Args:
        recording: states and input; the input should be independent in time, which is tested.
        delays: the oldest input, in rows, for total degree 1, 2, … D; not negative.
        washout: rows left out at the begin, as are the first max(delays) after it.
        noise: ν, half width of the sensors' noise, see :class:`.StateBasis`.
        significance: probability that a capacity of nothing counts, by the chi-square distribution.
        surrogates: if not 0, thresholds are, for each degree, the largest multiple of its bias that
            the same functions of so many shuffled inputs reach; `significance` is not used then.
        family: polynomials to use for all inputs; by default each input's distribution decides.
        seed: of the shuffles.
        advance: called with the share of the work just done.

    Raises:
        ValueError: a number out of its range, too many functions, or too few rows.
    """
    delays = tuple(whole_number(f"delays[{index}]", each) for index, each in enumerate(delays))
    if not delays:
        raise ValueError("delays = []: expected one or more numbers")
    surrogates, washout = whole_number("surrogates", surrogates), whole_number("washout", washout)
    columns = recording.inputs.shape[1]
    count = count_targets(delays, columns)
    if count > MAXIMUM_TARGETS:
        raise ValueError(
            f"delays = {list(delays)} with {columns} inputs give {count} functions: "
            f"expected at most {MAXIMUM_TARGETS}"
        )
    recording.check_length(washout, max(delays))
    first = washout + max(delays)
    used = recording.inputs[washout:]
    distributions = tuple(describe_input(column, max(*delays, 1), family) for column in used.T)
    basis = StateBasis(recording.states[first:], noise)

    share = 1 / (1 + surrogates)
    report = advance or (lambda done: None)

    def measure(inputs: Float) -> list[_Measured]:
        return _measure(basis, inputs, delays, distributions, lambda done: report(done * share))

    measured = measure(used)
    thresholds = [basis.threshold(significance)] * len(delays)
    if surrogates:
        random = np.random.default_rng(seed)
        shuffled = [measure(random.permutation(used)) for _ in range(surrogates)]
        thresholds = [
            max(float(run[degree].capacities.multiples.max(initial=0.0)) for run in shuffled)
            for degree in range(len(delays))
        ]
    table = np.zeros((len(delays), max(delays) + 1))
    significant = []
    for row, found, threshold in zip(table, measured, thresholds, strict=True):
        np.add.at(row, found.oldest, found.capacities.significant(threshold))
        significant.append(int((found.capacities.multiples > threshold).sum()))
    return InformationProcessingCapacity(
        by_degree_and_oldest_delay=table,
        targets_by_degree=tuple(len(found.oldest) for found in measured),
        significant_by_degree=tuple(significant),
        unselected_by_degree=tuple(float(found.capacities.signed.sum()) for found in measured),
        thresholds_by_degree=tuple(thresholds),
        largest_delays_by_degree=delays,
        rank=basis.rank,
        largest_possible_total=float(basis.gains.sum()),
        inputs=distributions,
        thresholds_from=f"{surrogates} shuffled inputs" if surrogates else "chi-square",
    )


class _Measured(NamedTuple):
    """The functions of one degree: their capacities, and the oldest input in each [rows]."""

    capacities: Capacities
    oldest: Integer


def _measure(
    basis: StateBasis,
    inputs: Float,
    delays: Sequence[int],
    distributions: Sequence[InputDistribution],
    advance: Callable[[float], None],
) -> list[_Measured]:
    """Capacities for all functions, degree by degree."""
    table = _polynomial_table(inputs, len(delays), max(delays), distributions)
    count = count_targets(delays, inputs.shape[1])
    size = max(1, _BLOCK_NUMBERS // basis.samples)
    highest = [distribution.different_values - 1 for distribution in distributions]
    measured = []
    for degree, delay in enumerate(delays, start=1):
        blocks = [Capacities(*(np.empty(0) for _ in Capacities._fields))]
        oldest = [np.empty(0, dtype=np.int64)]
        for factors in _blocks(degree, delay, highest, size):
            orders, columns, ages = factors.transpose(2, 1, 0)
            targets = table[orders[0], columns[0], ages[0]]
            for order, column, age in zip(orders[1:], columns[1:], ages[1:], strict=True):
                targets *= table[order, column, age]
            blocks.append(basis.capacities(targets))
            oldest.append(ages.max(axis=0))
            advance(len(factors) / count)
        capacities = Capacities(*(np.concatenate(parts) for parts in zip(*blocks, strict=True)))
        measured.append(_Measured(capacities, np.concatenate(oldest)))
    return measured


def _polynomial_table(
    inputs: Float, degree: int, delay: int, distributions: Sequence[InputDistribution]
) -> Float:
    """Polynomials by degree, input and delay: (degree + 1, inputs, delay + 1, samples)."""
    polynomials = np.stack(
        [
            orthonormal_polynomials(column, degree, distribution.family)
            for column, distribution in zip(inputs.T, distributions, strict=True)
        ],
        axis=2,
    )
    return np.array([delayed_inputs(order, delay, delay) for order in polynomials])


def _blocks(degree: int, delay: int, highest: Sequence[int], size: int) -> Iterator[Integer]:
    """All functions of one total degree in blocks (functions, degree, 3).

    A function is a list of `degree` factors (order, input, delay), the last ones of order 0 if an
    input occurs more than once. Orders above an input's `highest` do not exist and are left out.
    """
    variables = [(column, age) for column in range(len(highest)) for age in range(delay + 1)]
    products = (
        _factors(chosen, degree) for chosen in combinations_with_replacement(variables, degree)
    )
    functions = (
        factors
        for factors in products
        if all(order <= highest[column] for order, column, _ in factors)
    )
    while block := list(islice(functions, size)):
        yield np.array(block, dtype=np.int64)


def _factors(chosen: tuple[tuple[int, int], ...], degree: int) -> list[tuple[int, int, int]]:
    """The factors of a product in which an input occurs as often as its polynomial's order."""
    factors = [(len(list(group)), *variable) for variable, group in groupby(chosen)]
    return factors + [(0, 0, 0)] * (degree - len(factors))
