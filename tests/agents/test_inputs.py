"""The inputs of Task 1: Eqs. 16 and 17, and the one without repetition."""

import math

import numpy as np
import pytest
from octoarm_agents.reservoir.inputs import base_angles, product_of_sines, smooth_noise


@pytest.fixture
def random():
    return np.random.default_rng(7)


def test_the_input_is_equation_17():
    signal = product_of_sines(2_001)
    assert signal.shape == (2_001,)
    for t in (0, 1, 333, 2_000):
        expected = 0.2 * math.prod(
            math.sin(2 * math.pi * frequency * t * 0.001) for frequency in (2.11, 3.73, 4.33)
        )
        assert signal[t] == pytest.approx(expected, abs=1e-15)


def test_the_input_is_four_sinusoids():
    time = np.arange(20_000) * 0.001
    waves = {1.51: 1, 2.71: 1, 5.95: 1, 10.17: -1}
    expected = sum(sign * np.sin(2 * np.pi * f * time) for f, sign in waves.items()) / 20
    np.testing.assert_allclose(product_of_sines(20_000), expected, atol=1e-13)


def test_the_largest_angle_is_the_range():
    signal = product_of_sines(17_000)
    angles = base_angles(signal, 60.0)
    assert angles.shape == (17_000, 2)
    assert np.abs(angles).max() == pytest.approx(60.0, rel=1e-14)
    np.testing.assert_array_equal(angles[:, 0], angles[:, 1])
    np.testing.assert_allclose(angles[:, 0], 60.0 / np.abs(signal).max() * signal, rtol=1e-14)


def test_a_part_of_an_experiment_has_the_scale_of_the_whole():
    signal = product_of_sines(17_000)
    part = base_angles(signal[:300], 60.0, float(np.abs(signal).max()))
    np.testing.assert_array_equal(part, base_angles(signal, 60.0)[:300])


def test_noise_joins_independent_values_smoothly(random):
    signal = smooth_noise(50 * 4_000 + 1, random, hold=50)
    values = signal[::50]
    assert values[0] == 0.0
    assert np.abs(signal).max() <= 0.2
    # Uniform: variance 0.2² / 3; four standard errors of 4000 independent values.
    assert values.var() == pytest.approx(0.04 / 3, rel=4 * math.sqrt(0.8 / 4_000))
    for lag in (1, 2, 3):
        assert abs(np.corrcoef(values[lag:], values[:-lag])[0, 1]) < 4 / math.sqrt(4_000)
    # Half a cosine wave over the largest leap: rate π/2 · 0.4 / 50 a step, curvature π²/2 · 0.4 /
    # 50² a step.
    assert np.abs(np.diff(signal)).max() <= math.pi / 2 * 0.4 / 50
    assert np.abs(np.diff(signal, 2)).max() <= math.pi**2 / 2 * 0.4 / 50**2
    half = 0.5 * (values[:-1] + values[1:])
    np.testing.assert_allclose(signal[25::50], half, atol=1e-15)


def test_noise_is_the_same_from_the_same_generator():
    first, second, other = (
        smooth_noise(1_000, np.random.default_rng(seed), hold=20) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda random: product_of_sines(-1), "steps = -1"),
        (lambda random: smooth_noise(-1, random), "steps = -1"),
        (lambda random: smooth_noise(10, random, hold=0), "hold = 0"),
        (lambda random: base_angles(np.ones(3), -1.0), "amplitude = -1.0"),
        (lambda random: base_angles(np.ones(3), math.nan), "amplitude = nan"),
        (lambda random: base_angles(np.zeros(3), 1.0), "peak = 0.0"),
        (lambda random: base_angles(np.ones(3), 1.0, 0.5), "peak = 0.5"),
        (lambda random: base_angles(np.ones((3, 2)), 1.0), r"\(3, 2\)"),
    ],
)
def test_bad_arguments_are_named(random, call, message):
    with pytest.raises(ValueError, match=message):
        call(random)
