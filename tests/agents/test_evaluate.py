"""`octoarm evaluate`, and the names by which every command knows its agents."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from octoarm_agents.common.environment import TARGETS
from octoarm_agents.policies import load_trained, trained_agents
from octoarm_agents.policies.evaluation import TRIVIAL

from octoarm_env import ArmParameters

SHORT = ("--episodes", 2, "--steps", 20)


def rows(octoarm: Any, out: Path, *arguments: object) -> list[dict[str, Any]]:
    done = octoarm("evaluate", *arguments, *SHORT, "--out", out)
    assert done.exit_code == 0, done.output
    found: list[dict[str, Any]] = json.loads(out.read_text(encoding="utf-8"))["rows"]
    return found


@pytest.mark.parametrize("agent", TRIVIAL)
def test_trivial_agents_by_name(octoarm: Any, tmp_path: Path, agent: str) -> None:
    found = rows(octoarm, tmp_path / "a.json", f"{agent}/lissajous")
    # Itself, and the other one beside it.
    assert [(row["agent"], row["target"]) for row in found] == [
        (f"{agent}/lissajous", "lissajous"),
        *((each, "lissajous") for each in TRIVIAL if each != agent),
    ]
    beside = rows(octoarm, tmp_path / "b.json", "readout_pinv/lissajous")
    same = next(row for row in beside if row["agent"] == agent)
    assert same | {"agent": found[0]["agent"]} == found[0]


def test_trivial_agents_stand_once_in_every_home(octoarm: Any, tmp_path: Path) -> None:
    names = ["readout_pinv/quadratic", "hold/quadratic", "readout_ridge/quadratic"]
    names += ["readout_pinv/lissajous"]
    found = rows(octoarm, tmp_path / "a.json", *names)
    assert [(row["agent"], row["target"]) for row in found[4:]] == [
        ("clock", "quadratic"),
        ("hold", "lissajous"),
        ("clock", "lissajous"),
    ]


def test_another_body_is_everyone_s(octoarm: Any, tmp_path: Path) -> None:
    ArmParameters(arm_density=1100.0).to_json(tmp_path / "heavy.json")
    names = ("hold/quadratic", "readout_ridge/quadratic")
    own = rows(octoarm, tmp_path / "a.json", *names)
    other = rows(octoarm, tmp_path / "b.json", *names, "--arm", tmp_path / "heavy.json")
    assert len(own) == len(other) == 3
    assert own[1]["tracking_error"] < other[1]["tracking_error"]


def test_bodies_that_vary(octoarm: Any, tmp_path: Path) -> None:
    names = ("hold/lissajous", "readout_ridge/lissajous")
    own = rows(octoarm, tmp_path / "a.json", *names)
    options = ("--vary", "longitudinal_stiffness=0.5,2", "--vary", "arm_density=0.9,1.1")
    varied = rows(octoarm, tmp_path / "b.json", *names, *options, "--bodies", 3)
    # Who sees no spring earns the same.
    assert varied[0] == own[0]
    assert varied[1]["return"] < own[1]["return"]
    other = rows(octoarm, tmp_path / "c.json", *names, *options, "--body-seed", 1)
    assert other[1]["return"] != varied[1]["return"]
    settings = json.loads((tmp_path / "b.json").read_text(encoding="utf-8"))["settings"]
    assert settings["vary"] == {"longitudinal_stiffness": [0.5, 2.0], "arm_density": [0.9, 1.1]}
    for text, message in (("colour=1,2", '"colour"'), ("arm_density", "expected NAME=LOW,HIGH")):
        done = octoarm("evaluate", *names, *SHORT, "--vary", text)
        assert done.exit_code == 2
        assert message in done.output


@pytest.mark.parametrize(
    "command",
    [("evaluate",), ("watch",), ("record", "--out", "a.gif")],
    ids=lambda command: command[0],
)
@pytest.mark.parametrize("name", ["hold/square", "hold", "agent.txt"])
def test_unknown_agents_are_answered_with_all_that_are_known(
    octoarm: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, command: Any, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    done = octoarm(command[0], name, *command[1:])
    assert done.exit_code == 2
    assert f"'{name}' is neither a file nor one of" in done.output
    words = done.output.replace(",", " ").replace(".", " ").split()
    for agent, target in trained_agents():
        assert f"{agent}/{target}" in words
    for target in TARGETS:
        assert {f"{kind}/{target}" for kind in TRIVIAL} <= set(words)


def test_files_of_agents(octoarm: Any, tmp_path: Path) -> None:
    """A file of one's own is as good as the name of an agent that comes along."""
    own = tmp_path / "mine.npz"
    load_trained("readout_pinv", "lissajous").save(own)  # type: ignore[attr-defined]
    found = rows(octoarm, tmp_path / "a.json", "readout_pinv/lissajous", own)
    assert found[1] == found[0] | {"agent": str(own)}
    done = octoarm("evaluate", "no-such-agent.npz")
    assert done.exit_code == 2
    assert "cannot open no-such-agent.npz" in done.stderr
