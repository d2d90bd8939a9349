"""The hyper-parameters train with rl-baselines3-zoo, by the commands in the documentation."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "comparison.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^rl_zoo3 train .*$", PAGE, re.M)


def test_there_are_commands() -> None:
    assert len(COMMANDS) >= 2


@pytest.mark.parametrize(
    "command",
    [COMMANDS[0], *(pytest.param(command, marks=pytest.mark.long) for command in COMMANDS[1:])],
    ids=range(len(COMMANDS)),
)
def test_command_trains_as_printed(command: str, tmp_path: Path) -> None:
    program, *arguments = shlex.split(command)
    done = subprocess.run(
        # All as printed; only shorter, and elsewhere.
        [Path(sys.executable).parent / program, *arguments, "-n", "2048", "-f", tmp_path],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    models = [path.name for path in tmp_path.rglob("OctoArm-v0.zip")]
    assert models == ["OctoArm-v0.zip"]
    assert list(tmp_path.rglob("vecnormalize.pkl"))
