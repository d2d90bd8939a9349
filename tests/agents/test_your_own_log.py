"""The page "Your own log": its code makes its picture and its numbers."""

import re
import shlex

import pytest
from documents import ROOT, check_links, code_blocks, read_page, run_python
from PIL import Image

PAGE = "docs/your-own-log.md"


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """The folder in which the page's Python has written its log."""
    folder = tmp_path_factory.mktemp("page")
    for code in code_blocks(PAGE, "python"):
        run_python(code, folder)
    return folder


def arguments():
    (command,) = code_blocks(PAGE, "sh")
    program, *rest = shlex.split(command)
    assert program == "octoarm"
    return rest


def numbers(text, names):
    return [
        float(re.search(rf"{re.escape(name)}\W*(?:impossible: )?([\d.]+)", text)[1])
        for name in names
    ]


def test_from_a_csv_to_the_picture_and_the_numbers(octoarm, log, monkeypatch):
    monkeypatch.chdir(log)
    run = octoarm(*arguments())
    assert run.exit_code == 0, run.output
    (printed,) = code_blocks(PAGE, "text")
    names = [re.split(r"\s{2,}", line)[0] for line in printed.splitlines()]
    assert len(names) == 3
    # Algebra libraries round differently, and a function at the threshold may count or not.
    assert numbers(run.stdout, names) == pytest.approx(numbers(printed, names), rel=0.01)
    assert "Filled as --fill-gaps asks: 25 of 208000 numbers" in run.stdout
    with (
        Image.open("out/analysis/analysis.png") as made,
        Image.open(ROOT / "docs/images/your-own-log.png") as shown,
    ):
        assert made.size == shown.size


@pytest.mark.parametrize(
    ("left_out", "message"),
    [
        ("--hold", "holds each value for 5 rows"),
        ("--fill-gaps", "25 numbers of 208000 are missing"),
        ("--time-column", "is a time: --time-column takes its column"),
        ("--input-columns", "--input-columns: which columns are the input?"),
    ],
)
def test_without_an_option_the_remedy_is_named(octoarm, log, monkeypatch, left_out, message):
    monkeypatch.chdir(log)
    given = arguments()
    at = given.index(left_out)
    run = octoarm(*given[:at], *given[at + 2 :])
    assert run.exit_code == 2
    assert message in run.stderr


def test_row_by_row_the_page_is_right_about_the_memory(octoarm, log, monkeypatch):
    monkeypatch.chdir(log)
    given = arguments()
    given[given.index("--hold") + 1] = "1"
    run = octoarm(*given, "--delays", "1")
    assert run.exit_code == 0, run.output
    (claimed,) = re.findall(r"seem to have a memory of (\d+)", read_page(PAGE))
    (found,) = numbers(run.stdout, ["memory capacity, delays 1 to 60"])
    assert found == pytest.approx(float(claimed), abs=0.5)
    assert "Impossible: memory capacity" in run.stdout


def test_what_the_page_shows_exists():
    check_links(PAGE)
