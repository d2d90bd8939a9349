"""`octoarm benchmark --pictures`: one run, plausible figures."""

import json
import os
import sys
import time

import pytest
from octoarm_agents.benchmark import pictures
from octoarm_agents.benchmark.contenders import Contender
from octoarm_agents.benchmark.speed import Spread

OWN = pictures.picture_name(pictures.TARGET_SIZE)
BARE = pictures.picture_name(pictures.TARGET_SIZE, overlay=False)
TINY = ("benchmark", "--pictures", "--seconds", 2, "--rounds", 2)


@pytest.fixture
def few_contenders(monkeypatch):
    """A picture and a step that cost nothing, and no MuJoCo."""
    painter = pictures.Painter(OWN, lambda: None, lambda: None, pictures.TARGET_SIZE)
    stepper = Contender(pictures.step_name(pictures.OFF, 0.01), time.time, range, 10)
    left_out = {pictures.MUJOCO: "it is not wanted"}
    monkeypatch.setattr(pictures, "_make_painters", lambda: ([painter], left_out, None))
    monkeypatch.setattr(pictures, "_make_steppers", lambda: [stepper])


def test_figures_of_one_run(octoarm, tmp_path):
    out = tmp_path / "new" / "pictures.json"
    before = dict(os.environ)
    run = octoarm(*TINY, "--out", out)
    assert run.exit_code == 0, run.output
    assert dict(os.environ) == before
    for words in ("Milliseconds of a picture", "Microseconds of a step", "Target, 60", "CPUs"):
        assert words in run.stdout

    content = json.loads(out.read_text(encoding="utf-8"))
    assert list(out.parent.iterdir()) == [out]
    assert content["rounds"] == 2
    times = content["milliseconds_per_picture"]
    own = {pictures.picture_name(size) for size in pictures.SIZES} | {BARE, pictures.TILES}
    assert own <= set(times)
    for peer in pictures.PEERS:
        assert any(name.startswith(peer) for name in times)
    # It draws only where there is EGL, and where nobody has told it otherwise in this process.
    assert (pictures.MUJOCO in times) != (pictures.MUJOCO in content["left_out"])
    assert (content["machine"]["opengl"] is not None) == (pictures.MUJOCO in times)
    for name, row in times.items():
        assert 0 < row["min"] <= row["median"] <= row["max"]
        assert row["pictures_per_second"] == pytest.approx(1000 / row["median"])
        pixels = row["width"] * row["height"]
        assert row["nanoseconds_per_pixel"] == pytest.approx(1e6 * row["median"] / pixels)
        several = pictures.ENVS if name == pictures.TILES else 1
        assert row["pictures_per_round"] >= several
        assert row["pictures_per_round"] % several == 0
    assert (times["CartPole-v1 600×400"]["width"], times["Pendulum-v1 500×500"]["height"]) == (
        600,
        500,
    )

    steps = content["microseconds_per_step"]
    kinds = (pictures.CORE, pictures.PLAIN, pictures.OFF, pictures.ON)
    single = {pictures.step_name(kind, period) for kind in kinds for period in pictures.PERIODS}
    many = {
        pictures.step_name(kind, 0.01, pictures.ENVS) for kind in kinds if kind != pictures.PLAIN
    }
    assert set(steps) == single | many
    assert {name for name, row in steps.items() if row["envs"] == pictures.ENVS} == many

    # A test shares its machine with others: all these are off by a factor before they fail.
    ratios = content["ratios"]
    assert ratios["frames_per_second"]["median"] > 20
    assert 0.6 < ratios["overlay"]["median"] < 6
    assert 50 < ratios["percent_off_core_10_ms"]["median"] < 200
    assert 50 < ratios["percent_off_plain_1_ms"]["median"] < 200
    assert ratios["difference_on_off_10_ms_64_envs"]["unit"] == "µs"

    rounds = content["milliseconds_by_round"]
    divided = [one / two for one, two in zip(rounds[OWN], rounds[BARE], strict=True)]
    assert ratios["overlay"]["max"] == pytest.approx(max(divided))
    pixel, whole = (ratios[f"{part}_over_cartpole_v1"]["min"] for part in ("pixel", "picture"))
    assert pixel / whole == pytest.approx(600 * 400 / (640 * 480))
    assert content["target"] == {
        "picture": OWN,
        "frames_per_second": 60,
        "reached": times[OWN]["pictures_per_second"] >= 60,
    }
    assert content["versions"]["pygame-ce"]


@pytest.mark.usefixtures("few_contenders")
def test_what_is_left_out_is_named(octoarm):
    run = octoarm(*TINY)
    assert run.exit_code == 0, run.output
    assert f"{pictures.MUJOCO} left out: it is not wanted" in run.stdout
    assert "twin 640×480:" not in run.stdout
    assert "reached." in run.stdout


@pytest.mark.usefixtures("few_contenders")
def test_json_alone_on_standard_output(octoarm):
    content = json.loads(octoarm(*TINY, "--json").stdout)
    assert set(content["ratios"]) == {"frames_per_second"}
    assert content["left_out"] == {pictures.MUJOCO: "it is not wanted"}


def test_without_pygame_the_extra_is_named(octoarm, monkeypatch):
    for name in ("octoarm_agents.benchmark.pictures", "octoarm_env.rendering.toolkit"):
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pygame", None)
    run = octoarm(*TINY)
    assert run.exit_code == 1
    assert 'pip install "octoarm-agents[render]"' in run.stderr
    assert run.stdout == ""


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--seconds", "0", "between 0.1 and 3,600 seconds"),
        ("--rounds", "0", "between 1 and 1,001"),
        ("--out", ".", "folder"),
    ],
)
def test_a_bad_option_is_named(octoarm, option, value, message):
    run = octoarm("benchmark", "--pictures", option, value)
    assert run.exit_code == 2
    assert option in run.stderr
    assert message in run.stderr


class TestMujoco:
    @pytest.fixture(autouse=True)
    def _alone(self, monkeypatch):
        for name in ("_arm", "_tiles", "_peer"):
            monkeypatch.setattr(pictures, name, lambda *_, **__: None)

    def test_not_installed(self, monkeypatch):
        monkeypatch.setattr(pictures, "has_mujoco", lambda: False)
        _, left_out, opengl = pictures._make_painters()
        assert 'pip install "octoarm-agents[benchmark]"' in left_out[pictures.MUJOCO]
        assert opengl is None

    def test_without_anything_to_draw_with(self, monkeypatch):
        def fail():
            raise RuntimeError("no EGL")

        monkeypatch.setattr(pictures, "has_mujoco", lambda: True)
        monkeypatch.setattr(pictures, "_twin", fail)
        _, left_out, _ = pictures._make_painters()
        assert left_out == {pictures.MUJOCO: "it cannot draw here: no EGL"}


def test_moves_are_not_timed():
    calls = []

    def move():
        time.sleep(0.05)
        calls.append("move")

    painter = pictures.Painter("slow", move, lambda: calls.append("draw"), (16, 16))
    assert painter.seconds(3) < 0.05
    assert calls == ["move", "draw"] * 3


def test_ratios_are_formed_within_a_round():
    size = pictures.TARGET_SIZE
    painters = {
        OWN: pictures.Painter(OWN, print, print, size),
        "half": pictures.Painter("half", print, print, (size[0] // 2, size[1]), peer="half"),
    }
    off, on = (pictures.step_name(kind, 0.01) for kind in (pictures.OFF, pictures.ON))
    result = pictures.PictureResult(
        2, painters, {}, {}, {OWN: [10.0, 30.0], "half": [5.0, 5.0]}, {off: [4, 8], on: [5, 10]}
    )
    found = {ratio.key: ratio.spread for ratio in result.ratios()}
    assert found == {
        "frames_per_second": Spread(1000 / 30, 200 / 3, 100.0),
        "picture_over_half": Spread(2.0, 4.0, 6.0),
        "pixel_over_half": Spread(1.0, 2.0, 3.0),
        "difference_on_off_10_ms": Spread(1, 1.5, 2),
        "percent_on_off_10_ms": Spread(125.0, 125.0, 125.0),
    }
    assert result.rate(OWN) == 50.0
