"""A recording of a reservoir, states beside input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Recording", "Sampling", "as_table", "check_same_length", "describe_gaps", "name_column"]

Float = NDArray[np.float64]

SAMPLES_A_STATE = 5
"""Least number of samples for each state. A fit of n weights to T samples explains n / T of pure
noise; with fewer samples than this the correction for it would be larger than most capacities."""

MINIMUM_SAMPLES = 100
"""Least number of samples of all, which the statistics of the input need."""

_MONOTONE_ROWS = 10
"""From so many rows on a monotone column is no chance: 10 independent ones are with 2 / 10!."""


@dataclass(frozen=True)
class Sampling:
    """What one row of a recording stands for.

    Attributes:
        hold: rows of the log; with more than one the recording has the last of each hold.
        interval: time from one row of the recording to the next, with its unit; empty if unknown.
    """

    hold: int = 1
    interval: str = ""

    @property
    def rows(self) -> str:
        """The word for rows."""
        return "rows" if self.hold == 1 else "holds"

    @property
    def unit(self) -> str:
        """What delays are counted in."""
        parts = [f"{self.hold} rows"] * (self.hold > 1) + [self.interval] * bool(self.interval)
        return f"{self.rows} of {', '.join(parts)}" if parts else self.rows


@dataclass(frozen=True, eq=False, init=False)
class Recording:
    """States and input of a reservoir, sampled together; row t of the states has seen input t.

    Attributes:
        states: (T, n), at least one of the n not constant, in any unit.
        inputs: (T, k), none of the k constant; a vector (T,) becomes (T, 1).
        state_names: n names; the numbers from 1 on if none are given.
        input_names: k names.
        sampling: what a row stands for.
        notes: what the reader of any measure of it should know.

    Raises:
        ValueError: wrong dimensions, different lengths, numbers that are not finite, a constant
            input, states that are all constant, or a column that is monotone: a time or a counter.
    """

    states: Float
    inputs: Float
    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    sampling: Sampling
    notes: tuple[str, ...]

    def __init__(
        self,
        states: ArrayLike,
        inputs: ArrayLike,
        *,
        state_names: Sequence[str] | None = None,
        input_names: Sequence[str] | None = None,
        sampling: Sampling = Sampling(),
        notes: Sequence[str] = (),
    ) -> None:
        given_states, given_inputs = as_table(states, "states"), as_table(inputs, "input")
        check_same_length(given_states, given_inputs)
        if not len(given_states):
            raise ValueError("states and input have no rows")
        names = []
        for what, values, given in (
            ("states", given_states, state_names),
            ("input", given_inputs, input_names),
        ):
            count = values.shape[1]
            names.append(tuple(given or map(str, range(1, count + 1))))
            if len(names[-1]) != count:
                raise ValueError(f"{what}: {len(names[-1])} names for {count} columns")
            _check_columns(what, values, names[-1])
        constant = np.flatnonzero(np.ptp(given_inputs, axis=0) == 0)
        if len(constant):
            value = given_inputs[0, constant[0]]
            raise ValueError(
                f"input: {name_column(names[1][constant[0]])} is constant ({value:g}): "
                "there is nothing to remember"
            )
        if not np.ptp(given_states, axis=0).any():
            raise ValueError("states: all columns are constant")
        object.__setattr__(self, "states", given_states)
        object.__setattr__(self, "inputs", given_inputs)
        object.__setattr__(self, "state_names", names[0])
        object.__setattr__(self, "input_names", names[1])
        object.__setattr__(self, "sampling", sampling)
        object.__setattr__(self, "notes", tuple(notes))

    def __len__(self) -> int:
        return len(self.states)

    @property
    def constant_states(self) -> int:
        """Number of states that never change."""
        return int((np.ptp(self.states, axis=0) == 0).sum())

    def check_length(self, washout: int, delay: int) -> None:
        """Refuse a recording too short for `washout` rows, delays up to `delay`, and a fit.

        Raises:
            ValueError: names the needed length, or an input that is constant after the washout.
        """
        for name, value in (("washout", washout), ("delay", delay)):
            if value < 0:
                raise ValueError(f"{name} = {value}: expected a number of rows, not negative")
        states = self.states.shape[1]
        samples = max(MINIMUM_SAMPLES, SAMPLES_A_STATE * states)
        needed = washout + delay + samples
        if len(self) < needed:
            raise ValueError(
                f"{len(self)} {self.sampling.unit} are too few: needed are {needed}, a washout of "
                f"{washout}, the largest delay of {delay}, and {samples} samples for {states} "
                "states"
            )
        constant = np.flatnonzero(np.ptp(self.inputs[washout:], axis=0) == 0)
        if len(constant):
            raise ValueError(
                f"input: {name_column(self.input_names[constant[0]])} is constant after the "
                f"washout of {washout} {self.sampling.rows}: there is nothing to remember"
            )


def as_table(values: ArrayLike, what: str) -> Float:
    """States (T, n) or input (T, k), of which a vector is one column, as numbers of our own.

    Raises:
        ValueError: another type or shape.
    """
    array = np.asarray(values)
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{what}: expected real numbers, got the type {array.dtype}")
    table = np.array(array, dtype=np.float64)
    vector_allowed = what == "input"
    if table.ndim == 1 and vector_allowed:
        table = table[:, np.newaxis]
    if table.ndim != 2 or table.shape[1] == 0:
        shape = "(T,) or (T, k)" if vector_allowed else "(T, n)"
        raise ValueError(f"{what}: expected shape {shape}, got {array.shape}")
    return table


def name_column(name: str) -> str:
    """A column in the words of an error: by its number if it has no name."""
    return f"column {name}" if name.isdigit() else f"column {name!r}"


def describe_gaps(what: str, values: Float, names: Sequence[str]) -> str:
    """How many numbers of `values` (T, k), which has such, are not finite, and where."""
    missing = ~np.isfinite(values)
    row, column = np.argwhere(missing)[0]
    return (
        f"{what}: row {row + 1}, {name_column(names[column])} (counted from 1, without a header) "
        f"is {values[row, column]}; {missing.sum()} numbers of {values.size} are missing or not "
        f"finite, in {missing.any(axis=1).sum()} of {len(values)} rows and "
        f"{missing.any(axis=0).sum()} of {values.shape[1]} columns"
    )


def check_same_length(states: Float, inputs: Float) -> None:
    """Refuse states and input of different length."""
    if len(states) != len(inputs):
        raise ValueError(
            f"states have {len(states)} rows and the input has {len(inputs)}: "
            "expected one row of states for each row of the input"
        )


def _check_columns(what: str, values: Float, names: Sequence[str]) -> None:
    if not np.isfinite(values).all():
        raise ValueError(
            f"{describe_gaps(what, values, names)}: expected numbers; fill or leave out what is "
            "missing"
        )
    if len(values) < _MONOTONE_ROWS:
        return
    steps = np.diff(values, axis=0)
    rises, falls = (steps >= 0).all(axis=0), (steps <= 0).all(axis=0)
    monotone = np.flatnonzero(rises != falls)  # a constant does both
    if len(monotone):
        column = int(monotone[0])
        first, last = values[0, column], values[-1, column]
        moves = "rises" if first < last else "falls"
        raise ValueError(
            f"{what}: {name_column(names[column])} only ever {moves} "
            f"({first:g} to {last:g}), as a time or a counter does: leave it out; of a text file, "
            "name it with --time-column, or the others with --states-columns and --input-columns"
        )
