"""A recording of a reservoir, states beside input: from arrays, NumPy files or CSV files."""

from __future__ import annotations

import csv
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Recording", "read_recording"]

Float = NDArray[np.float64]

SAMPLES_A_STATE = 5
"""Least number of samples for each state. A fit of n weights to T samples explains n / T of pure
noise; with fewer samples than this the correction for it would be larger than most capacities."""

MINIMUM_SAMPLES = 100
"""Least number of samples of all, which the statistics of the input need."""

_DELIMITERS = ",;\t"


@dataclass(frozen=True, eq=False, init=False)
class Recording:
    """States and input of a reservoir, sampled together; row t of the states has seen input t.

    Attributes:
        states: (T, n), at least one of the n not constant, in any unit.
        inputs: (T, k), none of the k constant; a vector (T,) becomes (T, 1).

    Raises:
        ValueError: wrong dimensions, different lengths, numbers that are not finite, a constant
            input, or states that are all constant.
    """

    states: Float
    inputs: Float

    def __init__(self, states: ArrayLike, inputs: ArrayLike) -> None:
        given_states, given_inputs = _numbers(states, "states"), _numbers(inputs, "input")
        if given_inputs.ndim == 1:
            given_inputs = given_inputs[:, np.newaxis]
        for name, values, shape in (
            ("states", given_states, "(T, n)"),
            ("input", given_inputs, "(T,) or (T, k)"),
        ):
            if values.ndim != 2 or values.shape[1] == 0:
                raise ValueError(f"{name}: expected shape {shape}, got {np.shape(values)}")
        if len(given_states) != len(given_inputs):
            raise ValueError(
                f"states have {len(given_states)} rows and the input has {len(given_inputs)}: "
                "expected one row of states for each row of the input"
            )
        for name, values in (("states", given_states), ("input", given_inputs)):
            _check_finite(name, values)
        if not len(given_states):
            raise ValueError("states and input have no rows")
        constant = np.flatnonzero(np.ptp(given_inputs, axis=0) == 0)
        if len(constant):
            value = given_inputs[0, constant[0]]
            raise ValueError(
                f"input: column {constant[0] + 1} is constant ({value:g}): "
                "there is nothing to remember"
            )
        if not np.ptp(given_states, axis=0).any():
            raise ValueError("states: all columns are constant")
        object.__setattr__(self, "states", given_states)
        object.__setattr__(self, "inputs", given_inputs)

    def __len__(self) -> int:
        return len(self.states)

    @property
    def constant_states(self) -> int:
        """Number of states that never change."""
        return int((np.ptp(self.states, axis=0) == 0).sum())

    def check_length(self, washout: int, delay: int) -> None:
        """Refuse a recording too short for `washout` rows, delays up to `delay`, and a fit.

        Raises:
            ValueError: names the needed length.
        """
        for name, value in (("washout", washout), ("delay", delay)):
            if value < 0:
                raise ValueError(f"{name} = {value}: expected a number of rows, not negative")
        states = self.states.shape[1]
        samples = max(MINIMUM_SAMPLES, SAMPLES_A_STATE * states)
        needed = washout + delay + samples
        if len(self) < needed:
            raise ValueError(
                f"{len(self)} rows are too few: needed are {needed}, a washout of {washout}, "
                f"the largest delay of {delay}, and {samples} samples for {states} states"
            )


def read_recording(states: Path, inputs: Path | None = None) -> Recording:
    """Read a recording from files.

    Args:
        states: a .npy file, a .npz file with the key `states`, or a .csv file with or without a
            header line, separated by commas, semicolons or tabs.
        inputs: the same, the key being `input`; may be left out if `states` is a .npz file that has
            both.

    Raises:
        OSError: a file that cannot be read.
        ValueError: a file of another kind or content; see also :class:`Recording`.
    """
    if inputs is None:
        if states.suffix.lower() != ".npz":
            raise ValueError(f"{states}: an input file is needed; only a .npz file can hold both")
        inputs = states
    return Recording(_read(states, "states"), _read(inputs, "input"))


def _read(path: Path, name: str) -> Float:
    kind = path.suffix.lower()
    if kind not in (".npy", ".npz", ".csv"):
        raise ValueError(f"{path}: expected a file ending in .npy, .npz or .csv")
    if kind == ".csv":
        return _read_csv(path)
    try:
        # NumPy leaves a file open that it was given by name and could not read.
        with path.open("rb") as file:
            content = np.load(file, allow_pickle=False)
            if kind == ".npy":
                return _numbers(content, str(path))
            if name not in content:
                raise ValueError(f"has the keys {sorted(content)}, expected {name!r}")
            return _numbers(content[name], f"key {name!r}")
    except (ValueError, EOFError, zipfile.BadZipFile, TypeError) as error:
        raise ValueError(f"{path}: {error}") from None


def _read_csv(path: Path) -> Float:
    """All rows as numbers; a first row with anything but numbers is the header."""
    # The mark that spreadsheets write first is no part of the first cell.
    text = path.read_text(encoding="utf-8-sig")
    first = text.partition("\n")[0]
    delimiter = max(_DELIMITERS, key=first.count)
    lines = list(csv.reader(text.splitlines(), delimiter=delimiter))
    begin = 0 if not lines or _all_numbers(lines[0]) else 1
    rows: list[list[float]] = []
    for number, cells in enumerate(lines[begin:], start=begin + 1):
        if not cells:
            continue
        if rows and len(cells) != len(rows[0]):
            raise ValueError(
                f"{path}: line {number} has {len(cells)} columns, the first row {len(rows[0])}"
            )
        try:
            rows.append([float(cell) for cell in cells])
        except ValueError:
            column = next(c for c, cell in enumerate(cells) if not _all_numbers([cell]))
            raise ValueError(
                f"{path}: line {number}, column {column + 1}: {cells[column]!r} is not a number"
            ) from None
    if not rows:
        raise ValueError(f"{path}: no rows of numbers")
    return np.array(rows)


def _all_numbers(cells: list[str]) -> bool:
    try:
        for cell in cells:
            float(cell)
    except ValueError:
        return False
    return True


def _numbers(values: ArrayLike, name: str) -> Float:
    array = np.asarray(values)
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{name}: expected real numbers, got the type {array.dtype}")
    return np.array(array, dtype=np.float64)


def _check_finite(name: str, values: Float) -> None:
    wrong = np.argwhere(~np.isfinite(values))
    if len(wrong):
        row, column = wrong[0]
        raise ValueError(
            f"{name}: row {row + 1}, column {column + 1} (counted from 1, without a header) is "
            f"{values[row, column]}; {len(wrong)} numbers of {values.size} are not finite"
        )
