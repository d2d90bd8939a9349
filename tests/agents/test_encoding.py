"""Every command under an output encoding that cannot show all characters, as Windows' for pipes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from octoarm_agents.cli import app

MAIN = "from octoarm_agents.cli import main; main()"

HELP = """
import json, sys
from octoarm_agents.cli import main
for words in json.loads(sys.argv[1]):
    sys.argv = ["octoarm", *words, "--help"]
    try:
        main()
    except SystemExit as end:
        print("ended", *words, end.code)
"""


def run(
    encoding: str, code: str, *arguments: str, folder: Path
) -> subprocess.CompletedProcess[bytes]:
    environment = os.environ | {"PYTHONIOENCODING": encoding, "MPLCONFIGDIR": str(folder)}
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        check=False,
        timeout=300,
    )


def commands(command: Any, names: Sequence[str] = ()) -> Iterator[list[str]]:
    """Every command and group of commands."""
    yield list(names)
    for name, each in getattr(command, "commands", {}).items():
        if name != "serve":  # The server's own help, by the server's own program.
            yield from commands(each, (*names, name))


@pytest.mark.parametrize("encoding", ["cp1252", "ascii"])
def test_every_command_gives_its_help(encoding: str, tmp_path: Path) -> None:
    known = list(commands(typer.main.get_command(app)))
    assert ["analyse", "states"] in known
    done = run(encoding, HELP, json.dumps(known), folder=tmp_path)
    assert done.returncode == 0, done.stderr
    ended = [line for line in done.stdout.decode(encoding).splitlines() if line.startswith("ended")]
    assert ended == [" ".join(("ended", *words, "0")) for words in known]


@pytest.mark.parametrize(
    ("encoding", "arguments", "shown"),
    [
        ("cp1252", ("record", "hold/quadratic", "--steps", "10", "--out", "α.png"), "Wrote ?.png"),
        ("ascii", ("evaluate", "hold/quadratic", "--episodes", "1", "--steps", "20"), "error (?)"),
        (
            "ascii",
            (
                *("analyse", "states", "--states", "s.npy", "--input", "u.npy", "--out", "a"),
                *("--max-delay", "10", "--delays", "10,4", "--washout", "20"),
            ),
            "Wrote a",
        ),
    ],
    ids=["record", "evaluate", "analyse"],
)
def test_work_is_not_lost_at_its_end(
    encoding: str, arguments: tuple[str, ...], shown: str, tmp_path: Path
) -> None:
    inputs = np.random.default_rng(0).uniform(-1, 1, 600)
    np.save(tmp_path / "u.npy", inputs)
    np.save(tmp_path / "s.npy", np.stack((inputs, np.roll(inputs, 1), inputs**2), axis=1))
    done = run(encoding, MAIN, *arguments, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert shown in done.stdout.decode(encoding)
