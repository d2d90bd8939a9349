"""Linear memory capacity (Jaeger 2002): how long the states remember the input."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from octoarm_agents.analysis.capacity import StateBasis
from octoarm_agents.analysis.plain import plain
from octoarm_agents.analysis.states import Recording
from octoarm_agents.common.whole import whole_number
from octoarm_env.arrays import Float


@dataclass(frozen=True, eq=False)
class MemoryCapacity:
    """Capacities for the input of k steps ago, k = 0, 1, …, K.

    Attributes:
        capacities: (inputs, K + 1), corrected for their bias, zero where not significant.
        uncorrected: (inputs, K + 1), as the fit gives them.
        threshold: multiple of its bias that an uncorrected capacity must exceed to count.
        held_out: (inputs, K + 1), Jaeger's squared correlation of the readout's output with the
            delayed input, on rows that the fit has not seen; zero where not significant.
        held_out_threshold: what a squared correlation must exceed.
        training_rows: first and last + 1 row that the held-out readout was fitted to.
        test_rows: first and last + 1 row that it was tested on.
    """

    capacities: Float
    uncorrected: Float
    threshold: float
    held_out: Float
    held_out_threshold: float
    training_rows: tuple[int, int]
    test_rows: tuple[int, int]

    @property
    def total(self) -> float:
        """MC, the sum over all inputs and the delays 1 … K."""
        return float(self.capacities[:, 1:].sum())

    @property
    def held_out_total(self) -> float:
        """The same sum of the squared correlations on rows the fit has not seen."""
        return float(self.held_out[:, 1:].sum())

    @property
    def faded(self) -> bool:
        """Whether the memory ends before the largest delay."""
        return not self.capacities[:, -1].any()

    def to_dict(self) -> dict[str, Any]:
        """All as plain numbers for a JSON file."""
        return {
            "total": self.total,
            "held_out_total": self.held_out_total,
            "faded_within_largest_delay": self.faded,
        } | plain(self)


def delayed_inputs(inputs: Float, first: int, delay: int) -> Float:
    """The inputs (T, k) of 0 … `delay` rows before each row from `first` on.

    Returns:
        (k, delay + 1, T - first).
    """
    columns = [
        [column[first - steps : len(column) - steps] for steps in range(delay + 1)]
        for column in inputs.T
    ]
    return np.array(columns)


def memory_capacity(
    recording: Recording,
    max_delay: int,
    washout: int = 0,
    noise: float = 0.0,
    significance: float = 1e-4,
    training_fraction: float = 0.7,
) -> MemoryCapacity:
    """Measure the linear memory of a recording driven by an independent input.

    Two estimates of the same quantity: the share of variance explained on all rows, corrected for
    its bias, and Jaeger's squared correlation on rows kept out of the fit.

    Args:
        recording: states and input.
        max_delay: K, in rows, at least 1.
        washout: rows left out at the begin; the first K rows after it are left out too, so that
            every delay has the same samples.
        noise: ν, half width of the sensors' noise, see :class:`.StateBasis`.
        significance: probability that a capacity of nothing counts.
        training_fraction: share of the rows that the held-out readout is fitted to, the first ones.

    Raises:
        ValueError: a number out of its range, or too few rows.
    """
    from scipy.stats import chi2

    max_delay, washout = whole_number("max_delay", max_delay, 1), whole_number("washout", washout)
    if not 0.1 <= training_fraction <= 0.9:
        raise ValueError(f"training_fraction = {training_fraction}: expected 0.1 to 0.9")
    recording.check_length(washout, max_delay)
    first = washout + max_delay
    states = recording.states[first:]
    columns, delays = recording.inputs.shape[1], max_delay + 1
    targets = delayed_inputs(recording.inputs, first, max_delay).reshape(columns * delays, -1)

    basis = StateBasis(states, noise)
    found = basis.capacities(targets)
    threshold = basis.threshold(significance)

    split = round(training_fraction * len(states))
    taught = StateBasis(states[:split], noise)
    predictions = taught.predict(targets[:, :split], states[split:]).T
    correlations = _squared_correlations(predictions, targets[:, split:])
    # A single regressor, the readout's output, on the rows that it has not seen.
    held_out_threshold = float(chi2.isf(significance, 1)) / (len(states) - split)
    held_out = np.where(correlations > held_out_threshold, correlations, 0.0)
    return MemoryCapacity(
        capacities=found.significant(threshold).reshape(columns, delays),
        uncorrected=found.uncorrected.reshape(columns, delays),
        threshold=threshold,
        held_out=held_out.reshape(columns, delays),
        held_out_threshold=held_out_threshold,
        training_rows=(first, first + split),
        test_rows=(first + split, len(recording)),
    )


def _squared_correlations(first: Float, second: Float) -> Float:
    """Squared correlation of each row of `first` with the same row of `second`, both (m, T)."""
    first = first - first.mean(axis=1, keepdims=True)
    second = second - second.mean(axis=1, keepdims=True)
    products = np.einsum("mt,mt->m", first, second) ** 2
    powers = np.einsum("mt,mt->m", first, first) * np.einsum("mt,mt->m", second, second)
    squares: Float = np.divide(products, powers, out=np.zeros(len(powers)), where=powers > 0)
    return squares
