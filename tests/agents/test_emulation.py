"""The systems that Task 1 emulates, against their formulas written out."""

import math

import numpy as np
import pytest
from octoarm_agents.reservoir.emulation import (
    SYSTEMS,
    emulation_targets,
    second_order,
    tenth_order,
    volterra,
)
from octoarm_agents.reservoir.inputs import product_of_sines


@pytest.fixture
def signal():
    return np.random.default_rng(3).uniform(-0.2, 0.2, 260)


def before(sequence, t):
    """What a sequence was at t: zero before it began."""
    return sequence[t] if t >= 0 else 0.0


def test_second_order_is_equation_19(signal):
    y = [0.0]
    for t in range(len(signal)):
        y.append(0.4 * y[t] + 0.4 * y[t] * before(y, t - 1) + 0.6 * signal[t] ** 3 + 0.1)
    np.testing.assert_allclose(second_order(signal), y[1:], rtol=1e-13)


def test_tenth_order_is_equations_20_and_21(signal):
    y = [0.0]
    for t in range(len(signal)):
        history = sum(before(y, t - i) for i in range(10))
        drive = 1.5 * before(signal, t - 9) * signal[t]
        y.append(0.3 * y[t] + 0.05 * y[t] * history + drive + 0.1)
    np.testing.assert_allclose(tenth_order(signal), y[1:], rtol=1e-13)


def test_volterra_is_equations_22_and_23_with_the_plus_that_is_printed(signal):
    outputs = volterra(signal)
    for t in (0, 1, 150, 259):
        total = 0.0
        for first in range(201):
            for second in range(201):
                kernel = math.exp(
                    (first * 0.001 - 0.1) ** 2 / (2 * 0.05**2)
                    + (second * 0.001 - 0.1) ** 2 / (2 * 0.05**2)
                )
                total += kernel * before(signal, t - first) * before(signal, t - second)
        # The literal sum cancels: 40,000 terms of up to 2 leave rounding of about 1e-12 before A.
        assert outputs[t] == pytest.approx(1e-4 * total, rel=1e-11, abs=1e-15)


def test_targets_are_all_systems_at_the_next_step(signal):
    targets = emulation_targets(signal)
    assert targets.shape == (260, 3)
    assert list(SYSTEMS) == ["second_order", "tenth_order", "volterra"]
    np.testing.assert_array_equal(targets[:, 1], tenth_order(signal))
    # The first input decides the first target.
    assert targets[0, 0] == 0.6 * signal[0] ** 3 + 0.1
    assert targets[0, 2] == pytest.approx(1e-4 * (math.exp(2) * signal[0]) ** 2)


def test_targets_at_a_time_do_not_depend_on_later_inputs():
    signal = product_of_sines(1_000)
    changed = signal.copy()
    changed[600:] = 0.1
    np.testing.assert_array_equal(emulation_targets(signal)[:600], emulation_targets(changed)[:600])


@pytest.mark.parametrize("system", SYSTEMS.values(), ids=list(SYSTEMS))
def test_bad_inputs_are_named(system):
    with pytest.raises(ValueError, match=r"\(T,\)"):
        system(np.zeros((3, 2)))
    with pytest.raises(ValueError, match=r"signal\[1\] = nan"):
        system(np.array([0.0, math.nan]))


def test_unbounded_growth_is_reported():
    with pytest.raises(ValueError, match="10th-order system grows without bound"):
        tenth_order(np.full(200, 3.0))
    with pytest.raises(ValueError, match="2nd-order system grows without bound"):
        second_order(np.full(200, 3.0))
