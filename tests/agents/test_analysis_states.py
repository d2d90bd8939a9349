"""`octoarm analyse states`: every kind of file, and an answer to everything that is wrong."""

import json
import re

import numpy as np
import pytest
from octoarm_agents.analysis.recording_file import read_recording
from octoarm_agents.analysis.states import Recording
from PIL import Image

ROWS = 400


@pytest.fixture
def arrays():
    random = np.random.default_rng(0)
    inputs = random.uniform(-1, 1, ROWS)
    # A delay line of three taps; the first rows wrap around and belong to the washout.
    return np.stack([np.roll(inputs, k) for k in range(1, 4)], axis=1), inputs


def write(folder, states, inputs, kind):
    if kind == "npz":
        np.savez(folder / "both.npz", states=states, input=inputs)
        return folder / "both.npz", None
    paths = folder / f"states.{kind[:3]}", folder / f"input.{kind[:3]}"
    for path, values in zip(paths, (states, inputs), strict=True):
        if kind == "npy":
            np.save(path, values)
        else:
            header = ",".join(f"s{k}" for k in range(values.size // len(values)))
            text = "\n".join(",".join(map(repr, map(float, np.atleast_1d(row)))) for row in values)
            if kind == "csv with semicolons":
                header, text = header.replace(",", ";"), text.replace(",", ";")
            path.write_text(text if kind == "csv bare" else f"\ufeff{header}\n{text}\n", "utf-8")
    return paths


@pytest.mark.parametrize("kind", ["npy", "npz", "csv", "csv bare", "csv with semicolons"])
def test_every_kind_of_file_gives_the_same_recording(tmp_path, arrays, kind):
    recording = read_recording(*write(tmp_path, *arrays, kind))
    np.testing.assert_array_equal(recording.states, arrays[0])
    np.testing.assert_array_equal(recording.inputs[:, 0], arrays[1])


def test_the_command_measures_a_log(octoarm, tmp_path, arrays):
    states, inputs = write(tmp_path, *arrays, "csv")
    out = tmp_path / "out"
    options = ("--max-delay", 8, "--delays", "8,3,2", "--washout", 10, "--surrogates", 3)
    run = octoarm(
        "analyse", "states", "--states", states, "--input", inputs, "--out", out, *options
    )
    assert run.exit_code == 0, run.output
    assert "memory capacity" in run.stdout
    content = json.loads((out / "analysis.json").read_text(encoding="utf-8"))
    memory = content["memory_capacity"]
    assert memory["total"] == pytest.approx(3.0, abs=1e-9)
    assert memory["held_out_total"] == pytest.approx(3.0, abs=1e-9)
    # 400 rows, less 10 of washout and 8 of delay; 70 % of the other 382 for training.
    assert memory["training_rows"] == [18, 285]
    assert memory["test_rows"] == [285, 400]
    processing = content["information_processing_capacity"]
    assert processing["linear"] == pytest.approx(3.0, abs=1e-9)
    assert processing["inputs"][0]["family"] == "legendre"
    assert processing["thresholds_from"] == "3 shuffled inputs"
    assert content["rank"]["numerical"] == 3
    # 382 rows and three shuffles let one function too many count; that is said.
    (warning,) = content["warnings"]
    assert warning.startswith("Impossible: information processing capacity 3.1")
    assert "sampling error" in warning
    assert "impossible: 3.1" in run.stdout
    with Image.open(out / "analysis.png") as image:
        assert min(image.size) > 800
    assert sorted(path.name for path in out.iterdir()) == ["analysis.json", "analysis.png"]

    again = tmp_path / "again"
    run = octoarm(
        "analyse", "states", "--states", states, "--input", inputs, "--out", again, *options
    )
    assert json.loads((again / "analysis.json").read_text(encoding="utf-8")) == content


def spoil_nan(states, inputs):
    states[6, 2] = np.nan
    return states, inputs


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (spoil_nan, "row 7, column 3 (counted from 1, without a header) is nan"),
        (lambda s, i: (s[:-1], i), "states have 399 rows and the input has 400"),
        (lambda s, i: (s, np.full(ROWS, 0.5)), "input: column 1 is constant (0.5)"),
        (lambda s, i: (np.ones_like(s), i), "states: all columns are constant"),
        (lambda s, i: (s[:, 0], i), "states: expected shape (T, n), got (400,)"),
        (lambda s, i: (s, np.ones((ROWS, 1, 1))), "expected shape (T,) or (T, k)"),
        (lambda s, i: (s[:120], i[:120]), "needed are 208"),
        (lambda s, i: (s.astype(str), i), "expected real numbers"),
    ],
)
def test_what_is_wrong_with_a_recording_is_said(octoarm, tmp_path, arrays, spoil, message):
    states, inputs = write(tmp_path, *spoil(*arrays), "npy")
    run = octoarm(
        *("analyse", "states", "--states", states, "--input", inputs, "--out", tmp_path / "out"),
        *("--max-delay", 8, "--delays", "8,3"),
    )
    assert run.exit_code == 2
    assert message in run.stderr
    assert "Traceback" not in run.output
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "x,y\n1,2\n3,oops\n", "line 3, column 2 ('y'): 'oops' is not a number"),
        ("a.csv", "1,2\n3\n", "line 2 has 1 columns, the table 2"),
        ("a.csv", "x,y\n", "no rows of numbers"),
        ("a.csv", "", "no rows of numbers"),
        ("a.json", "1,2\n", "expected a file ending in .npy, .npz, .csv, .tsv, .txt"),
        ("a.npy", "not an array", "a.npy: "),
        ("a.npz", "not an archive", "a.npz: "),
    ],
)
def test_what_is_wrong_with_a_file_is_said(tmp_path, name, text, message):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    np.save(tmp_path / "input.npy", np.arange(9.0))
    with pytest.raises(ValueError, match=re.escape(message)):
        read_recording(path, tmp_path / "input.npy")


def test_missing_parts_are_named(tmp_path, arrays):
    np.savez(tmp_path / "a.npz", states=arrays[0], drive=arrays[1])
    with pytest.raises(ValueError, match=r"keys \['drive', 'states'\], expected 'input'"):
        read_recording(tmp_path / "a.npz")
    np.save(tmp_path / "a.npy", arrays[0])
    with pytest.raises(ValueError, match="an input file is needed"):
        read_recording(tmp_path / "a.npy")
    with pytest.raises(ValueError, match="no rows"):
        Recording(np.empty((0, 3)), np.empty(0))


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--delays", "8,x", "expected whole numbers"),
        ("--delays", "8,-1", "delays[1] = -1: expected a whole number, at least 0"),
        ("--delays", "99,99,99,99,99", "functions: expected at most"),
        ("--noise", -1, "-1.0 is not between 0 and"),
        ("--training", 0.95, "0.95 is not between 0.1 and 0.9"),
    ],
)
def test_options_out_of_range_are_refused(octoarm, tmp_path, arrays, option, value, message):
    states, inputs = write(tmp_path, *arrays, "npy")
    run = octoarm(
        *("analyse", "states", "--states", states, "--input", inputs, "--out", tmp_path / "out"),
        *("--max-delay", 8, option, value),
    )
    assert run.exit_code == 2
    assert message in run.stderr
