"""The README's examples run as printed; its test command is continuous integration's."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", README, re.S)
COMMANDS = [block.strip() for block in re.findall(r"```sh\n(.*?)```", README, re.S)]


@pytest.mark.parametrize("code", EXAMPLES, ids=range(len(EXAMPLES)))
def test_example_runs_as_printed(code: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    error = re.search(r"tracking error (\S+)", done.stdout)
    assert error is None or float(error[1]) < 1e-4
    earned = re.search(r"return (\S+) of 500", done.stdout)
    assert earned is None or float(earned[1]) > 490


def test_two_commands() -> None:
    assert len(COMMANDS) == 2
    assert COMMANDS[0].endswith("pip install . ./agents && octoarm demo")
    assert COMMANDS[1] in (ROOT / ".ci" / "run").read_text(encoding="utf-8")


def test_pictures_exist() -> None:
    for path in re.findall(r"\]\((docs/[^)]+)\)", README):
        assert (ROOT / path).is_file(), path
