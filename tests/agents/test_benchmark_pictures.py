"""`octoarm benchmark --pictures`: one run, plausible figures."""

import json
import sys

import pytest
from octoarm_agents.benchmark import pictures
from octoarm_agents.benchmark.turns import Contender

TINY = ("benchmark", "--pictures", "--seconds", 0.1, "--rounds", 1)


def test_figures_of_one_run(octoarm, monkeypatch, tmp_path):
    monkeypatch.setattr(pictures, "SIZES", pictures.SIZES[1:3])
    monkeypatch.setattr(pictures, "CASES", ((1, 0.01), (8, 0.001)))
    monkeypatch.setattr(pictures, "_LATE_STEPS", 3)
    out = tmp_path / "new" / "pictures.json"
    run = octoarm(*TINY, "--out", out)
    assert run.exit_code == 0, run.output
    for words in ("Milliseconds per picture", "Microseconds per step", "pictures per second"):
        assert words in run.stdout

    content = json.loads(out.read_text(encoding="utf-8"))
    assert list(out.parent.iterdir()) == [out]
    rows = content["contenders"]
    own = {pictures.picture_name(size) for size in pictures.SIZES}
    steps = {
        pictures.step_name(kind, *case)
        for kind in (pictures.OFF, pictures.ON)
        for case in pictures.CASES
    }
    assert set(rows) - {pictures.MUJOCO} == own | steps
    # It draws only where there is EGL, and where nobody has told it otherwise in this process.
    assert (pictures.MUJOCO in rows) != (pictures.MUJOCO in content["left_out"])
    assert ("opengl" in content) == (pictures.MUJOCO in rows)
    for name in own:
        median = rows[name]["milliseconds_per_picture"]["median"]
        assert rows[name]["pictures_per_second"] == pytest.approx(1000 / median)
    for name in steps:
        assert rows[name]["microseconds_per_step"]["median"] > 0
    assert content["ratios"]["undrawn_minus_off_1_ms_8_envs"]["unit"] == "µs"
    assert content["ratios"]["undrawn_over_off_10_ms_1_envs"]["unit"] == "%"
    assert content["versions"]["pygame-ce"]


@pytest.mark.parametrize(
    ("installed", "reason"),
    [(True, "it cannot draw here: no EGL"), (False, "octoarm-agents[benchmark]")],
)
def test_what_is_left_out_is_named(octoarm, monkeypatch, installed, reason):
    def fail():
        raise RuntimeError("no EGL")

    def contender(name, *_):
        return Contender(str(name), lambda seconds: {"milliseconds_per_picture": 1.0})

    monkeypatch.setattr(pictures, "has_mujoco", lambda: installed)
    monkeypatch.setattr(pictures, "_twin", fail)
    monkeypatch.setattr(pictures, "_picture", contender)
    monkeypatch.setattr(pictures, "_steps", contender)
    run = octoarm(*TINY)
    assert run.exit_code == 0, run.output
    assert f"{pictures.MUJOCO} left out: " in run.stdout
    assert reason in run.stdout


def test_without_pygame_the_extra_is_named(octoarm, monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    run = octoarm(*TINY)
    assert run.exit_code == 1
    assert 'pip install "octoarm-agents[render]"' in run.stderr


def test_moves_are_not_timed(monkeypatch):
    calls = []
    clock = iter(range(100))
    monkeypatch.setattr(pictures.time, "perf_counter", lambda: float(next(clock)))
    painter = pictures._painter(
        "slow", lambda: calls.append("move"), lambda: calls.append("draw"), lambda: None
    )
    # Two looks at the clock a picture, none in between; one picture to fit and one that counts.
    assert painter.measure(1.0) == {"milliseconds_per_picture": 1000.0}
    assert calls == ["move", "draw"] * 3
