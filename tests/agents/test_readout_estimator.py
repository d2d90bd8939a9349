"""The readout as a scikit-learn regressor: its three fits, bias, penalty, refusals."""

import numpy as np
import pytest
from octoarm_agents.reservoir import Readout
from sklearn.model_selection import GridSearchCV, TimeSeriesSplit
from sklearn.utils.estimator_checks import parametrize_with_checks

from octoarm_env import LIMIT_CYCLES, Arm


def recording(rows=500, springs=8, outputs=2, seed=1):
    """Lengths like those of an arm, and targets that are not quite linear in them."""
    random = np.random.default_rng(seed)
    lengths = 0.02 + 1e-3 * random.standard_normal((rows, springs))
    targets = 300 * lengths[:, :outputs] + np.sin(500 * lengths[:, -outputs:])
    return lengths, targets


@parametrize_with_checks(
    [
        Readout(),
        Readout(bias=True),
        Readout("ridge", ridge=1e-3),
        Readout("noise", noise=1e-2),
        Readout("noise", noise=1e-2, bias=True),
    ]
)
def test_it_is_a_scikit_learn_regressor(estimator, check):
    check(estimator)


def test_it_is_tuned_as_any_regressor():
    lengths, targets = recording()
    search = GridSearchCV(Readout("ridge"), {"ridge": [1e-9, 1e3]}, cv=TimeSeriesSplit(3))
    assert search.fit(lengths, targets).best_params_ == {"ridge": 1e-9}


def test_the_method_is_searched_together_with_what_only_some_methods_use():
    lengths, targets = recording()
    grid = {
        "method": ["pinv", "ridge", "noise"],
        "ridge": [0.0, 1e3],
        "noise": [0.0, 1e-1],
    }
    search = GridSearchCV(Readout(), grid, cv=TimeSeriesSplit(3), error_score="raise")
    found = search.fit(lengths, targets).cv_results_
    scores = {method: set() for method in grid["method"]}
    for parameters, score in zip(found["params"], found["mean_test_score"], strict=True):
        assert np.isfinite(score)
        scores[parameters["method"]].add(round(score, 12))
    # Noise of no width is the pseudo-inverse.
    assert {method: len(found) for method, found in scores.items()} == {
        "pinv": 1,
        "ridge": 2,
        "noise": 2,
    }


@pytest.mark.parametrize(
    ("method", "unused"),
    [
        ("pinv", {"ridge": 1e3, "noise": 1e-1}),
        ("ridge", {"noise": 1e-1}),
        ("noise", {"ridge": 1e3}),
    ],
)
def test_what_the_method_does_not_use_is_ignored(method, unused):
    lengths, targets = recording()
    used = {"ridge": {"ridge": 1e-3}, "noise": {"noise": 1e-3}}.get(method, {})
    np.testing.assert_array_equal(
        Readout(method, **used, **unused).fit(lengths, targets).weights_,
        Readout(method, **used).fit(lengths, targets).weights_,
    )


class TestPseudoInverse:
    def test_it_finds_the_weights_of_a_linear_map(self):
        lengths, _ = recording()
        weights = 100 * np.random.default_rng(2).standard_normal((8, 2))
        readout = Readout().fit(lengths, lengths @ weights)
        np.testing.assert_allclose(readout.weights_, weights, rtol=1e-9)
        np.testing.assert_allclose(readout.predict(lengths), lengths @ weights, rtol=1e-12)
        assert readout.training_error_ < 1e-10
        assert readout.rank_ == 8

    def test_it_is_that_of_numpy(self):
        lengths, targets = recording()
        readout = Readout().fit(lengths, targets)
        # Both are off by the condition number, 2e2, times eps, at weights of a few hundred.
        np.testing.assert_allclose(readout.weights_, np.linalg.pinv(lengths) @ targets, atol=1e-9)
        np.testing.assert_allclose(
            readout.singular_values_, np.linalg.svd(lengths, compute_uv=False), rtol=1e-12
        )
        errors = np.linalg.norm(targets - readout.predict(lengths), axis=1)
        assert readout.training_error_ == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-12)

    def test_directions_without_signal_get_no_weight(self):
        lengths = np.random.default_rng(3).standard_normal((100, 4))
        lengths = np.hstack((lengths, lengths[:, :1]))
        readout = Readout().fit(lengths, lengths[:, :1])
        np.testing.assert_allclose(readout.weights_[:, 0], [0.5, 0, 0, 0, 0.5], atol=1e-12)
        assert readout.rank_ == 4

    def test_fewer_rows_than_weights_give_the_smallest_weights(self):
        lengths, targets = recording(rows=3)
        readout = Readout().fit(lengths, targets)
        np.testing.assert_allclose(readout.weights_, np.linalg.pinv(lengths) @ targets, rtol=1e-8)
        assert readout.rank_ == 3

    @pytest.mark.parametrize(("tolerance", "rank"), [(None, 4), (1e-13, 4), (1e-9, 3), (1e-4, 2)])
    def test_the_tolerance_decides_what_is_signal(self, tolerance, rank):
        random = np.random.default_rng(4)
        left = np.linalg.qr(random.standard_normal((200, 4)))[0]
        right = np.linalg.qr(random.standard_normal((4, 4)))[0]
        # Squares of the two smallest are below eps: SᵀS would not know them.
        singular = np.array([1.0, 1e-3, 1e-8, 1e-10])
        lengths = left * singular @ right.T
        readout = Readout(tolerance=tolerance).fit(lengths, left.sum(axis=1))
        expected = right[:, :rank] @ (1 / singular[:rank])
        assert readout.rank_ == rank
        # The condition number, 1e10, times eps.
        np.testing.assert_allclose(
            readout.coef_, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max()
        )


class TestRidge:
    def test_it_solves_the_normal_equations(self):
        lengths, targets = recording()
        weights = np.linalg.solve(lengths.T @ lengths + 0.01 * np.eye(8), lengths.T @ targets)
        readout = Readout("ridge", ridge=0.01).fit(lengths, targets)
        np.testing.assert_allclose(readout.weights_, weights, rtol=1e-9)

    def test_without_penalty_it_is_the_pseudo_inverse(self):
        lengths, targets = recording()
        lengths = np.hstack((lengths, lengths))
        np.testing.assert_array_equal(
            Readout("ridge").fit(lengths, targets).weights_,
            Readout().fit(lengths, targets).weights_,
        )


class TestNoise:
    def test_it_is_that_of_many_noisy_rows(self):
        lengths, targets = recording(rows=400, springs=6)
        noise, copies = 1e-3, 1000
        many = np.tile(lengths, (copies, 1))
        many += np.random.default_rng(2).uniform(-noise, noise, many.shape)
        drawn = Readout().fit(many, np.tile(targets, (copies, 1))).weights_
        expected = Readout("noise", noise=noise).fit(lengths, targets).weights_
        # Drawn noise leaves an error of the order 1/sqrt(400,000 rows).
        assert np.abs(drawn - expected).max() < 0.01 * np.abs(expected).max()
        assert np.abs(expected - Readout().fit(lengths, targets).weights_).max() > 50

    def test_the_training_error_is_without_it(self):
        lengths, targets = recording()
        readout = Readout("noise", noise=1e-3).fit(lengths, targets)
        errors = np.linalg.norm(targets - lengths @ readout.weights_, axis=1)
        assert readout.training_error_ == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-12)


class TestBias:
    def test_it_is_the_last_row_of_the_weights(self):
        lengths, _ = recording()
        weights = 100 * np.random.default_rng(2).standard_normal((8, 2))
        readout = Readout(bias=True).fit(lengths, lengths @ weights + [3.0, -4.0])
        np.testing.assert_allclose(readout.weights_, [*weights, [3.0, -4.0]], rtol=1e-9)
        np.testing.assert_array_equal(readout.coef_, readout.weights_[:8].T)
        np.testing.assert_array_equal(readout.intercept_, readout.weights_[8])

    @pytest.mark.parametrize(
        ("readout", "penalty"),
        [
            (Readout("ridge", ridge=1e12, bias=True), None),
            (Readout("noise", noise=1e6, bias=True), None),
            (Readout(bias=True), 1e9 * np.eye(8)),
        ],
    )
    def test_it_is_never_penalised(self, readout, penalty):
        lengths, targets = recording()
        readout.fit(lengths, targets, penalty)
        np.testing.assert_allclose(readout.weights_[:8], 0, atol=1e-8)
        np.testing.assert_allclose(readout.intercept_, targets.mean(axis=0), rtol=1e-9)

    def test_ridge_acts_on_what_the_means_leave(self):
        lengths, targets = recording()
        readout = Readout("ridge", ridge=1e-4, bias=True).fit(lengths, targets)
        means = lengths.mean(axis=0), targets.mean(axis=0)
        centred = Readout("ridge", ridge=1e-4).fit(lengths - means[0], targets - means[1])
        np.testing.assert_allclose(readout.weights_[:8], centred.weights_, rtol=1e-8)
        np.testing.assert_allclose(
            readout.intercept_, means[1] - means[0] @ centred.weights_, rtol=1e-8
        )

    def test_lengths_that_do_not_vary_get_no_weight(self):
        lengths = np.tile(np.linspace(0.01, 0.03, 8), (300, 1))
        _, targets = recording(rows=300)
        readout = Readout(bias=True).fit(lengths, targets)
        assert readout.rank_ == 0
        np.testing.assert_array_equal(readout.weights_[:8], 0)
        np.testing.assert_allclose(readout.intercept_, targets.mean(axis=0), rtol=1e-12)


class TestPenalty:
    @pytest.mark.parametrize(
        ("readout", "ridge"),
        [(Readout(), 0.0), (Readout("ridge", ridge=0.01), 0.01)],
        ids=["pinv", "ridge"],
    )
    def test_it_adds_rows_with_target_zero(self, readout, ridge):
        lengths, targets = recording()
        penalty = np.random.default_rng(6).standard_normal((3, 8))
        rows = np.vstack((lengths, penalty, np.sqrt(ridge) * np.eye(8)))
        expected = np.linalg.lstsq(rows, np.vstack((targets, np.zeros((11, 2)))))[0]
        readout.fit(lengths, targets, penalty)
        np.testing.assert_allclose(readout.weights_, expected, rtol=1e-8)

    def test_the_readout_does_not_answer_to_strong_deviations(self):
        lengths, targets = recording()
        penalty = 1e6 * np.random.default_rng(6).standard_normal((3, 8))
        free, bound = Readout().fit(lengths, targets), Readout().fit(lengths, targets, penalty)
        assert np.abs(penalty @ free.weights_).max() > 1e6
        assert np.abs(penalty @ bound.weights_).max() < 1.0
        assert bound.training_error_ > free.training_error_


@pytest.mark.parametrize("bias", [False, True])
def test_one_dimensional_targets_are_answered_in_kind(bias):
    lengths, targets = recording()
    single = Readout(bias=bias).fit(lengths, targets[:, 0])
    double = Readout(bias=bias).fit(lengths, targets)
    assert single.weights_.shape == (8 + bias, 1)
    assert single.coef_.shape == (8,)
    assert isinstance(single.intercept_, float)
    assert double.coef_.shape == (2, 8)
    assert double.intercept_.shape == (2,)
    np.testing.assert_allclose(single.predict(lengths), double.predict(lengths)[:, 0], rtol=1e-9)
    np.testing.assert_allclose(lengths @ single.coef_ + single.intercept_, single.predict(lengths))


@pytest.mark.parametrize("bias", [False, True])
def test_the_weights_are_what_the_closed_loop_takes(bias):
    arm = Arm()
    angles = LIMIT_CYCLES["quadratic"].signal(2_000, 10.0)
    readout = Readout("noise", noise=1e-4, bias=bias).fit(arm.run(angles), angles)
    arm.reset()
    rest = arm.lengths
    outputs, moved = arm.run_closed_loop(readout.weights_, 3)
    answers = readout.predict(np.vstack((rest, moved[:2])))
    np.testing.assert_allclose(outputs, answers, atol=1e-9 * np.abs(readout.weights_).max())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"method": "lasso"}, "method = 'lasso'.*pinv.*ridge.*noise"),
        ({"method": "noise", "noise": -1.0}, "noise = -1.0.*not negative"),
        ({"method": "noise", "noise": np.nan}, "noise = nan.*finite"),
        ({"method": "noise", "noise": "0.1"}, "noise = '0.1'"),
        ({"method": "ridge", "ridge": -1.0}, "ridge = -1.0.*not negative"),
        ({"method": "ridge", "ridge": np.inf}, "ridge = inf.*finite"),
        ({"tolerance": 1.0}, r"tolerance = 1.0.*\[0, 1\)"),
        ({"tolerance": np.nan}, "tolerance = nan"),
        ({"method": "pinv", "ridge": -1.0}, "ridge = -1.0.*not negative"),
    ],
)
def test_a_bad_parameter_is_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        Readout(**arguments).fit(*recording(rows=50))


@pytest.mark.parametrize(
    ("rows", "target_rows", "penalty", "message"),
    [
        (50, 49, None, r"\[50, 49\]"),
        (50, 50, np.ones((2, 7)), r"penalty has shape \(2, 7\).*\(K, 8\)"),
        (50, 50, np.ones(8), "2D array"),
        (50, 50, np.full((1, 8), np.nan), "penalty contains NaN"),
    ],
)
def test_arrays_that_do_not_fit_together_are_refused(rows, target_rows, penalty, message):
    with pytest.raises(ValueError, match=message):
        Readout().fit(np.ones((rows, 8)), np.ones((target_rows, 2)), penalty)


def test_the_wrong_number_of_springs_is_named():
    readout = Readout().fit(*recording())
    with pytest.raises(ValueError, match="7 features.*8 features"):
        readout.predict(np.ones((3, 7)))
