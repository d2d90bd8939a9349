"""The README's examples run as printed; its test command is continuous integration's."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from documents import check_links, code_blocks, read_page, run_python

EXAMPLES = code_blocks("README.md", "python")


@pytest.mark.parametrize(
    "code",
    [pytest.param(code, marks=pytest.mark.long if ".learn(" in code else ()) for code in EXAMPLES],
    ids=range(len(EXAMPLES)),
)
def test_example_runs_as_printed(code: str, tmp_path: Path) -> None:
    output = run_python(code, tmp_path)
    error = re.search(r"tracking error (\S+)", output)
    assert error is None or float(error[1]) < 1e-4
    earned = re.search(r"return (\S+) of 500", output)
    assert earned is None or float(earned[1]) > 490


def test_two_commands() -> None:
    start, everything = (block.strip() for block in code_blocks("README.md", "sh"))
    assert start.endswith("pip install . ./agents && octoarm demo")
    assert everything in read_page(".ci/run")


def test_pictures_exist() -> None:
    check_links("README.md")
