"""The hyper-parameters train with rl-baselines3-zoo, by the commands in the documentation."""

from __future__ import annotations

import re
import shlex
import warnings
from importlib.metadata import entry_points
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "comparison.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^rl_zoo3 train .*$", PAGE, re.M)


def test_there_are_commands() -> None:
    assert len(COMMANDS) >= 2


@pytest.mark.parametrize(
    ("command", "steps"),
    [
        # PPO learns even so, from the one rollout that is the least.
        (COMMANDS[0], "1"),
        *(pytest.param(command, "2048", marks=pytest.mark.long) for command in COMMANDS),
    ],
)
def test_command_trains_as_printed(
    command: str, steps: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program, *arguments = shlex.split(command)
    # All as printed; only shorter, elsewhere, and in this process, where PyTorch is imported.
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr("sys.argv", [program, *arguments, "-n", steps, "-f", str(tmp_path)])
    (script,) = entry_points(group="console_scripts", name=program)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the zoo's own
        script.load()()
    models = [path.name for path in tmp_path.rglob("OctoArm-v0.zip")]
    assert models == ["OctoArm-v0.zip"]
    assert list(tmp_path.rglob("vecnormalize.pkl"))
