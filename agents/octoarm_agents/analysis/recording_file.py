"""Recordings from files: NumPy's arrays, or the log of an instrument as it is."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from octoarm_agents.analysis.csv_file import CsvFile
from octoarm_agents.analysis.sampling import (
    TIME_TOLERANCE,
    even_rows,
    held_rows,
    last_rows_of_holds,
    without_gaps,
)
from octoarm_agents.analysis.states import (
    Recording,
    Sampling,
    as_table,
    check_same_length,
    name_column,
)
from octoarm_agents.common.whole import whole_number
from octoarm_env.arrays import Float

_Table = tuple[Float, list[str]]
"""Values (T, k), NaN where there is no number, and the names of the columns."""

_TEXT = (".csv", ".tsv", ".txt")


def read_recording(
    states: Path,
    inputs: Path | None = None,
    *,
    states_columns: str | None = None,
    input_columns: str | None = None,
    time_column: str | None = None,
    skip_lines: int = 0,
    fill_gaps: int = 0,
    hold: int | None = None,
) -> Recording:
    """Read a recording from files.

    Args:
        states: a .npy file, a .npz file with the key `states`, or a text file (.csv, .tsv, .txt),
            see :class:`.CsvFile`.
        inputs: the same, the key being `input`; may be left out if `states` is a .npz file that has
            both, or a text file that has columns of both.
        states_columns: names of columns of the text file, see :meth:`.CsvFile.select`; by default
            all that are neither input nor time.
        input_columns: the same of the input; by default all of a file of its own that are not time.
        time_column: the column of times, in seconds or any other unit, or in ISO 8601. Missing rows
            are noticed, and times that are not evenly spaced refused.
        skip_lines: lines of text files before the table.
        fill_gaps: longest gap, in rows, that is filled: states on the straight line between the
            neighbours, the input with the last value before.
        hold: rows that each value of the input is held for. The recording then has one row a hold,
            its last. None refuses an input that is held for more than one row, of which the same
            value would be remembered several times; 1 takes it as it is.

    Raises:
        OSError: a file that cannot be read.
        ValueError: a file of another kind or content; see also :class:`.Recording`.
    """
    fill_gaps = whole_number("fill_gaps", fill_gaps)
    hold = None if hold is None else whole_number("hold", hold, 1)
    logs = _read_logs(states, inputs, states_columns, input_columns, time_column, skip_lines)
    (state_values, state_names), (input_values, input_names), times, time_unit = logs
    check_same_length(state_values, input_values)
    interval, notes = "", []
    if times is not None:
        rows, step = even_rows(times, time_column or "", fill_gaps)
        state_values, input_values = _spread(state_values, rows), _spread(input_values, rows)
        interval = f"{step * (hold or 1):.4g} {time_unit}" if time_unit else ""
    state_values, holes = without_gaps(state_values, "states", state_names, fill_gaps)
    input_values, lost = without_gaps(input_values, "input", input_names, fill_gaps)
    if holes or lost:
        notes.append(
            f"Filled as --fill-gaps asks: {holes} of {state_values.size} numbers of the states, "
            f"{lost} of {input_values.size} of the input."
        )
    kept, held = _one_row_a_value(input_values, input_names, hold)
    return Recording(
        state_values[kept],
        input_values[kept],
        state_names=state_names,
        input_names=input_names,
        sampling=Sampling(hold or 1, interval),
        notes=(*notes, *held),
    )


def _read_logs(
    states: Path,
    inputs: Path | None,
    states_columns: str | None,
    input_columns: str | None,
    time_column: str | None,
    skip_lines: int,
) -> tuple[_Table, _Table, Float | None, str]:
    """States, input, the times of the rows if a column of them is named, and the times' unit."""
    if inputs is None and states.suffix.lower() == ".npy":
        raise ValueError(
            f"{states}: an input file is needed; only a .npz or a text file can hold both"
        )
    inputs = inputs or states
    state_log = _open_log(states, skip_lines)
    input_log = state_log if inputs == states else _open_log(inputs, skip_lines)
    logs = [log for log in dict.fromkeys((state_log, input_log)) if log is not None]
    for option, given, log in (
        ("--states-columns", states_columns, state_log),
        ("--input-columns", input_columns, input_log),
        ("--time-column", time_column, state_log or input_log),
        ("--skip-lines", skip_lines or None, state_log or input_log),
    ):
        if given is not None and log is None:
            raise ValueError(f"{option} is for a text file ({', '.join(_TEXT)}), not for an array")
    if state_log is not None and state_log is input_log and input_columns is None:
        raise ValueError(
            f"--input-columns: which columns are the input? {state_log.columns}; an input in a "
            "file of its own is given with --input"
        )
    times, time_unit, taken = _read_times(logs, time_column)
    tables: list[_Table] = []
    # The input first: the states are what it leaves, where both are in one file.
    for log, path, what, text in (
        (input_log, inputs, "input", input_columns),
        (state_log, states, "states", states_columns),
    ):
        if log is None:
            values = _read_array(path, what)
            names = [str(number + 1) for number in range(values.shape[1])]
        else:
            columns = _columns(log, text, f"--{what}-columns", taken[log])
            taken[log] += columns
            values, names = log.numbers(columns), [log.names[column] for column in columns]
        tables.append((values, names))
    return tables[1], tables[0], times, time_unit


def _open_log(path: Path, skip_lines: int) -> CsvFile | None:
    """The text file of that name, None for one of arrays."""
    kind = path.suffix.lower()
    if kind in _TEXT:
        return CsvFile(path, skip_lines)
    if kind not in (".npy", ".npz"):
        raise ValueError(f"{path}: expected a file ending in .npy, .npz, {', '.join(_TEXT)}")
    return None


def _read_array(path: Path, what: str) -> Float:
    try:
        # NumPy leaves a file open that it was given by name and could not read.
        with path.open("rb") as file:
            content = np.load(file, allow_pickle=False)
            if path.suffix.lower() == ".npz":
                if what not in content:
                    raise ValueError(f"has the keys {sorted(content)}, expected {what!r}")
                content = content[what]
            return as_table(content, what)
    except (ValueError, EOFError, zipfile.BadZipFile, TypeError) as error:
        raise ValueError(f"{path}: {error}") from None


def _read_times(
    logs: Sequence[CsvFile], name: str | None
) -> tuple[Float | None, str, dict[CsvFile, list[int]]]:
    """Times of the rows and their unit, if a column is named; and each log's columns of times.

    The first log must have the column; if another one has it too, its times must be the same.
    """
    times, unit, columns = None, "", {log: list[int]() for log in logs}
    for log in logs if name is not None else []:
        try:
            columns[log] = log.select(name or "", "--time-column")
        except ValueError:
            if log is logs[0]:
                raise
            continue
        if len(columns[log]) > 1:
            raise ValueError(
                f"--time-column {name!r} names {len(columns[log])} columns, expected one"
            )
        found, found_unit = log.times(columns[log][0])
        if times is None:
            times, unit = found, found_unit
        elif len(found) != len(times) or (
            np.abs(found - times).max() > TIME_TOLERANCE * np.abs(np.diff(times)).min(initial=0)
        ):
            raise ValueError(
                f"time column {name!r}: {logs[0].path} and {log.path} have other times"
            )
    return times, unit, columns


def _columns(log: CsvFile, text: str | None, option: str, others: Sequence[int]) -> list[int]:
    """The columns that an option names, or all that nothing else has."""
    if text is None:
        columns = [column for column in range(len(log.names)) if column not in others]
        if not columns:
            raise ValueError(f"{option}: no column is left; {log.columns}")
        return columns
    columns = log.select(text, option)
    for column in columns:
        if column in others:
            raise ValueError(
                f"{option} {text!r}: {name_column(log.names[column])} is the input or the time "
                "already"
            )
    return columns


def _spread(values: Float, rows: NDArray[np.int64]) -> Float:
    """Each row in its place, NaN where rows are missing."""
    spread = np.full((int(rows[-1]) + 1, values.shape[1]), np.nan)
    spread[rows] = values
    return spread


def _one_row_a_value(
    inputs: Float, names: Sequence[str], hold: int | None
) -> tuple[NDArray[np.int64], list[str]]:
    """The rows that are measured, one for each value of the input, and notes on that choice."""
    notes = []
    rows = np.arange(len(inputs))
    if hold is not None and hold > 1:
        rows, misfits = last_rows_of_holds(inputs, hold)
        if not len(rows):
            raise ValueError(f"--hold {hold}: no whole hold in {len(inputs)} rows")
        if misfits:
            notes.append(f"{misfits} holds of the input are not about {hold} rows long.")
    held = {
        name: count
        for name, values in zip(names, inputs[rows].T, strict=True)
        if (count := held_rows(values)) > 1
    }
    if not held:
        return rows, notes
    name, count = next(iter(held.items()))
    inflated = (
        "the same value would be remembered once in every row of its hold, and the memory capacity "
        "be too large"
    )
    if hold == 1:
        return rows, [
            f"The input ({name_column(name)}) holds each value for {count} rows and is measured "
            f"row by row, as --hold 1 asks: {inflated}."
        ]
    if len(set(held.values())) > 1 or (len(held) < len(names)):
        raise ValueError(
            f"input: {name_column(name)} holds each value for {count} rows, others do not: choose "
            "one of them with --input-columns, as the delays are counted in its values"
        )
    already = hold or 1
    measured = "" if hold is None else f", measured once in {hold},"
    raise ValueError(
        f"input: {name_column(name)}{measured} holds each value for {count} rows: {inflated}. "
        f"--hold {count * already} measures one row for each value, its last; --hold 1 all rows"
    )
