"""`octoarm analyse arm`: the arm under an independent input, and the sweep over its body."""

import json

import numpy as np
import pytest
from octoarm_agents.analysis.drive import Drive, DrivenArm, record_arm, state_scales
from octoarm_agents.analysis.measures import MeasureSettings
from octoarm_agents.analysis.survey import SurveySettings, survey_arm
from octoarm_agents.analysis.sweep import SweepPoint, default_values, run_sweep
from octoarm_agents.analysis.sweep_figure import draw_sweep
from PIL import Image

from octoarm_env import ArmParameters, DomainError

SHORT = SurveySettings(
    drive=Drive(amplitude=5.0, hold=0.02),
    measures=MeasureSettings(max_delay=20, delays=(20, 5), washout=20),
    samples=450,
    streams=20,
    stream_length=5,
    echo_length=50,
    lyapunov_length=40,
)
"""A survey of a second. Its figures are rough; the default one's are measured below."""


@pytest.fixture(scope="module")
def survey():
    return survey_arm(ArmParameters(), SHORT)


def test_the_path_meets_every_value_and_stands_still_there():
    drive = Drive(amplitude=10.0, hold=0.05)
    values = np.array([0.5, -1.0, 1.0])
    angles = drive.angles(values, 0.2, 0.001)
    assert angles.shape == (150, 2)
    np.testing.assert_array_equal(angles[:, 0], angles[:, 1])
    np.testing.assert_allclose(angles[49::50, 0], 10 * values, rtol=1e-12)
    # A minimum-jerk path: its greatest speed is 15/8 of the mean speed, at the middle.
    speeds = np.diff(np.concatenate(([2.0], angles[:, 0]))) / 0.001
    assert np.abs(speeds[50:100]).max() == pytest.approx(15 / 8 * 15.0 / 0.05, rel=2e-3)
    assert np.abs(speeds[[49, 50, 99, 100]]).max() < 2.0
    assert not Drive(axes="theta").angles(values, 0.0, 0.001)[:, 1].any()


@pytest.mark.parametrize("actuator", ["direct", "servo"])
def test_recording_is_running(actuator):
    drive = Drive(amplitude=5.0, hold=0.02, actuator=actuator)
    values = np.random.default_rng(0).uniform(-1, 1, 450)
    recording = record_arm(ArmParameters(), drive, values)
    assert recording.states.shape == (450, 4 * ArmParameters().compartments)
    one = DrivenArm(ArmParameters(), drive)
    for value in values:
        one.run(np.array([value]))
    np.testing.assert_array_equal(one.arm.lengths, recording.states[-1])


def test_a_state_put_back_goes_on_as_before():
    drive = Drive(amplitude=5.0, hold=0.02)
    values = np.random.default_rng(0).uniform(-1, 1, 30)
    scales = state_scales(ArmParameters(), drive, values)
    assert (scales > 0).all()
    first, second = (DrivenArm(ArmParameters(), drive, scales) for _ in range(2))
    first.run(values)
    second.place(first.vector, first.arm.state.base, first.last)
    np.testing.assert_array_equal(second.arm.state.base, first.arm.state.base)
    for driven in (first, second):
        driven.run(values[:5])
    # Dividing and multiplying by the scales costs a rounding error.
    np.testing.assert_allclose(second.vector, first.vector, rtol=1e-9, atol=1e-9)


def test_the_arm_remembers_computes_and_forgets():
    """The default survey with fewer samples: bounds that any body of the paper's kind keeps."""
    settings = SurveySettings(
        measures=MeasureSettings(max_delay=40, delays=(40, 12, 6)),
        samples=3000,
        streams=40,
        stream_length=20,
        echo_length=1000,
        lyapunov_length=1000,
    )
    survey = survey_arm(ArmParameters(), settings)
    processing = survey.measures.processing
    assert 2 < survey.measures.memory.total < 20
    assert survey.measures.memory.held_out_total == pytest.approx(
        survey.measures.memory.total, rel=0.1
    )
    assert processing.nonlinear > processing.linear
    assert processing.total < processing.rank == 80
    assert survey.ranks.generalisation_rank < survey.ranks.kernel_rank < 40
    assert survey.echo.verdict in ("forgotten", "fading")
    assert 0.1 < survey.echo.decay_time_seconds < 20
    assert survey.lyapunov.exponent_per_second < -2 * survey.lyapunov.standard_error_per_second


def test_the_same_seed_gives_the_same_survey(survey):
    again = survey_arm(ArmParameters(), SHORT)
    assert again.to_dict() == survey.to_dict()
    json.dumps(survey.to_dict(), allow_nan=False)  # refuses what JSON does not have


def test_the_command_writes_file_and_figure(octoarm, tmp_path):
    run = octoarm(
        *("analyse", "arm", "--out", tmp_path, "--amplitude", 5, "--hold", 0.01, "--samples", 450),
        *("--max-delay", 10, "--delays", "10,4", "--washout", 20, "--axes", "theta"),
        *("--actuator", "servo", "--seed", 3),
    )
    assert run.exit_code == 0, run.output
    assert "largest conditional Lyapunov exponent" in run.stdout
    content = json.loads((tmp_path / "analysis.json").read_text(encoding="utf-8"))
    assert content["survey"]["drive"] == {
        "amplitude_degrees": 5.0,
        "hold_seconds": 0.01,
        "axes": "theta",
        "actuator": "servo",
    }
    assert content["rows"] == 480
    assert content["settings"]["seed"] == 3
    assert content["body"] == json.loads(ArmParameters().to_json())
    assert len(content["echo_state"]["distances"]) == 2001
    with Image.open(tmp_path / "analysis.png") as image:
        assert min(image.size) > 800


def test_leaving_the_domain_is_reported(octoarm, tmp_path):
    run = octoarm(
        *("analyse", "arm", "--arm", "inertial", "--out", tmp_path),
        *("--amplitude", 200, "--hold", 0.01),
    )
    assert run.exit_code == 1
    assert "Ended during recording: the arm left its domain" in run.stderr
    assert "--amplitude" in run.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_sweep_is_the_same_with_more_processes_and_lists_what_failed():
    arguments = "range", (2.5, 200.0), ArmParameters.preset("inertial"), SHORT
    points = run_sweep(*arguments, jobs=1)
    assert points[0].failure is None
    assert points[1].summary is None
    assert "left its domain" in points[1].failure
    both = run_sweep(*arguments, jobs=2)
    assert [point.to_dict() for point in both] == [point.to_dict() for point in points]


@pytest.mark.parametrize("quantity", ["stiffness", "damping", "drag"])
def test_a_factor_of_one_is_the_body_itself(survey, quantity):
    same, other = run_sweep(quantity, (1.0, 1.5), ArmParameters(), SHORT)
    assert same.summary == survey.summary()
    assert other.summary != survey.summary()


def test_the_sweep_command_writes_table_and_figure(octoarm, tmp_path):
    run = octoarm(
        *("analyse", "arm", "--out", tmp_path, "--sweep", "range", "--values", "3,200"),
        *("--arm", "inertial", "--hold", 0.01, "--samples", 450, "--jobs", 1),
        *("--max-delay", 10, "--delays", "10,4"),
        *("--washout", 20),
    )
    assert run.exit_code == 0, run.output
    assert "range 200: the arm left its domain" in run.stderr
    content = json.loads((tmp_path / "analysis.json").read_text(encoding="utf-8"))
    assert [point["value"] for point in content["points"]] == [3.0, 200.0]
    assert content["points"][0]["memory_capacity"] > 0
    assert "memory_capacity" not in content["points"][1]
    warnings = content["points"][0]["warnings"]
    assert any("The memory does not end within 10 rows" in warning for warning in warnings)
    assert all(f"range 3: {warning}" in run.stdout for warning in warnings)
    with Image.open(tmp_path / "analysis.png") as image:
        assert min(image.size) > 800


@pytest.mark.parametrize("failures", [(), (4.0,), (1.0, 2.0, 4.0)])
def test_every_sweep_can_be_drawn(survey, tmp_path, failures):
    points = [
        SweepPoint(value, None, "it broke")
        if value in failures
        else SweepPoint(value, survey.summary(), None)
        for value in (1.0, 2.0, 4.0)
    ]
    figure = draw_sweep("drag", points)
    figure.savefig(tmp_path / "sweep.png")  # warnings are errors: the layout must work out
    texts = [text.get_text() for text in figure.axes[-1].texts]
    assert bool(texts) == bool(failures)
    for value in failures:
        assert f"× {value:g}: it broke" in texts[0]
    # Each point is drawn in each panel, or there is a cross.
    for axes in figure.axes[:-1]:
        assert sum(line.get_marker() == "x" for line in axes.lines) == bool(failures)
    assert len(figure.axes[0].lines[0].get_xdata()) == 3 - len(failures)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--values", "1,2"), "only --sweep takes values"),
        (("--sweep", "drag", "--values", "1,0"), "drag = 0.0: expected a positive number"),
        (("--sweep", "drag", "--values", "one"), "expected numbers with commas"),
        (("--amplitude", 0), "0.0 is not between 0.001 and 360 degrees"),
        (("--samples", 10), "10 is not between 400 and"),
        (("--sweep", "colour"), "'colour' is not one of"),
    ],
)
def test_options_out_of_range_are_refused(octoarm, tmp_path, options, message):
    run = octoarm("analyse", "arm", "--out", tmp_path, *options)
    assert run.exit_code == 2
    assert message in run.stderr


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Drive(amplitude=0), "amplitude = 0: expected"),
        (lambda: Drive(hold=-1), "hold = -1: expected"),
        (lambda: Drive(hold=1e-3).hold_steps(1e-3), "at least two physics steps"),
        (lambda: Drive(axes="phi"), "axes = 'phi': expected"),
        (lambda: SurveySettings(streams=1), "streams = 1: expected a whole number, at least 2"),
        (lambda: SurveySettings(similarity=1.0), "similarity = 1.0: expected a share"),
        (lambda: run_sweep("colour", (1.0,), ArmParameters(), SHORT), "quantity = 'colour'"),
        (lambda: run_sweep("drag", (), ArmParameters(), SHORT), "values: expected at least one"),
        (lambda: run_sweep("drag", (-1.0,), ArmParameters(), SHORT), "drag = -1.0: expected"),
    ],
)
def test_settings_out_of_range_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_default_values_surround_what_is_there():
    assert 1.0 in default_values("stiffness", SHORT)
    assert SHORT.drive.amplitude in default_values("range", SHORT)


def test_too_much_is_a_domain_error():
    with pytest.raises(DomainError):
        record_arm(
            ArmParameters.preset("inertial"),
            Drive(amplitude=300.0, hold=0.01),
            np.array([1.0, -1.0, 1.0]),
        )
