"""`octoarm benchmark`: one run, plausible figures."""

import json

import pytest
from octoarm_agents.benchmark import speed

TINY = ("benchmark", "--seconds", 2.5, "--rounds", 5)


@pytest.fixture
def without_mujoco(monkeypatch):
    monkeypatch.setattr(speed, "has_mujoco", lambda: False)


def test_figures_of_one_run(octoarm, tmp_path):
    pytest.importorskip("mujoco")
    out = tmp_path / "new" / "speed.json"
    run = octoarm(*TINY, "--out", out)
    assert run.exit_code == 0, run.output
    for words in ("Microseconds a step", "MuJoCo twin / arm", "CPUs", "numpy"):
        assert words in run.stdout

    content = json.loads(out.read_text(encoding="utf-8"))
    assert content["rounds"] == 5
    times = content["microseconds_per_step"]
    assert set(times) == {
        speed.ARM_RUN,
        speed.ARM_RUN_SERVO,
        speed.ARM_RUN_DRY,
        speed.ARM_STEP,
        speed.TWIN,
        speed.ENV_BARE,
        speed.ENV_MADE,
    }
    for spread in times.values():
        assert 0 < spread["min"] <= spread["median"] <= spread["max"]
        assert spread["steps_per_round"] >= 1

    # About 40 with AVX-512, 20 and more with less; a test shares its machine with others.
    assert content["ratios"]["mujoco_twin_over_arm_same_physics"]["median"] > 15
    # Ten physics steps: the environment must cost more than five and less than forty of them.
    env = times[speed.ENV_BARE]["median"] / times[speed.ARM_RUN_SERVO]["median"]
    assert 5 < env < 40
    assert content["machine"]["cpu_count"] >= 1
    assert content["versions"]["mujoco"]
    assert list(out.parent.iterdir()) == [out]


@pytest.mark.usefixtures("without_mujoco")
def test_without_mujoco_the_rest_is_measured(octoarm):
    run = octoarm(*TINY)
    assert run.exit_code == 0, run.output
    assert "octoarm-agents[benchmark]" in run.stdout
    assert "Arm.run" in run.stdout
    assert "twin /" not in run.stdout


@pytest.mark.usefixtures("without_mujoco")
def test_json_alone_on_standard_output(octoarm):
    run = octoarm("benchmark", "--seconds", 0.3, "--rounds", 1, "--json")
    content = json.loads(run.stdout)
    assert content["ratios"]["mujoco_twin_over_arm_same_physics"] is None
    assert content["microseconds_per_step"][speed.ARM_RUN]["median"] > 0


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--seconds", "0", "between 0.1 and 3,600 seconds"),
        ("--rounds", "0", "between 1 and 1,001"),
        ("--out", ".", "folder"),
    ],
)
def test_a_bad_option_is_named(octoarm, option, value, message):
    run = octoarm("benchmark", option, value)
    assert run.exit_code == 2
    assert option in run.stderr
    assert message in run.stderr


def test_spread_of_rounds():
    assert speed.Spread.of([3.0, 1.0, 2.0]).to_dict() == {"min": 1.0, "median": 2.0, "max": 3.0}


def test_ratios_are_formed_within_a_round():
    result = speed.SpeedResult(
        2,
        {},
        {speed.TWIN: [100.0, 300.0], speed.ARM_RUN_DRY: [10.0, 20.0], speed.ARM_RUN: [20.0, 20.0]},
    )
    assert result.twin_over_arm == speed.Spread(10.0, 12.5, 15.0)


def test_overhead_is_the_time_beyond_ten_physics_steps():
    result = speed.SpeedResult(
        2, {}, {speed.ENV_BARE: [107.0, 113.0], speed.ARM_RUN_SERVO: [10.0, 11.0]}
    )
    assert result.overhead(speed.ENV_BARE) == speed.Spread(3.0, 5.0, 7.0)
