"""Swings that are kept in files from one process to the next (`OCTOARM_CACHE`)."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

BODIES = 10
# More than a group of lanes; prints what an episode of each body brings.
RUN = f"""
import gymnasium as gym, hashlib, numpy as np, octoarm_env
arms = [{{"arm_density": 1040.0 + k, "compartments": 3}} for k in range({BODIES})]
envs = gym.make_vec("OctoArm-v0", num_envs={BODIES}, arm=arms)
found = hashlib.sha256(envs.reset(seed=range({BODIES}))[0].tobytes())
for _ in range(5):
    found.update(envs.step(np.zeros(({BODIES}, 2), np.float32))[0].tobytes())
print(found.hexdigest())
"""


def run(folder: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", RUN],
        env=os.environ | {"OCTOARM_CACHE": str(folder)},
        check=False,
        capture_output=True,
        text=True,
    )


def contents(folder: Path) -> dict[str, tuple[int, str]]:
    """Which file each name stands for, and its content."""
    return {
        path.name: (path.stat().st_ino, hashlib.sha256(path.read_bytes()).hexdigest())
        for path in folder.iterdir()
    }


def test_files_change_nothing_but_the_time(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "cache"
    without = run("").stdout
    assert run(folder).stdout == without != ""
    made = contents(folder)
    assert len(made) == BODIES
    # All of them are read, and none is written anew.
    assert run(folder).stdout == without
    assert contents(folder) == made
    # What is damaged, and what is missing, is made again, beside what is whole.
    first, second, third, *_ = sorted(folder.iterdir())
    damaged = bytearray(first.read_bytes())
    damaged[-1000] ^= 1
    first.write_bytes(damaged)
    second.write_bytes(second.read_bytes()[:5000])
    third.unlink()
    assert run(folder).stdout == without
    again = contents(folder)
    assert {name: content for name, (_, content) in again.items()} == {
        name: content for name, (_, content) in made.items()
    }
    assert sum(again[name] == made[name] for name in made) == BODIES - 3


def test_a_folder_that_cannot_be(tmp_path: Path) -> None:
    place = tmp_path / "file"
    place.write_text("mine")
    result = run(place)
    assert result.returncode == 1
    last = result.stderr.splitlines()[-1]
    assert last.startswith(f"ValueError: OCTOARM_CACHE = {place} is outside"), last
    assert place.read_text() == "mine"


@pytest.mark.parametrize("word", ["octoarm", ".numbers"])
def test_other_files_are_left_alone(tmp_path: Path, word: str) -> None:
    (tmp_path / word).write_text("mine")
    assert run(tmp_path).returncode == 0
    assert (tmp_path / word).read_text() == "mine"
