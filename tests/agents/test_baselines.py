"""The baselines of Task 1: known features, known answers, the same rows as the arm."""

import numpy as np
import pytest
from octoarm_agents.experiments.emulation.esn_search import rank_settings
from octoarm_agents.experiments.emulation.protocol import (
    TASKS,
    TrialInput,
    fit_readout,
    score_features,
)
from octoarm_agents.reservoir.baselines import (
    BASELINES,
    ESN_SETTINGS,
    delay_features,
    delayed_polynomial,
    echo_state_network,
    powers,
)


@pytest.fixture(scope="module")
def drive():
    return TrialInput.make("sines", 5, 0)


@pytest.fixture
def random():
    return np.random.default_rng(11)


@pytest.mark.parametrize(
    ("name", "columns"),
    [
        ("linear_regressor", 2),
        ("mean_predictor", 1),
        ("cubic", 4),
        ("delay2", 78),
        ("delay3", 84),
        ("esn80", 81),
    ],
)
def test_features_have_a_row_a_step_and_look_back_only(name, columns):
    signal = np.random.default_rng(0).uniform(-0.2, 0.2, 600)
    changed = signal.copy()
    changed[500:] *= -1
    first, second = (BASELINES[name](each, np.random.default_rng(1)) for each in (signal, changed))
    assert first.shape == (600, columns)
    np.testing.assert_array_equal(first[:, 0], 1.0)
    np.testing.assert_array_equal(first[:500], second[:500])
    assert np.abs(first).max() <= 1.0


def test_delays_are_those_asked_for():
    signal = np.arange(1.0, 6.0)
    features = delay_features(signal, (0, 2, 9))
    np.testing.assert_allclose(features[:, 0], signal / 0.2)
    np.testing.assert_allclose(features[:, 1], np.array([0, 0, 1, 2, 3]) / 0.2)
    np.testing.assert_array_equal(features[:, 2], 0.0)
    with pytest.raises(ValueError, match="-1"):
        delay_features(signal, (0, -1))


def test_the_linear_regressor_is_a_line_through_the_training_rows(drive):
    readout = fit_readout(powers(drive.signal, 1), drive)
    outputs = readout.predict(powers(drive.signal, 1))
    for column in range(len(TASKS)):
        slope, offset = np.polyfit(
            drive.signal[drive.training], drive.targets[drive.training, column], 1
        )
        np.testing.assert_allclose(
            outputs[:, column], slope * drive.signal + offset, rtol=0, atol=1e-12
        )


def test_the_mean_predictor_is_the_mean_of_the_training_rows(drive, random):
    features = BASELINES["mean_predictor"](drive.signal, random)
    mean = drive.targets[drive.training].mean(axis=0)
    np.testing.assert_allclose(fit_readout(features, drive).predict(features)[0], mean, rtol=1e-12)
    scores, _ = score_features(features, drive)
    expected = np.square(drive.targets[drive.test] - mean).mean(axis=0)
    np.testing.assert_allclose(list(scores["test"].values()), expected, rtol=1e-9)


def test_a_cubic_nearly_makes_the_second_order_task(drive):
    # 1.8e-8 for this input, 55 times below the linear regressor: the task needs hardly any memory.
    error = score_features(powers(drive.signal, 3), drive)[0]["test"]["second_order"]
    assert 1.5e-8 < error < 2.2e-8


def test_delayed_squares_make_the_volterra_task_exactly(drive):
    # The input is four sinusoids, so eleven delays hold all of its past, and their products every
    # quadratic form of it.
    error = score_features(delayed_polynomial(drive.signal, 2), drive)[0]["test"]["volterra"]
    assert error < 1e-24


def test_delayed_squares_do_not_make_it_exactly_when_the_input_is_not_periodic():
    drive = TrialInput.make("iid", 5, 0)
    scores, readout = score_features(delayed_polynomial(drive.signal, 2), drive)
    assert readout.rank_ == 78
    assert scores["test"]["volterra"] > 1e-7


def test_the_network_forgets_and_is_the_same_from_the_same_generator():
    signal = np.random.default_rng(2).uniform(-0.2, 0.2, 1_500)
    other = signal.copy()
    other[:500] = 0.0
    first, again, later = (
        echo_state_network(each, np.random.default_rng(4)) for each in (signal, signal, other)
    )
    np.testing.assert_array_equal(first, again)
    assert np.abs(first[400] - later[400]).max() > 1e-3
    np.testing.assert_allclose(first[-1], later[-1], atol=1e-9)
    assert not np.array_equal(first, echo_state_network(signal, np.random.default_rng(5)))


def test_the_network_obeys_its_equation():
    # Without recurrence and leak each node is tanh of a scaled input and a bias.
    signal = np.linspace(-0.2, 0.2, 41)
    states = echo_state_network(
        signal, np.random.default_rng(4), leak=1.0, spectral_radius=0.0, input_scaling=0.7
    )[:, 1:]
    arguments = np.arctanh(states)
    bias, slope = arguments[20], (arguments[-1] - arguments[0]) / 2
    np.testing.assert_allclose(np.abs(bias), 0.5, rtol=1e-9)
    np.testing.assert_allclose(np.abs(slope), 0.7, rtol=1e-9)
    np.testing.assert_allclose(arguments, bias + np.outer(signal / 0.2, slope), atol=1e-9)


def test_the_network_uses_the_settings_that_the_search_ranks_first():
    grid = {name: (value,) for name, value in ESN_SETTINGS.items()}
    ranking = rank_settings({**grid, "leak": (1.0, ESN_SETTINGS["leak"])})
    assert [score for score, _ in ranking] == sorted(score for score, _ in ranking)
    assert ranking[0][1] == ESN_SETTINGS
