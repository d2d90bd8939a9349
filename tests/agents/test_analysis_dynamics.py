"""Lyapunov exponents of known systems, decay of distances, ranks of known matrices."""

import math

import numpy as np
import pytest
from octoarm_agents.analysis.echo_state import fit_decay
from octoarm_agents.analysis.lyapunov import largest_lyapunov_exponent
from octoarm_agents.analysis.rank import numerical_rank, participation_ratio, separation_ranks


def logistic(state, k):
    return 4 * state * (1 - state)


def henon(state, k):
    x, y = state
    return np.array([1 - 1.4 * x**2 + y, 0.3 * x])


def test_a_linear_map_has_the_logarithm_of_its_spectral_radius():
    random = np.random.default_rng(1)
    weights = random.standard_normal((5, 5))
    weights *= 0.7 / np.abs(np.linalg.eigvals(weights)).max()
    inputs = random.standard_normal((3000, 5))
    found = largest_lyapunov_exponent(
        lambda state, k: weights @ state + inputs[k], np.zeros(5), 2000, interval=0.05
    )
    # The growth of a complex pair swings within a turn; over 2000 steps that is 1e-3 of the whole.
    assert found.exponent_per_second == pytest.approx(math.log(0.7) / 0.05, rel=5e-3)
    assert len(found.blocks_per_second) == 10
    assert found.standard_error_per_second < 0.05


@pytest.mark.parametrize(
    ("step", "start", "expected"),
    # ln 2 exactly; the Hénon map's by Sprott (2003), "Chaos and Time-Series Analysis".
    [(logistic, [0.3], math.log(2)), (henon, [0.1, 0.1], 0.41922)],
)
def test_chaotic_maps_have_their_known_exponents(step, start, expected):
    found = largest_lyapunov_exponent(step, np.array(start), 20_000, size=1e-9)
    # Four standard errors, and they are small enough to say something.
    assert abs(found.exponent_per_second - expected) < 4 * found.standard_error_per_second
    assert found.standard_error_per_second < 0.01


def test_the_exponent_does_not_depend_on_the_size_of_the_difference():
    exponents = [
        largest_lyapunov_exponent(henon, np.zeros(2), 5000, size=size).exponent_per_second
        for size in (1e-6, 1e-8)
    ]
    assert exponents[0] == pytest.approx(exponents[1], abs=0.02)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"blocks": 1}, "blocks = 1: expected a whole number, at least 2"),
        ({"steps": 5}, "steps = 5: expected a whole number, at least 10"),
        ({"transient": -1}, "transient = -1: expected a whole number, at least 0"),
        ({"interval": 0.0}, "interval = 0.0, size = 1e-07: expected positive"),
        ({"step": lambda state, k: 0 * state}, "the trajectories met within step 1"),
    ],
)
def test_what_has_no_exponent_is_refused(options, message):
    arguments = {"step": henon, "state": np.zeros(2), "steps": 100} | options
    with pytest.raises(ValueError, match=message):
        largest_lyapunov_exponent(**arguments)


def test_the_decay_time_of_an_exponential_is_found():
    time = 0.05 * np.arange(400)
    echo = fit_decay(3.0 * np.exp(-time / 0.8), 0.05)
    assert echo.decay_time_seconds == pytest.approx(0.8, rel=1e-12)
    assert echo.verdict == "forgotten"
    # Below 1e-9 of the first distance rounding decides: 0.8 s times ln 1e9 is 16.6 s.
    assert echo.fitted_samples == 332
    floor = np.maximum(3.0 * np.exp(-time / 0.2), 1e-12)
    assert fit_decay(floor, 0.05).decay_time_seconds == pytest.approx(0.2, rel=1e-6)


def test_trajectories_that_stay_apart_are_not_forgotten():
    growing = fit_decay(np.exp(0.1 * np.arange(20)), 1.0)
    assert growing.decay_time_seconds is None
    assert growing.verdict == "kept"
    slow = fit_decay(np.exp(-0.1 * np.arange(20)), 1.0)
    assert slow.decay_time_seconds == pytest.approx(10.0)
    assert slow.verdict == "fading"
    assert fit_decay(np.exp(-0.01 * np.arange(20)), 1.0).verdict == "kept"
    assert fit_decay(np.array([1.0] + [0.0] * 12), 1.0).decay_time_seconds == 0.0
    with pytest.raises(ValueError, match="same state"):
        fit_decay(np.zeros(12), 1.0)


def test_ranks_of_known_matrices():
    assert participation_ratio(np.ones(7)) == pytest.approx(7)
    assert participation_ratio(np.array([1.0, 0.0, 0.0])) == pytest.approx(1)
    assert numerical_rank(np.array([1.0, 0.1, 0.01]), 0.05) == 2
    with pytest.raises(ValueError, match="tolerance = 1.0"):
        numerical_rank(np.ones(2), 1.0)

    random = np.random.default_rng(0)
    wide = random.standard_normal((60, 20)) + 5.0
    narrow = random.standard_normal((60, 4)) @ random.standard_normal((4, 20))
    ranks = separation_ranks(wide, narrow, 1e-6)
    assert (ranks.kernel_rank, ranks.generalisation_rank) == (20, 4)
    # Both are measured against the different streams.
    assert separation_ranks(wide, 1e-8 * narrow, 1e-6).generalisation_rank == 0
