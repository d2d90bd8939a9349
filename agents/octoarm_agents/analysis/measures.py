"""All that states and input alone can tell: memory, processing capacity, dimension."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from octoarm_agents.analysis.capacity import StateBasis
from octoarm_agents.analysis.information_processing_capacity import (
    InformationProcessingCapacity,
    information_processing_capacity,
)
from octoarm_agents.analysis.memory_capacity import MemoryCapacity, memory_capacity
from octoarm_agents.analysis.polynomials import Family, correlated_inputs
from octoarm_agents.analysis.rank import numerical_rank, participation_ratio
from octoarm_agents.analysis.states import Recording
from octoarm_env.arrays import Float

Advance = Callable[[str, float], None]
"""Called with the name of the stage and the share of the whole work just done."""


@dataclass(frozen=True)
class MeasureSettings:
    """How to measure.

    Attributes:
        max_delay: largest delay of the memory capacity [rows].
        delays: oldest input for the processing capacities of degree 1, 2, … [rows].
        washout: rows left out at the begin.
        noise: ν, half width of white noise on each state, in the states' unit.
        significance: probability that a capacity of nothing counts.
        surrogates: shuffled inputs for the thresholds of the processing capacity; 0 takes the
            chi-square distribution.
        family: polynomials of the inputs; None lets their distribution decide.
        training_fraction: share of the rows that the held-out memory readout is fitted to.
        tolerance: singular values above this share of the largest count in the ranks.
        seed: of all that is random.
    """

    max_delay: int = 60
    delays: tuple[int, ...] = (60, 25, 15, 9, 6)
    washout: int = 500
    noise: float = 0.0
    significance: float = 1e-4
    surrogates: int = 0
    family: Family | None = None
    training_fraction: float = 0.7
    tolerance: float = 1e-3
    seed: int = 0

    @property
    def oldest(self) -> int:
        """The largest delay of all [rows]."""
        return max((self.max_delay, *self.delays))


@dataclass(frozen=True, eq=False)
class Measures:
    """What the states of a recording can compute.

    Attributes:
        settings: how it was measured.
        recording: what was measured, washout included.
        singular_values: of the centred states after the washout, descending.
        memory: linear memory capacity.
        processing: information processing capacity.
        correlated: the two inputs with the largest correlation, if it is no chance: their numbers,
            counted from 0, and the correlation.
    """

    settings: MeasureSettings
    recording: Recording
    singular_values: Float
    memory: MemoryCapacity
    processing: InformationProcessingCapacity
    correlated: tuple[int, int, float] | None

    @property
    def sums(self) -> dict[str, float]:
        """All sums of capacities, by their names."""
        return {
            "memory capacity": self.memory.total,
            "memory capacity on held-out rows": self.memory.held_out_total,
            "information processing capacity": self.processing.total,
            "information processing capacity, insignificant functions included": sum(
                self.processing.unselected_by_degree
            ),
        }

    @property
    def impossible(self) -> dict[str, float]:
        """The sums of capacities above what an independent input allows (Dambre et al. 2012).

        Capacities for functions that are orthogonal to each other cannot sum to more than the
        number of independent states, with sensor noise to less.
        """
        # As the numbers are printed.
        largest = self.processing.largest_possible_total + 5e-4
        return {name: value for name, value in self.sums.items() if value > largest}

    @property
    def effective_rank(self) -> float:
        """Participation ratio of the states' variances."""
        return participation_ratio(self.singular_values)

    @property
    def rank_at_tolerance(self) -> int:
        """Number of singular values above the tolerance."""
        return numerical_rank(self.singular_values, self.settings.tolerance)

    @property
    def warnings(self) -> list[str]:
        """What the reader of the figures should know."""
        notes = list(self.recording.notes)
        for column, distribution in enumerate(self.processing.inputs, start=1):
            if not distribution.independent:
                notes.append(
                    f"Input {column} is not independent in time: its autocorrelation at delay "
                    f"{distribution.autocorrelation_delay} is "
                    f"{distribution.largest_autocorrelation:.3f}. Capacities for different delays "
                    "and degrees then overlap, and their sums count the same thing more than once."
                )
        if self.correlated is not None:
            first, second, value = self.correlated
            notes.append(
                f"Inputs {first + 1} and {second + 1} are not independent of each other: their "
                f"correlation is {value:.3f} at one of the delays. What one of them is remembered "
                "by counts for the other too."
            )
        if self.impossible:
            notes.append(self._why_impossible())
        if not self.memory.faded:
            notes.append(
                f"The memory does not end within {self.settings.max_delay} "
                f"{self.recording.sampling.rows}: "
                "the memory capacity is a lower bound."
            )
        constant, states = self.recording.constant_states, len(self.recording.state_names)
        if constant:
            notes.append(f"{constant} of {states} states never change.")
        return notes

    def _why_impossible(self) -> str:
        sums = "; ".join(f"{name} {value:.3f}" for name, value in self.impossible.items())
        independent = self.correlated is None and all(
            distribution.independent for distribution in self.processing.inputs
        )
        reason = (
            "No correlation of the input is seen, so that this is the sampling error of too few "
            "rows, or the input depends on its past in a way that correlations do not show."
            if independent
            else "The input is not independent, as said above, and the same thing is counted more "
            "than once: these figures are no capacities."
        )
        return (
            f"Impossible: {sums}. For an independent input no sum exceeds the rank of the "
            f"{len(self.recording.state_names)} states, here "
            f"{self.processing.largest_possible_total:.3f}"
            f"{' with this noise' if self.settings.noise else ''} (Dambre et al. 2012). {reason}"
        )

    def to_dict(self) -> dict[str, Any]:
        """All as plain numbers for a JSON file."""
        recording = self.recording
        return {
            "settings": asdict(self.settings),
            "rows": len(recording),
            "rows_of_the_log_a_row": recording.sampling.hold,
            "interval": recording.sampling.interval,
            "state_names": recording.state_names,
            "input_names": recording.input_names,
            "inputs": len(recording.input_names),
            "states": len(recording.state_names),
            "constant_states": recording.constant_states,
            "memory_capacity": self.memory.to_dict(),
            "information_processing_capacity": self.processing.to_dict(),
            "rank": {
                "numerical": self.processing.rank,
                "at_tolerance": self.rank_at_tolerance,
                "participation_ratio": self.effective_rank,
                "singular_values": self.singular_values.tolist(),
            },
            "warnings": self.warnings,
        }


def measure(
    recording: Recording, settings: MeasureSettings, advance: Advance | None = None
) -> Measures:
    """Take all measures of a recording.

    Raises:
        ValueError: a setting out of its range, or too few rows.
    """
    report = advance or (lambda stage, share: None)
    common = settings.washout, settings.noise, settings.significance
    report("memory capacity", 0.0)
    memory = memory_capacity(recording, settings.max_delay, *common, settings.training_fraction)
    report("memory capacity", 0.1)
    processing = information_processing_capacity(
        recording,
        settings.delays,
        *common,
        settings.surrogates,
        settings.family,
        settings.seed,
        lambda share: report("processing capacity", 0.9 * share),
    )
    states, inputs = recording.states[settings.washout :], recording.inputs[settings.washout :]
    return Measures(
        settings,
        recording,
        StateBasis(states).singular_values,
        memory,
        processing,
        correlated_inputs(inputs, settings.oldest),
    )
