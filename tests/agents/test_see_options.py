"""What `octoarm watch` and `octoarm record` refuse, before anything is computed or written."""

import sys
import typing

import pytest
from episodes import SMALL
from octoarm_agents.cli import pictures

from octoarm_env import ArmParameters
from octoarm_env.rendering import CAMERAS

RECORD, WATCH = ("record", "hold/quadratic", "--out", "film.mp4"), ("watch", "hold/quadratic")
BY_HAND = ("watch",)
CAMERA_NAMES = "'perspective', 'front', 'side', 'top', 'base'"


@pytest.mark.parametrize(
    ("command", "option", "value", "reason"),
    [
        *(
            (command, option, value, reason)
            for command in (RECORD, BY_HAND)
            for option, value, reason in (
                ("--steps", "9", "9 is not between 10 and 1,000,000"),
                ("--seed", "-1", "-1 is not between 0 and 2,147,483,647"),
                ("--push", "nan", "nan is not between 0 and 360 degrees"),
                ("--noise", "0.5", "0.5 is not between 0 and 0.01 metres"),
                ("--arm", "no-such-file.json", "cannot read no-such-file.json"),
                ("--arm", "heavy.json", "no static equilibrium found"),
                ("--speed", "0", "0.0 is not between 0.01 and 100"),
                ("--width", "63", "63 is not between 64 and 4,096 pixels"),
                ("--height", "4097", "4097 is not between 64 and 4,096 pixels"),
                ("--camera", "behind", f"'behind' is not one of {CAMERA_NAMES}"),
                ("--zoom", "nan", "nan is not between 0.2 and 6"),
                ("--exaggeration", "0.5", "0.5 is not between 1 and 50"),
            )
        ),
        (RECORD, "--fps", "241", "241.0 is not between 1 and 240"),
        (RECORD, "--out", "film", "film does not end in one of .mp4, .gif, .png, .rrd"),
        (RECORD, "--out", ".mp4", ".mp4 does not end in one of .mp4, .gif, .png, .rrd"),
        (RECORD, "--out", "film.mp4.part", "does not end in one of .mp4, .gif, .png, .rrd"),
        (RECORD, "--out", "folder.mp4", "is a folder, expected a file"),
        (RECORD, "--out", "heavy.json/film.mp4", "cannot make folder"),
        ((*RECORD, "--width", "161"), "--out", "film.mp4", "needs an even width and height"),
        ((*RECORD, "--fps", "50.5"), "--out", "film.gif", "fps = 50.5 is too fast for a .gif"),
        ((*RECORD, "--steps", "100000"), "--out", "film.gif", "25,001 frames of 640×480 are"),
        (WATCH, "--episodes", "0", "0 is not between 1 and 4,096"),
        (WATCH, "--speed", "101", "101.0 is not between 0.01 and 100"),
        (WATCH, "--target", "lissajous", "an agent has its own target"),
        (WATCH, "--view", "screen", "'screen' is not one of 'auto', 'window', 'terminal', 'rerun'"),
        (BY_HAND, "--view", "terminal", "the mouse needs a window: name a POLICY"),
        (BY_HAND, "--view", "browser", "the mouse needs a window: name a POLICY"),
        (BY_HAND, "--target", "nowhere", "'nowhere' is not one of 'quadratic', 'van_der_pol'"),
    ],
)
def test_a_bad_option_is_named(octoarm, command, option, value, reason, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ArmParameters(arm_density=20_000.0).to_json(tmp_path / "heavy.json")
    (tmp_path / "folder.mp4").mkdir()
    result = octoarm(*command, option, value)
    assert result.exit_code == 2
    assert f"'{option}'" in result.stderr
    assert reason in result.stderr
    assert "Traceback" not in result.output
    assert len(list(tmp_path.iterdir())) == 2


def test_a_body_that_does_not_fit_the_agent(octoarm, tmp_path):
    ArmParameters(compartments=10).to_json(tmp_path / "body.json")
    for command in ("evaluate", "watch"):
        result = octoarm(command, "ppo/quadratic", "--arm", tmp_path / "body.json")
        assert result.exit_code == 2
        assert "has 10 compartments, the agent is for a body with 20." in result.stderr


def test_cameras_are_those_of_the_library():
    names, _ = typing.get_args(pictures.CameraName)
    assert typing.get_args(names) == tuple(CAMERAS)


@pytest.mark.parametrize(
    ("missing", "file"),
    [("pygame", "a.mp4"), ("pygame", "a.png"), ("imageio_ffmpeg", "a.mp4")],
)
def test_the_extra_is_named(octoarm, missing, file, tmp_path, monkeypatch):
    for name in ("toolkit", "renderer", "panels", "water", "window"):
        monkeypatch.delitem(sys.modules, f"octoarm_env.rendering.{name}", raising=False)
    monkeypatch.setitem(sys.modules, missing, None)
    options = ("hold/quadratic", "--steps", 10, *SMALL, "--out")
    result = octoarm("record", *options, tmp_path / file)
    assert result.exit_code == 1
    assert 'pip install "octoarm-agents[render]"' in result.stderr
    assert result.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
    # Without ffmpeg there are still pictures, without pygame recordings.
    other = {"pygame": "a.rrd", "imageio_ffmpeg": "a.png"}[missing]
    assert octoarm("record", *options, tmp_path / other).exit_code == 0


def test_the_help(octoarm):
    for command, parts in (
        ("record", ("--exaggeration", ".mp4, .gif, .png, .rrd", "clock/TARGET", "rerun FILE.rrd")),
        ("watch", ("--view", "terminal|rerun|browser", "60,000 with the mouse")),
    ):
        result = octoarm(command, "--help")
        assert result.exit_code == 0
        for part in parts:
            assert part in result.stdout


def test_inspect_is_gone(octoarm):
    assert "inspect" not in octoarm("--help").stdout
