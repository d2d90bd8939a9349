"""`octoarm demo`: the body holds the cycle, comes back to it, and the files say so."""

import collections
import functools
import json
import subprocess
import sys

import numpy as np
import pytest
from octoarm_agents import demo
from octoarm_agents.demo import MINIMUM_STEPS, DemoSettings, run_demo
from octoarm_agents.demo_figure import draw_demo
from PIL import Image

import octoarm_env


def read_figure(path):
    with Image.open(path) as image:
        assert image.format == "PNG"
        return np.asarray(image.convert("L"))


@pytest.fixture(autouse=True, scope="module")
def taught_once():
    """What several tests are taught is taught once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demo, "teach", functools.cache(demo.teach))
        yield


@pytest.fixture(scope="module")
def result(taught_once):
    """The demonstration at its shortest."""
    return run_demo(DemoSettings(steps=MINIMUM_STEPS))


@pytest.mark.parametrize(
    ("actuator", "options"),
    # The paper's own training at the paper's R holds the cycle too.
    [("direct", ()), ("servo", ()), ("direct", ("--plain",))],
)
def test_the_body_holds_the_cycle_and_recovers(octoarm, tmp_path, actuator, options):
    run = octoarm("demo", "--out", tmp_path, "--actuator", actuator, *options)
    assert run.exit_code == 0, run.output
    assert "recovered" in run.stdout

    content = json.loads((tmp_path / "demo.json").read_text(encoding="utf-8"))
    scores = content["scores"]
    assert scores["held"] is True
    assert scores["recovered"] is True
    # Measured 0.00001 to 0.00025; noise of 10 degrees moves the outputs by up to 0.02 R.
    assert scores["before"]["mean_distance"] < 0.0005
    assert scores["after"]["mean_distance"] < 0.001
    assert scores["burst"]["max_distance"] > 0.005
    assert 0 <= scores["recovery_time"] < 4.0
    for window in (scores["before"], scores["after"]):
        assert window["period_ratio"] == pytest.approx(1.0, abs=1e-3)
        assert window["amplitude_ratio"] == pytest.approx(1.0, abs=0.01)

    assert content["failure"] is None
    assert content["closed_loop_steps_made"] == 20_000
    assert content["settings"]["actuator"] == actuator
    assert content["settings"]["noise_sampled"] is bool(options)
    assert content["settings"]["seed"] == 0
    assert content["body"] == json.loads(octoarm_env.ArmParameters().to_json())
    assert content["versions"]["octoarm-env"] == octoarm_env.__version__
    assert np.shape(content["readout"]["weights_degrees_per_metre"]) == (80, 2)
    assert content["speed"]["physics_steps"] == 25_000
    assert content["speed"]["times_real_time"] > 1

    figure = read_figure(tmp_path / "demo.png")
    assert min(figure.shape) > 1000
    assert 0.02 < (figure < 200).mean() < 0.5
    assert sorted(path.name for path in tmp_path.iterdir()) == ["demo.json", "demo.png"]


def test_another_seed_gives_another_burst(result):
    other = run_demo(DemoSettings(steps=MINIMUM_STEPS, seed=1))
    begin = result.settings.burst_begin
    # The first output under noise is computed before the noise reaches the body.
    np.testing.assert_array_equal(result.outputs[: begin + 1], other.outputs[: begin + 1])
    assert not np.array_equal(result.outputs[begin + 1], other.outputs[begin + 1])


def test_every_step_is_reported_and_the_same_seed_gives_the_same_run(result):
    seen = collections.Counter()

    def advance(stage, steps):
        seen[stage] += steps

    again = run_demo(DemoSettings(steps=MINIMUM_STEPS), advance=advance)
    np.testing.assert_array_equal(result.outputs, again.outputs)
    assert seen == {
        "teaching": 70_000,
        "swinging in": 5_000,
        "alone": 6_000,
        "disturbed": 1_000,
        "alone again": 5_000,
    }
    assert result.physics_steps == sum(seen.values()) - seen["teaching"]


def test_the_shapes_are_arms_of_one_turn(result):
    assert result.shapes.shape == (8, 21, 3)
    struts = np.linalg.norm(np.diff(result.shapes, axis=1), axis=2)
    np.testing.assert_allclose(struts, 0.02, rtol=0.3)
    tips = result.shapes[:, -1, :2]
    # The arm swings to both sides: half a turn later it is on the other side of the base.
    np.testing.assert_allclose(tips[:4], -tips[4:], atol=0.04)


def test_without_a_burst_nothing_is_disturbed(octoarm, tmp_path):
    run = octoarm("demo", "--out", tmp_path, "--burst", 0, "--steps", MINIMUM_STEPS)
    assert run.exit_code == 0, run.output
    scores = json.loads((tmp_path / "demo.json").read_text(encoding="utf-8"))["scores"]
    assert scores["burst"]["max_distance"] < 0.02
    assert scores["recovery_time"] == 0


@pytest.mark.parametrize(
    ("options", "stage", "advice"),
    [
        (("--target", "van_der_pol", "--amplitude", 30, "--burst", 5), "disturbed", "--burst"),
        (("--plain", "--amplitude", 30), "alone", "calibrate"),
        (("--amplitude", 150), "teaching", "--amplitude"),
    ],
)
def test_leaving_the_domain_of_a_body_from_a_file_is_reported(
    octoarm, tmp_path, options, stage, advice
):
    body = octoarm_env.ArmParameters.preset("inertial")
    body.to_json(tmp_path / "body.json")
    options += ("--arm", tmp_path / "body.json", "--steps", MINIMUM_STEPS)
    run = octoarm("demo", "--out", tmp_path, *options)
    assert run.exit_code == 1
    assert "left its domain" in run.stderr
    assert advice in run.stderr
    assert "Traceback" not in run.output

    content = json.loads((tmp_path / "demo.json").read_text(encoding="utf-8"))
    assert content["body"] == json.loads(body.to_json())
    failure = content["failure"]
    assert failure["stage"] == stage
    assert failure["limit"] in failure["message"].replace("-", "_")
    assert not failure["low"] <= failure["value"] <= failure["high"]
    assert failure["time"] > 0
    made = content["closed_loop_steps_made"]
    assert made == 0 if stage == "teaching" else 0 < made < MINIMUM_STEPS
    assert content["scores"]["recovered"] is False
    assert (read_figure(tmp_path / "demo.png") < 200).mean() > 0.005


def test_an_arm_at_rest_does_not_hold_the_lissajous_curve(octoarm, tmp_path):
    """That curve passes through the origin, so that the distance alone is small at rest."""
    options = ("--target", "lissajous", "--amplitude", 2, "--noise", 4e-4, "--plain", "--burst", 0)
    run = octoarm("demo", "--out", tmp_path, "--steps", 60_000, *options)
    assert run.exit_code == 1
    scores = json.loads((tmp_path / "demo.json").read_text(encoding="utf-8"))["scores"]
    assert scores["after"]["mean_distance"] < 0.01
    assert scores["after"]["amplitude_ratio"] < 0.1
    assert scores["after"]["held"] is False


@pytest.mark.parametrize(
    ("option", "value", "allowed"),
    [
        ("--amplitude", "-30", "between 0.1 and 360 degrees"),
        ("--amplitude", "nan", "between 0.1 and 360 degrees"),
        ("--noise", "-1e-5", "between 0 and 0.01 metres"),
        ("--burst", "inf", "between 0 and 360 degrees"),
        ("--steps", "5", "between 12,000 and 10,000,000"),
        ("--seed", "-1", "between 0 and 4,294,967,295"),
        ("--actuator", "muscle", "'direct', 'servo'"),
        ("--target", "circle", "'quadratic'"),
        ("--arm", "no-such-file.json", "cannot read no-such-file.json"),
    ],
)
def test_a_bad_option_is_named(octoarm, tmp_path, option, value, allowed):
    run = octoarm("demo", "--out", tmp_path, option, value)
    assert run.exit_code == 2
    assert option in run.stderr
    assert value.removeprefix("-")[:2] in run.stderr
    assert allowed in run.stderr
    assert "Traceback" not in run.output
    assert not list(tmp_path.iterdir())


def test_a_bad_body_is_named(octoarm, tmp_path):
    body = tmp_path / "body.json"
    body.write_text('{"longitudinal_mass": -1.0}', encoding="utf-8")
    run = octoarm("demo", "--out", tmp_path / "out", "--arm", body)
    assert run.exit_code == 2
    assert "--arm" in run.stderr
    assert "longitudinal_mass" in run.stderr


def test_a_folder_that_cannot_be_made_is_named(octoarm, tmp_path):
    (tmp_path / "file").touch()
    run = octoarm("demo", "--out", tmp_path / "file" / "folder")
    assert run.exit_code == 2
    assert "--out" in run.stderr


@pytest.mark.parametrize("arguments", [{"steps": MINIMUM_STEPS - 1}, {"burst": -1.0}])
def test_settings_refuse_what_cannot_be_done(arguments):
    with pytest.raises(ValueError, match=next(iter(arguments))):
        DemoSettings(**arguments)


def test_drawing_leaves_no_state_behind(result):
    had_pyplot = sys.modules.pop("matplotlib.pyplot", None)
    try:
        draw_demo(result)
        assert "matplotlib.pyplot" not in sys.modules
    finally:
        if had_pyplot is not None:
            sys.modules["matplotlib.pyplot"] = had_pyplot


def test_the_command_starts_without_the_heavy_libraries():
    code = (
        "import sys, octoarm_agents.cli\n"
        "print([name for name in ('numpy', 'matplotlib', 'gymnasium', 'mujoco', 'octoarm_env')"
        " if name in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_the_command_is_installed():
    run = subprocess.run(
        [sys.executable, "-c", "from octoarm_agents.cli import main; main()", "--version"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout.startswith("octoarm 0.")
