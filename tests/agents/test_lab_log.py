"""A log is read as its instrument wrote it; what cannot be measured is refused with a remedy."""

import json
import re
from datetime import datetime, timedelta

import numpy as np
import pytest
from octoarm_agents.analysis.measures import MeasureSettings, measure
from octoarm_agents.analysis.recording_file import read_recording
from octoarm_agents.analysis.sampling import held_rows, last_rows_of_holds
from octoarm_agents.analysis.states import Recording

ROWS = 40
NAMES = ["time [s]", "strain 1 [µm]", "strain 2 [µm]", "pressure [kPa]"]


@pytest.fixture
def table():
    """Times, two states and an input, as in `NAMES`; the input comes again in the states."""
    random = np.random.default_rng(0)
    inputs = random.uniform(-1, 1, ROWS).round(4)
    states = np.stack([np.roll(inputs, 1), np.roll(inputs, 2) ** 2], axis=1)
    return np.column_stack([np.arange(ROWS) * 0.02, states, inputs])


def lines(table, delimiter=",", decimal=".", stamps=False):
    begin = datetime(2024, 3, 1, 23, 59, 59)
    for row in table:
        cells = ["" if np.isnan(value) else repr(float(value)) for value in row]
        if stamps:
            cells[0] = (begin + timedelta(seconds=row[0])).isoformat(" ")
        yield delimiter.join(cell.replace(".", decimal) for cell in cells)


def german(table):
    """Excel's, with its mark, a separator line, an empty column and empty rows at the end."""
    rows = [line + ";" for line in lines(table, ";", ",", stamps=True)]
    return "\ufeff" + "\r\n".join(["sep=;", ";".join(NAMES), *rows, ";;;;", ""])


def units_below(table):
    return "\n".join(["time;strain 1;strain 2;pressure", "s;µm;µm;kPa", *lines(table, ";")])


def quoted(table):
    rows = [", ".join(f'"{cell}"' for cell in row.split(";")) for row in lines(table, ";", ",")]
    return "\n".join([",".join(f'"{name}"' for name in NAMES), *rows])


def commented(table):
    rows = list(lines(table))
    return "\n".join(["# A rig of ours", "#", ",".join(NAMES), *rows[:9], "# valve", "", *rows[9:]])


def saved_by_numpy(table):
    return "\n".join(["# " + "\t".join(NAMES), *lines(table, "\t")])


@pytest.mark.parametrize(
    ("write", "encoding"),
    [
        (german, "utf-8"),
        (units_below, "cp1252"),
        (quoted, "utf-16"),
        (commented, "utf-8"),
        (saved_by_numpy, "utf-8"),
    ],
)
def test_every_dialect_gives_the_same_recording(tmp_path, table, write, encoding):
    path = tmp_path / "log.csv"
    path.write_bytes(write(table).encode(encoding))
    log = read_recording(path, input_columns="pressure", time_column="time")
    np.testing.assert_array_equal(log.states, table[:, 1:3])
    np.testing.assert_array_equal(log.inputs, table[:, 3:])
    assert [name.split(" [")[0] for name in log.state_names] == ["strain 1", "strain 2"]
    known = write is not units_below
    assert log.sampling.unit == ("rows of 0.02 s" if known else "rows")
    assert log.notes == ()


def write_log(folder, table, name="log.csv"):
    path = folder / name
    path.write_text("\n".join([",".join(NAMES), *lines(table)]), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("columns", "found"),
    [
        ("strain 2 [µm], strain 1", [2, 1]),
        ("strain*", [1, 2]),
        ("*[µm]", [1, 2]),
        ("strain ?", [1, 2]),
        ("2-3", [1, 2]),
        ("3", [2]),
        ('"strain 1","strain 1"', [1]),
    ],
)
def test_columns_by_name_pattern_and_number(tmp_path, table, columns, found):
    log = read_recording(
        write_log(tmp_path, table), states_columns=columns, input_columns="pressure"
    )
    np.testing.assert_array_equal(log.states, table[:, found])
    assert log.state_names == tuple(NAMES[column] for column in found)


def test_files_of_their_own_share_a_clock(tmp_path, table):
    states = tmp_path / "states.csv"
    states.write_text(
        "time [ms],strain\n" + "\n".join(f"{20 * k},{row[1]}" for k, row in enumerate(table)),
        encoding="utf-8",
    )
    inputs = tmp_path / "input.txt"
    inputs.write_text(
        "command\n" + "\n".join(repr(float(value)).replace(".", ",") for value in table[:, 3]),
        encoding="utf-8",
    )
    log = read_recording(states, inputs, time_column="time")
    np.testing.assert_array_equal(log.inputs, table[:, 3:])
    assert log.sampling.unit == "rows of 20 ms"
    inputs.write_text(
        "time [ms],command\n" + "\n".join(f"{20 * k**1.01},{row[3]}" for k, row in enumerate(table))
    )
    with pytest.raises(ValueError, match="have other times"):
        read_recording(states, inputs, time_column="time")


def text(*rows, header="t,a,u"):
    return "\n".join([header, *rows])


@pytest.mark.parametrize(
    ("content", "options", "message"),
    [
        (text("0,1,2"), {}, "--input-columns: which columns are the input? "),
        (text("0,1,2"), {"input_columns": "v"}, "'v': no such column; "),
        (text("0,1,2"), {"input_columns": "4"}, "has the columns t, a, u"),
        (text("0,1,2"), {"input_columns": "2-1"}, "no such column"),
        (text("0,1,2"), {"input_columns": ""}, "no column is named"),
        (text("0,1,2", header="u,a,u"), {"input_columns": "u"}, "2 columns of"),
        (text("0,1,2"), {"input_columns": "u", "time_column": "*"}, "names 3 columns"),
        (
            text("0,1,2"),
            {"input_columns": "u", "states_columns": "a,u"},
            "column 'u' is the input or the time already",
        ),
        (text("0,1,2"), {"input_columns": "*"}, "--states-columns: no column is left"),
        (text("0;0,5;2", "1;0.5;2", header="t;a;u"), {"input_columns": "u"}, "a decimal point"),
        (text("0;1.234,5;2", header="t;a;u"), {"input_columns": "u"}, "a decimal point"),
        (text("0,0,5,0,1,2"), {"input_columns": "u"}, "separated by semicolons"),
        (text("0,1,2", "1,2"), {"input_columns": "u"}, "line 3 has 2 columns, the table 3"),
        (text("0,1,2,3"), {"input_columns": "u"}, "line 2 has 4 columns, the table 3"),
        ("A rig\n" + text("0,1,2"), {"input_columns": "u"}, "--skip-lines"),
        (text("0,1,2"), {"input_columns": "u", "skip_lines": 9}, "no rows of numbers"),
        (text("0,ok,2", "1,ok,3"), {"input_columns": "u", "states_columns": "a"}, "'ok' is not"),
        (text("2024-03-01,1,2"), {"input_columns": "u"}, "is a time: --time-column takes"),
        (text("1.3.24,1,2"), {"input_columns": "u", "time_column": "t"}, "is not a number"),
        (text(",1,2", "1,1,3"), {"input_columns": "u", "time_column": "t"}, "1 of 2 cells"),
        (
            text("2024-03-01,1,2", "2024-03-01 12:00:00Z,1,2"),
            {"input_columns": "u", "time_column": "t"},
            "all with or all without a time zone",
        ),
        (text("0,\0,2"), {"input_columns": "u"}, "line"),
        (
            text('0,1,2,"ok', '1,2,2,"', "2,1,4,", header="t,a,u,b"),
            {"input_columns": "u", "states_columns": "a"},
            "in line 3 has a line break in a cell: a quotation mark is missing",
        ),
        (text('0,1,2,"ok', "1,2,2,", header="t,a,u,b"), {"input_columns": "u"}, "line 3: "),
        (text("0,1,2"), {"input_columns": "u", "hold": 5}, "no whole hold in 1 rows"),
        (text("0,1,2", "inf,2,1"), {"input_columns": "u", "time_column": "t"}, "1 of 2 cells"),
        (
            text("0,1,2"),
            {"input_columns": "u", "hold": 0},
            "hold = 0: expected a whole number",
        ),
        (text("0,1,2"), {"input_columns": "u", "fill_gaps": -1}, "fill_gaps = -1"),
    ],
)
def test_what_is_wrong_with_a_log_is_said(tmp_path, content, options, message):
    path = tmp_path / "log.csv"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ValueError, match=re.escape(message)):
        read_recording(path, **options)


def test_lines_before_the_table_are_left_out_on_request(tmp_path, table):
    path = write_log(tmp_path, table)
    path.write_text("Rig;7\nPark, K.\n" + path.read_text(encoding="utf-8"), encoding="utf-8")
    log = read_recording(path, input_columns="pressure", time_column="time", skip_lines=2)
    np.testing.assert_array_equal(log.states, table[:, 1:3])


def test_options_of_columns_are_refused_for_arrays(tmp_path, table):
    np.savez(tmp_path / "a.npz", states=table[:, 1:3], input=table[:, 3])
    with pytest.raises(ValueError, match="--input-columns is for a text file"):
        read_recording(tmp_path / "a.npz", input_columns="u")


def test_missing_numbers_are_counted_and_filled_on_request(tmp_path, table):
    table[4, 1] = table[5, 1] = table[9, 2] = table[20, 3] = np.nan
    path = write_log(tmp_path, table)
    options = {"input_columns": "pressure", "time_column": "time"}
    message = (
        "states: row 5, column 'strain 1 [µm]' (counted from 1, without a header) is nan; "
        "3 numbers of 80 are missing or not finite, in 3 of 40 rows and 2 of 2 columns. "
        "The longest gap has 2 rows: --fill-gaps 2 fills all"
    )
    for too_few in (0, 1):
        with pytest.raises(ValueError, match=re.escape(message)):
            read_recording(path, fill_gaps=too_few, **options)
    log = read_recording(path, fill_gaps=2, **options)
    np.testing.assert_allclose(log.states[3:7, 0], np.linspace(table[3, 1], table[6, 1], 4))
    assert log.inputs[20, 0] == table[19, 3]
    assert log.notes == (
        "Filled as --fill-gaps asks: 3 of 80 numbers of the states, 1 of 40 of the input.",
    )
    table[:, 2] = np.nan
    with pytest.raises(ValueError, match=r"1 of 2 columns have no numbers, .*'strain 2"):
        read_recording(write_log(tmp_path, table), fill_gaps=99, **options)


def test_missing_rows_are_counted_and_filled_on_request(tmp_path, table):
    path = write_log(tmp_path, np.delete(table, [7, 8, 30], axis=0))
    options = {"input_columns": "pressure", "time_column": "time"}
    message = "3 rows are missing, in 2 gaps, the first before row 8: --fill-gaps 2 fills all"
    with pytest.raises(ValueError, match=message):
        read_recording(path, fill_gaps=1, **options)
    log = read_recording(path, fill_gaps=2, **options)
    assert len(log) == ROWS
    np.testing.assert_array_equal(np.delete(log.states, [7, 8, 30], axis=0)[:, 0],
                                  np.delete(table, [7, 8, 30], axis=0)[:, 1])  # fmt: skip
    np.testing.assert_allclose(log.states[30, 0], (table[29, 1] + table[31, 1]) / 2)


def test_times_must_rise_evenly(tmp_path, table):
    options = {"input_columns": "pressure", "time_column": "time"}
    table[:, 0] += np.random.default_rng(1).uniform(-0.001, 0.001, ROWS)  # a logger's jitter
    assert len(read_recording(write_log(tmp_path, table), **options)) == ROWS
    table[17:, 0] += 0.01
    message = "1 of 39 intervals are neither the usual 0.0.* before row 18"
    with pytest.raises(ValueError, match=message):
        read_recording(write_log(tmp_path, table), **options)
    table[:, 0] = np.arange(ROWS) // 4  # whole seconds of four rows
    with pytest.raises(ValueError, match=r"30 of 39 times are not later .* in row 2"):
        read_recording(write_log(tmp_path, table), **options)


def test_a_time_is_no_state(tmp_path, table):
    path = write_log(tmp_path, table)
    message = r"states: column 'time \[s\]' only ever rises \(0 to 0.78\), as a time or a counter"
    with pytest.raises(ValueError, match=message):
        read_recording(path, input_columns="pressure")
    with pytest.raises(ValueError, match="input: column 1 only ever falls"):
        Recording(table[:, 1:], np.repeat(np.arange(20, 0, -1), 2))


HOLD = 5


@pytest.fixture
def reservoir():
    """600 commands, and five leaky states of two sets, each command held for `HOLD` rows."""
    random = np.random.default_rng(3)
    commands = random.uniform(-1, 1, 600)
    inputs = np.repeat(commands, HOLD)
    states, state = [], np.zeros(5)
    weights, leak = random.uniform(-1, 1, (5, 5)) / 2, np.array([0.9, 0.7, 0.5, 0.3, 0.2])
    for value in inputs:
        state = state + leak * (np.tanh(weights @ state + value) - state)
        states.append(state)
    return np.array(states), inputs, commands


def save(folder, states, inputs):
    np.savez(folder / "log.npz", states=states, input=inputs)
    return folder / "log.npz"


def memory(recording):
    return measure(recording, MeasureSettings(20, (20, 5), washout=20)).memory.total


def test_a_held_input_is_seen_and_measured_once_a_hold(tmp_path, reservoir):
    states, inputs, commands = reservoir
    path = save(tmp_path, states, inputs)
    with pytest.raises(ValueError, match="holds each value for 5 rows: .* --hold 5 measures one"):
        read_recording(path)
    log = read_recording(path, hold=HOLD)
    # The first command has no change before it, the last none after it; both are whole.
    np.testing.assert_array_equal(log.inputs[:, 0], commands)
    np.testing.assert_array_equal(log.states, states[HOLD - 1 :: HOLD])
    assert log.sampling.unit == "holds of 5 rows"
    every_row = read_recording(path, hold=1)
    assert len(every_row) == len(states)
    assert "holds each value for 5 rows and is measured row by row" in every_row.notes[0]
    # Five states remember no more than five values; row by row each value counts in every row.
    assert memory(log) <= 5
    assert memory(every_row) > 2 * memory(log)


def test_clocks_that_differ_noise_and_lost_rows(tmp_path, reservoir):
    _, inputs, commands = reservoir
    random = np.random.default_rng(4)
    inputs = np.repeat(commands, random.integers(9, 12, len(commands)))
    inputs = inputs + random.uniform(-0.01, 0.01, len(inputs))
    inputs = np.delete(inputs, slice(3004, 3007))
    states = np.stack([inputs**2, inputs**3], axis=1)
    log = read_recording(save(tmp_path, states, inputs), hold=10)
    assert len(log) == len(commands)
    # The noise, and the largest change that is taken for noise: its row may belong to either hold.
    np.testing.assert_allclose(log.inputs[:, 0], commands, atol=0.01 + 0.05 * commands.std() + 0.02)


@pytest.mark.parametrize(
    ("hold", "message"),
    [
        (2, "--hold 2: in .* stretches the input does not change for another number of rows"),
        (10, "--hold 10: in "),
    ],
)
def test_another_hold_is_refused(tmp_path, reservoir, hold, message):
    states, inputs, _ = reservoir
    with pytest.raises(ValueError, match=message):
        read_recording(save(tmp_path, states, inputs), hold=hold)
    twice = save(tmp_path, np.repeat(states, 2, axis=0), np.repeat(inputs, 2))
    with pytest.raises(ValueError, match=r"measured once in 5, holds .* 2 rows: .*--hold 10 meas"):
        read_recording(twice, hold=5)


def test_what_is_not_held_is_not_called_so():
    random = np.random.default_rng(5)
    coins = random.integers(0, 2, 1000).astype(float)
    rare = (random.random(1000) < 0.05).astype(float)
    smooth = np.sin(np.arange(1000) / 9.0).round(2)
    for free in (random.uniform(-1, 1, 1000), random.normal(size=1000), coins, rare, smooth):
        assert held_rows(free) == 1
    assert held_rows(np.repeat(coins, 4)) == 4
    assert held_rows(np.repeat(random.normal(size=300), 7)[3:]) == 7


def test_a_recording_that_begins_within_a_hold_keeps_whole_holds():
    values = np.repeat([0.0, 1.0, 0.0, 1.0, 1.0, 0.0], 4)[2:-1][:, np.newaxis]
    rows, misfits = last_rows_of_holds(values, 4)
    assert misfits == 0
    # Two rows of the first hold are too few; three of the last are within the tolerance.
    np.testing.assert_array_equal(rows, [5, 9, 13, 17, 20])


def test_inputs_of_different_holds_are_measured_apart(tmp_path, reservoir):
    states, inputs, _ = reservoir
    both = np.column_stack([inputs, np.random.default_rng(0).uniform(-1, 1, len(inputs))])
    with pytest.raises(ValueError, match="others do not: choose one of them"):
        read_recording(save(tmp_path, states, both))


def test_a_sum_above_the_states_says_why_it_is_impossible(octoarm, tmp_path, reservoir):
    states, inputs, _ = reservoir
    path = save(tmp_path, states[:, 1:3], inputs)
    command = ("analyse", "states", "--states", path, "--out", tmp_path, "--max-delay", 20)
    run = octoarm(*command, "--delays", "20,5", "--hold", 1)
    assert run.exit_code == 0, run.output
    memory = json.loads((tmp_path / "analysis.json").read_text())["memory_capacity"]["total"]
    assert memory > 2
    assert f"impossible: {memory:.3f}" in run.stdout
    assert f"Impossible: memory capacity {memory:.3f}" in run.stdout
    assert "exceeds the rank of the 2 states, here 2.000 (Dambre et al. 2012)" in run.stdout
    assert "The input is not independent" in run.stdout
    run = octoarm(*command, "--delays", "20,5", "--hold", HOLD)
    assert run.exit_code == 0, run.output
    assert "mpossible" not in run.stdout
    assert "600 holds of 5 rows, 2 states" in run.stdout


def test_inputs_that_go_together_are_named(reservoir):
    states, _, commands = reservoir
    states = states[HOLD - 1 :: HOLD]
    settings = MeasureSettings(10, (10, 3), washout=20)
    free = np.random.default_rng(0).uniform(-1, 1, len(commands))
    assert not any(
        "of each other" in note
        for note in measure(Recording(states, np.stack([commands, free], 1)), settings).warnings
    )
    twin = np.stack([commands, np.roll(commands, 3) + 0.3 * free], axis=1)
    assert any(
        note.startswith("Inputs 1 and 2 are not independent of each other")
        for note in measure(Recording(states, twin), settings).warnings
    )


def test_an_input_that_rests_after_the_washout_is_refused(reservoir):
    states, inputs, _ = reservoir
    recording = Recording(states, np.where(np.arange(len(inputs)) < 50, inputs, 0.0))
    with pytest.raises(ValueError, match="constant after the washout of 100 rows"):
        measure(recording, MeasureSettings(20, (20, 5), washout=100))


def test_the_command_names_columns_and_remedies(octoarm, tmp_path, table):
    path = write_log(tmp_path, np.tile(table, (8, 1)))
    command = ("analyse", "states", "--states", path, "--out", tmp_path / "out")
    run = octoarm(*command, "--max-delay", 5, "--delays", "5,2", "--washout", 10)
    assert run.exit_code == 2
    assert "--input-columns: which columns are the input?" in run.stderr
    run = octoarm(
        *(*command, "--max-delay", 5, "--delays", "5,2", "--washout", 10),
        *("--states-columns", "strain*", "--input-columns", "pressure"),
    )
    assert run.exit_code == 0, run.output
    assert "strain 1 [µm], strain 2 [µm]" in run.stdout
    content = json.loads((tmp_path / "out" / "analysis.json").read_text(encoding="utf-8"))
    assert content["state_names"] == NAMES[1:3]
    assert content["input_names"] == NAMES[3:]
