"""Memory and information processing capacity, where the answer is known."""

import numpy as np
import pytest
from numpy.polynomial import legendre
from octoarm_agents.analysis.capacity import StateBasis
from octoarm_agents.analysis.information_processing_capacity import (
    count_targets,
    information_processing_capacity,
)
from octoarm_agents.analysis.measures import MeasureSettings, measure
from octoarm_agents.analysis.memory_capacity import memory_capacity
from octoarm_agents.analysis.polynomials import describe_input, orthonormal_polynomials
from octoarm_agents.analysis.states import Recording

ROWS = 4000


@pytest.fixture
def random():
    return np.random.default_rng(0)


def delay_line(inputs, taps):
    return np.stack([np.roll(inputs, k) for k in taps], axis=1)


def test_a_delay_line_remembers_exactly_its_taps(random):
    inputs = random.uniform(-1, 1, ROWS)
    recording = Recording(delay_line(inputs, range(1, 11)), inputs)
    memory = memory_capacity(recording, 25, washout=20)
    # Exact but for false alarms: 15 empty delays at a significance of 1e-4.
    np.testing.assert_allclose(memory.capacities[0, 1:11], 1.0, atol=1e-12)
    assert memory.total == pytest.approx(10, abs=1e-9)
    assert memory.held_out_total == pytest.approx(10, abs=1e-9)
    assert memory.faded
    assert memory.capacities[0, 0] == 0

    processing = information_processing_capacity(recording, (25, 8, 4), washout=20)
    assert processing.linear == pytest.approx(10, abs=1e-9)
    assert processing.rank == 10
    assert processing.nonlinear < 0.02  # a false alarm is worth about its threshold, 0.006
    assert processing.total <= processing.rank + 0.02


def test_a_delay_line_that_is_longer_than_the_delays_is_reported(random):
    inputs = random.uniform(-1, 1, ROWS)
    recording = Recording(delay_line(inputs, range(1, 11)), inputs)
    settings = MeasureSettings(max_delay=5, delays=(5, 2))
    result = measure(recording, settings)
    assert not result.memory.faded
    assert "lower bound" in result.warnings[0]


def test_memoryless_legendre_polynomials_have_one_capacity_a_degree(random):
    inputs = random.uniform(-1, 1, ROWS)
    polynomials = legendre.legvander(inputs, 4)[:, 1:]
    mixed = polynomials @ random.standard_normal((4, 4))
    processing = information_processing_capacity(
        Recording(mixed, inputs), (6, 5, 4, 3), family="legendre"
    )
    # The samples' own range is 1e-3 short of [-1, 1].
    np.testing.assert_allclose(processing.by_degree, 1.0, atol=0.02)
    np.testing.assert_allclose(processing.by_degree_and_oldest_delay[:, 0], 1.0, atol=0.01)


def test_products_of_delayed_inputs_are_found_where_they_are(random):
    inputs = random.uniform(-1, 1, (ROWS, 2))
    first, second = inputs.T
    states = np.stack((np.roll(first, 2) * np.roll(second, 3), np.roll(second, 1) ** 3), axis=1)
    processing = information_processing_capacity(Recording(states, inputs), (5, 5, 3))
    expected = np.zeros((3, 6))
    expected[1, 3] = 1.0
    # x³ = 2/5 P3 + 3/5 P1; with the norms' squares 1/7 and 1/3 the shares are 4/25 and 21/25.
    expected[2, 1], expected[0, 1] = 0.16, 0.84
    np.testing.assert_allclose(processing.by_degree_and_oldest_delay, expected, atol=0.02)
    assert processing.targets_by_degree == (12, 78, 120)
    assert count_targets((5, 5, 3), inputs=2) == 210


@pytest.mark.parametrize("surrogates", [0, 10])
def test_noise_has_no_capacity(random, surrogates):
    states = random.standard_normal((ROWS, 50))
    inputs = random.uniform(-1, 1, ROWS)
    recording = Recording(states, inputs)
    memory = memory_capacity(recording, 50)
    assert memory.total == 0
    assert memory.held_out_total == 0
    # Chance alone: n / T a delay, with a standard deviation of a fifth of it.
    assert memory.uncorrected.mean() == pytest.approx(50 / ROWS, rel=0.1)
    processing = information_processing_capacity(recording, (40, 15, 8), surrogates=surrogates)
    assert sum(processing.targets_by_degree) == 342
    assert processing.total < 0.05
    # The sum of 342 chances, 4.3 without correction, with a standard deviation of 0.05.
    assert sum(processing.unselected_by_degree) == pytest.approx(0.0, abs=0.2)


def test_the_bias_is_right_where_the_states_depend_on_the_targets_input(random):
    # States that are large exactly where the targets are, yet uncorrelated with them.
    inputs = random.uniform(-1, 1, ROWS)
    tables = orthonormal_polynomials(inputs, 5, "legendre")
    signs = random.choice((-1.0, 1.0), (40, ROWS))
    states = (tables[5] ** 3 * signs).T
    targets = tables[5] * random.choice((-1.0, 1.0), (200, ROWS))
    found = StateBasis(states).capacities(targets)
    textbook = (found.uncorrected - 40 / ROWS) / (1 - 40 / ROWS)
    assert textbook.mean() > 0.01
    assert found.signed.mean() == pytest.approx(0.0, abs=0.001)
    significant = found.significant(StateBasis(states).threshold(1e-4))
    assert (significant > 0).sum() <= 1


def test_a_whole_reservoir_stays_below_its_rank(random):
    states, inputs = leaky_network(random, ROWS, 12)
    recording = Recording(states, inputs)
    result = measure(recording, MeasureSettings(max_delay=40, delays=(40, 12, 6, 4), washout=100))
    assert result.processing.rank == 12
    # A share belongs to functions of higher degree or delay.
    assert 0.85 * 12 < result.processing.total < 12
    assert result.memory.total + result.memory.capacities[0, 0] == pytest.approx(
        result.processing.linear
    )
    assert result.effective_rank < result.rank_at_tolerance <= 12
    assert result.memory.held_out_total == pytest.approx(result.memory.total, rel=0.05)


def leaky_network(random, rows, units):
    weights = random.standard_normal((units, units))
    weights *= 0.8 / np.abs(np.linalg.eigvals(weights)).max()
    into = random.standard_normal(units)
    inputs = random.uniform(-1, 1, rows)
    states = np.zeros((rows, units))
    for k in range(1, rows):
        states[k] = np.tanh(weights @ states[k - 1] + 0.4 * into * inputs[k])
    return states, inputs


def test_sensor_noise_costs_what_was_announced(random):
    states, inputs = leaky_network(random, 20_000, 8)
    noise = 0.02
    expected = memory_capacity(Recording(states, inputs), 12, 100, noise)
    noisy = states + random.uniform(-noise, noise, states.shape)
    measured = memory_capacity(Recording(noisy, inputs), 12, 100)
    clean = memory_capacity(Recording(states, inputs), 12, 100)
    assert measured.total < clean.total - 0.3
    assert expected.total == pytest.approx(measured.total, rel=0.02)


def test_memory_capacity_is_reservoirpys():
    pytest.importorskip("reservoirpy")
    from reservoirpy.nodes import Reservoir, Ridge
    from reservoirpy.observables import memory_capacity as theirs

    delays, rows, test, ridge = 20, 2000, 594, 1e-6
    series = np.random.default_rng(3).uniform(-0.8, 0.8, (rows + delays, 1))

    def reservoir():
        return Reservoir(30, sr=0.9, lr=1.0, seed=3)

    expected = theirs(
        reservoir() >> Ridge(ridge), delays, as_list=True, series=series, test_size=test
    )
    # Their rows begin at the first with all delays; their warm-up is as long as the delays.
    states = reservoir().run(series[delays:])
    samples = rows - delays
    split = samples - test
    recording = Recording(states, series[delays:])
    # Their ridge is on SᵀS; ours is the noise that adds as much, T ν²/3.
    noise = np.sqrt(3 * ridge / split)
    ours = memory_capacity(recording, delays, noise=noise, training_fraction=split / samples)
    assert ours.test_rows == (rows - test, rows)
    kept = ours.held_out[0, 1:] > 0
    assert 8 <= kept.sum() <= delays
    # Both solve the same equations; theirs through SᵀS, with a condition of about 1e8.
    np.testing.assert_allclose(ours.held_out[0, 1:][kept], expected[kept], rtol=1e-6)
    assert (expected[~kept] < ours.held_out_threshold).all()


@pytest.mark.parametrize(
    ("draw", "family"),
    [
        (lambda random: random.uniform(2, 5, ROWS), "legendre"),
        (lambda random: random.normal(3, 2, ROWS), "hermite"),
        (lambda random: random.exponential(1, ROWS), "empirical"),
        (lambda random: random.choice((-1.0, 1.0), ROWS), "empirical"),
    ],
)
def test_polynomials_follow_the_distribution(random, draw, family):
    values = draw(random)
    distribution = describe_input(values, 20)
    assert distribution.family == family
    assert distribution.independent
    polynomials = orthonormal_polynomials(values, 3, family)
    if distribution.different_values > 3:
        gram = polynomials @ polynomials.T / ROWS
        # Sampling error; the sixth moment of a normal variable has the largest.
        tolerance = {"legendre": 0.1, "hermite": 0.35, "empirical": 1e-10}[family]
        np.testing.assert_allclose(gram, np.eye(4), atol=tolerance)
    else:
        assert not polynomials[2:].any()


def test_a_binary_input_has_no_powers(random):
    inputs = random.choice((0.0, 1.0), ROWS)
    states = np.stack((inputs, inputs * np.roll(inputs, 1)), axis=1)
    processing = information_processing_capacity(Recording(states, inputs), (3, 3))
    # Delays 0 … 3: four inputs and the six products of two different ones.
    assert processing.targets_by_degree == (4, 6)
    assert processing.total == pytest.approx(2.0, abs=0.01)


def test_an_input_with_memory_of_its_own_is_reported(random):
    inputs = np.convolve(random.uniform(-1, 1, ROWS + 4), np.ones(5) / 5, "valid")
    recording = Recording(delay_line(inputs, (1, 2)), inputs)
    result = measure(recording, MeasureSettings(max_delay=10, delays=(10, 3)))
    assert not result.processing.inputs[0].independent
    assert "not independent in time" in result.warnings[0]


def test_thousands_of_functions(random):
    states = random.standard_normal((10_000, 80))
    inputs = random.uniform(-1, 1, 10_000)
    processing = information_processing_capacity(Recording(states, inputs), (60, 25, 15, 9, 4))
    assert sum(processing.targets_by_degree) > 2000


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"max_delay": 0}, "max_delay = 0: expected a whole number, at least 1"),
        ({"washout": -1}, "washout = -1: expected a whole number, at least 0"),
        ({"noise": -1.0}, "noise = -1.0: expected a number"),
        ({"significance": 0.0}, "significance = 0.0: expected a probability"),
        ({"training_fraction": 0.0}, "training_fraction = 0.0: expected 0.1 to 0.9"),
        ({"delays": ()}, r"delays = \[\]: expected one or more"),
        ({"surrogates": -1}, "surrogates = -1: expected"),
        ({"family": "fourier"}, "family = 'fourier': expected one of"),
        ({"max_delay": ROWS}, "are too few: needed are"),
    ],
)
def test_settings_out_of_range_are_refused(random, change, message):
    inputs = random.uniform(-1, 1, ROWS)
    recording = Recording(delay_line(inputs, (1, 2)), inputs)
    with pytest.raises(ValueError, match=message):
        measure(recording, MeasureSettings(**{"max_delay": 5, "delays": (5,)} | change))
