"""A recording of a reservoir, states beside input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass

import numpy as np
from numpy.typing import ArrayLike

from octoarm_env.arrays import Float

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


@dataclass(frozen=True, eq=False)
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
    _: KW_ONLY
    state_names: Sequence[str] = ()
    input_names: Sequence[str] = ()
    sampling: Sampling = Sampling()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for what, field in (("states", "state"), ("input", "input")):
            table = as_table(getattr(self, f"{field}s"), what)
            given = getattr(self, f"{field}_names")
            names = tuple(given or map(str, range(1, table.shape[1] + 1)))
            if len(names) != table.shape[1]:
                raise ValueError(f"{what}: {len(names)} names for {table.shape[1]} columns")
            object.__setattr__(self, f"{field}s", table)
            object.__setattr__(self, f"{field}_names", names)
        check_same_length(self.states, self.inputs)
        if not len(self):
            raise ValueError("states and input have no rows")
        _check_columns("states", self.states, self.state_names)
        _check_columns("input", self.inputs, self.input_names)
        self._refuse_constant_input(0)
        if not np.ptp(self.states, axis=0).any():
            raise ValueError("states: all columns are constant")

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
        states = self.states.shape[1]
        samples = max(MINIMUM_SAMPLES, SAMPLES_A_STATE * states)
        needed = washout + delay + samples
        if len(self) < needed:
            raise ValueError(
                f"{len(self)} {self.sampling.unit} are too few: needed are {needed}, a washout of "
                f"{washout}, the largest delay of {delay}, and {samples} samples for {states} "
                "states"
            )
        self._refuse_constant_input(washout)

    def _refuse_constant_input(self, washout: int) -> None:
        constant = np.flatnonzero(np.ptp(self.inputs[washout:], axis=0) == 0)
        if len(constant):
            column = constant[0]
            after = f" after the washout of {washout} {self.sampling.rows}" if washout else ""
            raise ValueError(
                f"input: {name_column(self.input_names[column])} is constant{after} "
                f"({self.inputs[-1, column]:g}): there is nothing to remember"
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
