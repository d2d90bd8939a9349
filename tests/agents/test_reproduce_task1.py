"""`octoarm reproduce`: Table 2 and Figures 4 and 5, on slices of them."""

import json

import numpy as np
import pytest
from octoarm_agents.common.intervals import bootstrap_interval, summarise, welch_p_value
from octoarm_agents.common.trials import run_trials
from octoarm_agents.experiments import EXPERIMENTS
from octoarm_agents.experiments.emulation import figure5a
from octoarm_agents.experiments.emulation.figure5a import (
    PAPER_FEATURES,
    RANGES,
    SENSOR_NOISE,
    check_features,
)
from octoarm_agents.experiments.emulation.protocol import (
    PAPER,
    RANGE,
    TASKS,
    TrialInput,
    fit_readout,
    record_many,
    score_features,
)
from octoarm_agents.experiments.emulation.trials import (
    compare_methods,
    leave_out_compartments,
    record_trials,
    score_arm,
)
from octoarm_agents.reservoir.baselines import powers
from octoarm_agents.reservoir.readout import Readout
from PIL import Image

from octoarm_env import Arm, ArmParameters, DomainError

# Carried along by its base, slow and draggy: one that some motions take out of its domain.
HEAVY = ArmParameters.preset("inertial").replace(area_scale=48.0, plane_mass=0.044, lift_scale=-1.0)

METHODS = ("arm", "linear_regressor", "mean_predictor", "cubic", "delay2", "delay3", "esn80")


def read_result(folder, name):
    """The JSON of an experiment, after a look at its figure."""
    with Image.open(folder / f"{name}.png") as image:
        assert image.format == "PNG"
        figure = np.asarray(image.convert("L"))
    assert min(figure.shape) > 500
    assert 0.01 < (figure < 200).mean() < 0.5
    return json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def drive():
    return TrialInput.make("sines", 0, 0)


@pytest.fixture(scope="module")
def lengths(drive):
    (lengths,) = record_many([Arm()], [drive], [RANGE])
    return lengths


def test_a_trial_has_the_phases_of_section_2_2_1():
    starts = {TrialInput.make("sines", 0, trial).initial for trial in range(60)}
    assert min(starts) >= 0
    assert max(starts) <= 1000
    assert len(starts) > 50
    drive = TrialInput.make("sines", 0, 1)
    assert drive.training == slice(drive.initial + 1_000, drive.initial + 11_000)
    assert drive.test == slice(drive.initial + 11_000, drive.initial + 16_000)
    assert drive.signal.shape == (drive.test.stop,)
    assert drive.targets.shape == (drive.test.stop, 3)


def test_a_trial_is_the_same_from_the_same_seed_and_number():
    first, again, other, seed = (
        TrialInput.make("iid", *each) for each in ((3, 1), (3, 1), (3, 2), (4, 1))
    )
    np.testing.assert_array_equal(first.signal, again.signal)
    for different in (other, seed):
        assert not np.array_equal(first.signal[:60], different.signal[:60])
    with pytest.raises(ValueError, match="kind = 'noise': expected one of"):
        TrialInput.make("noise", 0, 0)


def test_the_scale_is_the_same_in_all_trials_and_reaches_the_range():
    trials = [TrialInput.make("sines", 0, trial) for trial in range(5)]
    assert len({trial.peak for trial in trials}) == 1
    assert all(np.abs(trial.signal).max() <= trial.peak for trial in trials)


def test_the_linear_regressor_has_the_errors_of_table_2():
    # It needs no arm, so that this checks input, targets, phases and error alone.
    errors = []
    for trial in range(20):
        drive = TrialInput.make("sines", 0, trial)
        errors.append(list(score_features(powers(drive.signal, 1), drive)[0]["test"].values()))
    expected = [PAPER[task]["linear_regressor"][0] for task in TASKS]
    np.testing.assert_allclose(np.mean(errors, axis=0), expected, rtol=0.05)


def test_the_readout_predicts_the_next_output_from_the_lengths_of_now(drive, lengths):
    assert lengths.shape == (drive.test.stop, 80)
    readout = fit_readout(lengths, drive)
    assert readout.weights_.shape == (80, 3)
    weights = np.linalg.lstsq(
        lengths[drive.training], drive.targets[drive.training], rcond=1e4 * 2.0**-52
    )[0]
    scores, _ = score_features(lengths, drive)
    direct = np.square(lengths[drive.test] @ weights - drive.targets[drive.test]).mean(axis=0)
    np.testing.assert_allclose(list(scores["test"].values()), direct, rtol=1e-3)


def test_arms_are_recorded_together_as_alone():
    drives = [TrialInput.make(kind, 0, trial) for kind in ("sines", "iid") for trial in range(2)]
    assert len({drive.initial for drive in drives}) == 2
    bodies = [HEAVY.replace(area_scale=5.0 + index) for index in range(4)]
    # The third leaves its domain.
    amplitudes = [60.0, 45.0, 200.0, 20.0]
    together = record_many([Arm(body) for body in bodies], drives, amplitudes)
    for index, recording in enumerate(together):
        (alone,) = record_many([Arm(bodies[index])], [drives[index]], [amplitudes[index]])
        if index == 2:
            assert isinstance(recording, DomainError)
            assert str(recording) == str(alone)
            assert (recording.step, recording.time) == (alone.step, alone.time)
        else:
            np.testing.assert_array_equal(recording, alone)
    finer = Arm(ArmParameters(timestep=0.0005))
    with pytest.raises(ValueError, match="timestep = 0.0005"):
        record_many([Arm(), Arm(), finer], drives[:3], amplitudes[:3])


@pytest.mark.parametrize(
    ("function", "more", "processes"),
    [
        (score_arm, {"sensor_noise": [1e-5]}, (1, 2)),
        (compare_methods, {"sensor_noise": [1e-5]}, (1,)),
        (leave_out_compartments, {}, (1,)),
    ],
)
def test_trials_together_are_the_trials_alone(tmp_path, function, more, processes):
    settings = [
        {"kind": kind, "amplitude": amplitude, "seed": 0, "trial": trial, **more}
        for kind, amplitude, trial in (
            ("sines", 60.0, 0),
            ("sines", 200.0, 0),
            ("iid", 30.0, 1),
            ("sines", 30.0, 2),
        )
    ]
    alone = run_trials(function, HEAVY, settings, folder=tmp_path / "alone")
    assert [each["failure"] is None for each in alone] == [True, False, True, True]
    for jobs in processes:
        folder = tmp_path / str(jobs)
        together = run_trials(
            function, HEAVY, settings, folder=folder, record=record_trials, jobs=jobs
        )
        assert together == alone


def test_table2(octoarm, tmp_path):
    run = octoarm("reproduce", "table2", "--trials", 2, "--jobs", 1, "--out", tmp_path)
    assert run.exit_code == 0, run.output
    assert "linear regressor" in run.stdout
    assert "table2.json" in run.stdout
    content = read_result(tmp_path, "table2")
    assert content["range_deg"] == 60.0
    assert content["trials"] == 2
    assert content["failures"] == []
    assert 0 < content["state_rank"] <= 80
    assert content["seed"] == 0
    for table in (content, content["iid"]):
        assert set(table["tasks"]) == set(TASKS)
        for task in TASKS:
            entry = table["tasks"][task]
            for method in METHODS:
                summary = entry[method]
                assert summary["mean"] > 0
                assert summary["sd"] >= 0
                assert summary["interval"][0] <= summary["mean"] <= summary["interval"][1]
                assert summary["training_mean"] > 0
            assert 0 <= entry["p_value"] <= 1
    for task in TASKS:
        entry = content["tasks"][task]
        assert entry["paper"] == {method: PAPER[task][method][0] for method in PAPER[task]}
        assert entry["ratio_to_paper"]["arm"] == pytest.approx(
            entry["arm"]["mean"] / entry["paper"]["arm"]
        )
        assert entry["arm"]["mean"] < entry["linear_regressor"]["mean"]
        quiet = content["sensor_noise"][0]
        assert quiet["sd_metres"] == 1e-8
        # A hundredth of a micrometre costs something already, and never most of it.
        assert 1 < quiet[task]["mean"] / entry["arm"]["mean"] < 5
    loud = content["sensor_noise"][-1]["second_order"]["mean"]
    assert loud > 2 * content["tasks"]["second_order"]["arm"]["mean"]
    # At half the range the default body survives the random input too.
    assert content["iid"]["range_deg"] == 30.0
    assert content["iid"]["failures"] == []


def test_a_trial_that_fails_is_reported(octoarm, tmp_path):
    options = ("--trials", 1, "--jobs", 1, "--amplitude", 200, "--out", tmp_path)
    # Undamped springs drive the arm out of its domain at any amplitude: no experiment, not even at
    # an amplitude of its own, has to let go of an arm for its 1,000,000 steps.
    body = tmp_path / "body.json"
    HEAVY.replace(longitudinal_damping=0.0, transverse_damping=0.0).to_json(body)
    run = octoarm("reproduce", "all", *options, "--arm", body)
    assert run.exit_code == 0, run.output
    assert all((tmp_path / f"{name}.json").exists() for name in EXPERIMENTS)
    assert "Trial 0 failed" in run.stdout
    content = read_result(tmp_path, "table2")
    (failure,) = content["failures"]
    assert failure["trial"] == 0
    assert "left its domain" in failure["message"]
    assert failure["time"] > 0
    assert content["state_rank"] is None
    assert content["tasks"]["volterra"]["arm"]["mean"] is None
    assert content["tasks"]["volterra"]["p_value"] is None
    assert content["tasks"]["volterra"]["linear_regressor"]["mean"] > 0
    assert read_result(tmp_path, "figure4")["failure"]["time"] > 0
    content = read_result(tmp_path, "figure5a")
    for series in (content, *content["sensor_noise"].values()):
        (point,) = series["points"]
        assert len(point["failures"]) == 1
        assert point["tasks"]["volterra"]["median"] is None
    for name in ("figure5b", "figure5c"):
        content = read_result(tmp_path, name)
        assert len(content["failures"]) == 1
        assert content["tasks"]["volterra"]["highest"] is None


def test_figure4(octoarm, tmp_path, drive, lengths):
    run = octoarm("reproduce", "figure4", "--out", tmp_path)
    assert run.exit_code == 0, run.output
    content = read_result(tmp_path, "figure4")
    assert content["failure"] is None
    rows = len(content["time_seconds"])
    assert len(content["input"]) == rows
    assert np.shape(content["spring_lengths_metres"]) == (80, rows)
    begin = drive.test.start
    np.testing.assert_allclose(
        content["spring_lengths_metres"][5], lengths[begin::5, 5][:rows], rtol=1e-6
    )
    for task in TASKS:
        entry = content["tasks"][task]
        shown = np.square(np.subtract(entry["arm"], entry["target"])).mean()
        # Three of the five seconds that the error is taken over.
        assert 0.2 < shown / entry["mse"]["arm"] < 5 / 3
        assert entry["mse"]["arm"] < entry["mse"]["linear_regressor"]


def test_figure5a_at_one_range(octoarm, tmp_path):
    options = ("--trials", 2, "--amplitude", 30, "--out", tmp_path)
    run = octoarm("reproduce", "figure5a", *options, "--jobs", 1)
    assert run.exit_code == 0, run.output
    content = read_result(tmp_path, "figure5a")
    assert content["ranges_deg"] == [30.0]
    assert content["confirmed"] is None
    assert set(content["paper"]) == set(
        check_features(RANGES, {task: [1.0] * len(RANGES) for task in TASKS})
    )
    assert list(content["sensor_noise"]) == ["1e-05", "0.0001"]
    expected = [
        score_arm(
            ArmParameters(),
            kind="sines",
            amplitude=30.0,
            seed=0,
            trial=trial,
            sensor_noise=SENSOR_NOISE,
        )
        for trial in range(2)
    ]
    series = {"arm": content["points"]}
    for index, (level, noisy) in enumerate(content["sensor_noise"].items()):
        assert noisy["half_width_metres"] == float(level)
        assert noisy["confirmed"] is None
        series[index] = noisy["points"]
    medians = []
    for key, (point,) in series.items():
        assert point["range_deg"] == 30.0
        assert point["failures"] == []
        for task in TASKS:
            summary = point["tasks"][task]
            errors = [
                (trial["arm"] if key == "arm" else trial["sensor_noise"][key])["test"][task]
                for trial in expected
            ]
            assert summary["mean"] == pytest.approx(np.mean(errors), rel=1e-9)
            assert summary["lower_quartile"] <= summary["median"] <= summary["upper_quartile"]
        medians.append([point["tasks"][task]["median"] for task in TASKS])
    assert (np.diff(medians, axis=0) > 0).all()

    run = octoarm("reproduce", "figure5a", *options, "--jobs", 2, "--fresh")
    assert run.exit_code == 0, run.output
    again = read_result(tmp_path, "figure5a")
    for key in ("points", "sensor_noise"):
        assert again[key] == content[key]


def test_figure5a_judges_the_papers_observations_at_each_noise(octoarm, tmp_path, monkeypatch):
    monkeypatch.setattr(figure5a, "RANGES", (15.0, 55.0))
    run = octoarm(
        "reproduce", "figure5a", "--trials", 1, "--jobs", 1, "--seed", 1, "--out", tmp_path
    )
    assert run.exit_code == 0, run.output
    content = read_result(tmp_path, "figure5a")
    series = [content, *content["sensor_noise"].values()]
    for each in series:
        medians = {
            task: [point["tasks"][task]["median"] for point in each["points"]] for task in TASKS
        }
        assert each["confirmed"] == check_features((15.0, 55.0), medians)
    printed = figure5a.tables(content)[1]
    assert printed.columns == ("", "without noise", "±0.01 mm", "±0.1 mm")
    for row, (name, text) in zip(printed.rows, content["paper"].items(), strict=True):
        answers = ["yes" if each["confirmed"][name] else "no" for each in series]
        assert list(row) == [text, *answers]
        assert text[:20] in run.stdout
    assert "±0.01 mm" in run.stdout


def test_noise_on_the_lengths_is_there_in_training_and_test(drive, lengths):
    levels = (0.0, 1e-5, 1e-4)
    result = score_arm(
        ArmParameters(), kind="sines", amplitude=RANGE, seed=0, trial=0, sensor_noise=levels
    )
    (stream,) = np.random.default_rng([0, 0]).spawn(1)
    for level, scores in zip(levels, result["sensor_noise"], strict=True):
        seen = lengths + stream.uniform(-level, level, lengths.shape)
        readout = Readout().fit(seen[drive.training], drive.targets[drive.training])
        errors = np.square(readout.predict(seen[drive.test]) - drive.targets[drive.test])
        np.testing.assert_allclose(list(scores["test"].values()), errors.mean(axis=0), rtol=1e-9)
    assert result["sensor_noise"][0] == result["arm"]


def make_errors(**changes):
    """Errors at each R that show all that the paper reports, with some of them changed."""
    ranges = np.array(RANGES)
    errors = {
        "second_order": 1 / ranges + 0.02 * np.exp(-((ranges - 45) ** 2) / 50),
        "tenth_order": 1 / ranges,
        "volterra": 1 + ((ranges - 55) / 40) ** 2,
    }
    return {task: list(values) for task, values in (errors | changes).items()}


def test_the_papers_features_are_found_where_they_are():
    assert all(check_features(RANGES, make_errors()).values())


@pytest.mark.parametrize(
    ("changes", "lost"),
    [
        ({"second_order": 1 / np.array(RANGES)}, {"second_order_local_maximum_near_45"}),
        (
            {"tenth_order": np.array(RANGES)},
            {"tenth_order_monotone", "highest_at_smallest_range"},
        ),
        (
            {"volterra": 1 + ((np.array(RANGES) - 70) / 40) ** 2},
            {"volterra_minimum_near_55"},
        ),
        ({task: [None, *range(len(RANGES) - 1)] for task in TASKS}, set(PAPER_FEATURES)),
        ({task: [None] * len(RANGES) for task in TASKS}, set(PAPER_FEATURES)),
    ],
)
def test_the_papers_features_are_not_found_where_they_are_not(changes, lost):
    features = check_features(RANGES, make_errors(**changes))
    assert {name for name, found in features.items() if not found} == lost


def test_figures_5b_and_5c(octoarm, tmp_path):
    for name, quantity in (
        ("figure5b", "contribution_ratio"),
        ("figure5c", "performance_ratio"),
    ):
        run = octoarm("reproduce", name, "--trials", 2, "--jobs", 1, "--out", tmp_path)
        assert run.exit_code == 0, run.output
        content = read_result(tmp_path, name)
        assert content["compartments"] == list(range(1, 21))
        for task in TASKS:
            ratios = content["tasks"][task][quantity]
            assert len(ratios["mean"]) == len(ratios["sd"]) == 20
            assert min(ratios["mean"]) > 0
            highest = content["tasks"][task]["highest"]
            assert len(highest) == 3
            assert highest[0] == 1 + int(np.argmax(ratios["mean"]))
            if name == "figure5b":
                assert max(ratios["mean"]) <= 1.0


def test_compartments_are_left_out_as_a_direct_computation_does(drive, lengths):
    result = leave_out_compartments(ArmParameters(), kind="sines", amplitude=RANGE, seed=0, trial=0)
    full = fit_readout(lengths, drive)
    training, test = lengths[drive.training], lengths[drive.test]
    targets = drive.targets
    for compartment in (0, 9, 19):
        springs = range(4 * compartment, 4 * compartment + 4)
        kept = [spring for spring in range(80) if spring not in springs]
        weights = full.weights_.copy()
        weights[springs] = 0.0
        zeroed = np.square(test @ weights - targets[drive.test]).mean(axis=0)
        np.testing.assert_allclose(list(result["zeroed"][compartment].values()), zeroed, rtol=1e-6)
        retrained = Readout().fit(training[:, kept], targets[drive.training])
        errors = np.square(retrained.predict(test[:, kept]) - targets[drive.test]).mean(axis=0)
        np.testing.assert_allclose(
            list(result["retrained"][compartment].values()), errors, rtol=1e-3
        )


def test_statistics():
    values = [1.0, 2.0, 3.0, 4.0]
    summary = summarise(values)
    assert summary["mean"] == 2.5
    assert summary["sd"] == pytest.approx(np.sqrt(5 / 3))
    low, high = bootstrap_interval(values)
    # Of the 256 equally likely means of four draws, the 2.5 and 97.5 % points are 1.5 and 3.5.
    assert (low, high) == (1.5, 3.5)
    assert summarise([3.0]) == {"mean": 3.0, "sd": None, "interval": None}
    assert summarise([]) == {"mean": None, "sd": None, "interval": None}
    # Welch (1938) by hand: t = -4 / sqrt(5/12 + 5/12), 6 degrees of freedom.
    assert welch_p_value(values, [5.0, 6.0, 7.0, 8.0]) == pytest.approx(0.00466, rel=1e-2)
    assert welch_p_value([1.0], values) is None
    assert welch_p_value([1.0, 1.0], [2.0, 2.0]) is None


def test_bad_requests_are_explained(octoarm, tmp_path):
    run = octoarm("reproduce", "figure6", "--out", tmp_path)
    assert run.exit_code == 2
    assert "no experiment 'figure6'" in run.stderr
    assert "table2, figure4, figure5a" in run.stderr

    run = octoarm("reproduce", "figure4", "--trials", 0, "--out", tmp_path)
    assert run.exit_code == 2
    assert "0 is not between 1 and" in run.stderr

    body = tmp_path / "body.json"
    ArmParameters().replace(timestep=0.0005).to_json(body)
    run = octoarm("reproduce", "figure4", "--arm", body, "--out", tmp_path)
    assert run.exit_code == 2
    assert "timestep = 0.0005" in run.stderr

    ArmParameters().replace(compartments=1).to_json(body)
    run = octoarm("reproduce", "figure5c", "--arm", body, "--out", tmp_path)
    assert run.exit_code == 2
    assert "compartments = 1" in run.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["body.json"]


def test_help_explains_every_experiment(octoarm):
    run = octoarm("reproduce", "--help")
    assert run.exit_code == 0
    for name, entry in EXPERIMENTS.items():
        assert any(name in line and entry.help in line for line in run.stdout.splitlines())
