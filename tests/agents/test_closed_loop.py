"""The closed loop: what it does, what ends it, how it is scored."""

import json

import numpy as np
import pytest
from octoarm_agents.reservoir import Readout
from octoarm_agents.reservoir.closed_loop import (
    FORCED_STEPS,
    WINDOW_STEPS,
    ClosedLoop,
    recovery_steps,
    release,
    score_window,
)

from octoarm_env import LIMIT_CYCLES, Arm, ArmParameters, DomainError

# Told in full where loops depend on it, whatever the default body is.
BODY = ArmParameters.preset("inertial").replace(area_scale=5.0)
AMPLITUDE = 30.0
QUADRATIC, LISSAJOUS = LIMIT_CYCLES["quadratic"], LIMIT_CYCLES["lissajous"]


@pytest.fixture(scope="module")
def weights():
    """A readout of the quadratic cycle through the servo, taught as in the paper."""
    signal = QUADRATIC.signal(20_001, AMPLITUDE)
    lengths = Arm(BODY, "servo").run(signal[:-1])
    return Readout("noise", noise=2e-4).fit(lengths[4_000:], signal[4_001:]).weights_


@pytest.fixture
def arm():
    return release(BODY, "quadratic", AMPLITUDE, "servo")


@pytest.fixture(scope="module")
def outputs(weights):
    """The loop in one piece."""
    arm = release(BODY, "quadratic", AMPLITUDE, "servo")
    return arm.run_closed_loop(weights, 8_000)[0]


def test_release_forces_a_resting_arm(arm):
    other = Arm(BODY, "servo")
    other.run(QUADRATIC.signal(FORCED_STEPS, AMPLITUDE))
    assert arm.state == other.state
    assert arm.state.steps == FORCED_STEPS


def test_release_refuses_what_cannot_be_done():
    with pytest.raises(ValueError, match="target = 'circle': expected one of"):
        release(BODY, "circle", AMPLITUDE)
    with pytest.raises(ValueError, match="amplitude"):
        release(BODY, "quadratic", -1.0)
    with pytest.raises(DomainError):
        release(BODY, "van_der_pol", 300.0)


def test_the_body_holds_the_quadratic_cycle(arm, weights):
    loop = ClosedLoop(arm, weights, AMPLITUDE)
    loop.run(20_000)
    assert loop.failure is None
    turn = QUADRATIC.period / BODY.timestep
    scores = score_window(loop.outputs[-WINDOW_STEPS:], QUADRATIC.orbit(AMPLITUDE), turn)
    assert scores["held"] is True
    assert scores["mean_distance"] < scores["max_distance"] < 0.1
    assert scores["mean_distance"] < 0.03
    assert scores["period_ratio"] == pytest.approx(1.0, abs=0.005)


def test_the_loop_is_the_arms_own_whatever_the_pieces(arm, weights, outputs):
    seen = []
    loop = ClosedLoop(arm, weights, AMPLITUDE, advance=seen.append)
    assert loop.outputs.shape == (0, 2)
    first = loop.run(1_500)
    second, lengths = loop.record(2_300)
    np.testing.assert_array_equal(np.concatenate((first, second)), outputs[:3_800])
    np.testing.assert_array_equal(loop.outputs, outputs[:3_800])
    assert lengths.shape == (2_300, 80)
    np.testing.assert_allclose(lengths[:-1] @ weights, second[1:], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(lengths[-1], arm.lengths)
    assert sum(seen) == 3_800
    assert max(seen) <= 1_000


def test_a_perturbation_moves_the_base_and_not_the_output_of_its_own_step(arm, weights, outputs):
    noise = np.full((10, 2), 3.0)
    loop = ClosedLoop(arm, weights, AMPLITUDE)
    loop.run(100)
    disturbed = loop.run(10, noise)
    np.testing.assert_array_equal(disturbed[0], outputs[100])
    assert not np.array_equal(disturbed[1:], outputs[101:110])


def test_a_jump_ends_the_loop_at_its_step(arm, weights, outputs):
    # The limit just below the largest change of 3000 steps: two chunks pass, the third does not.
    changes = np.abs(np.diff(outputs[:3_000], axis=0)).max(axis=1)
    limit = np.nextafter(changes[2_100:].max(), 0.0)
    loop = ClosedLoop(arm, weights, AMPLITUDE, jump=limit)
    step = int(np.flatnonzero(changes > limit)[0]) + 1
    loop.run(3_000)
    assert loop.failure["reason"] == "jump"
    assert loop.failure["step"] == step == len(loop.outputs)
    assert loop.failure["value"] == changes[step - 1]
    assert loop.failure["time"] == pytest.approx(BODY.timestep * (FORCED_STEPS + step))
    np.testing.assert_array_equal(loop.outputs, outputs[:step])


def test_a_jump_from_one_piece_to_the_next_is_seen(arm, weights, outputs):
    changes = np.abs(np.diff(outputs[:1_000], axis=0)).max(axis=1)
    step = int(changes.argmax()) + 1
    loop = ClosedLoop(arm, weights, AMPLITUDE, jump=np.nextafter(changes.max(), 0.0))
    assert len(loop.run(step)) == step
    assert loop.failure is None
    assert len(loop.run(10)) == 0
    assert loop.failure["step"] == step


def test_noise_may_make_the_outputs_jump(arm, weights):
    noise = np.random.default_rng(0).uniform(-20.0, 20.0, (200, 2))
    loop = ClosedLoop(arm, weights, AMPLITUDE, jump=1e-9)
    loop.run(200, noise)
    assert loop.failure is None
    loop.run(2)
    assert loop.failure["reason"] == "jump"


def test_outputs_out_of_all_bounds_leave_the_domain(arm, weights):
    assert np.abs(arm.lengths @ (1e9 * weights)).max() > 1e9
    # The very first output has none before it to jump from.
    loop = ClosedLoop(arm, 1e9 * weights, AMPLITUDE)
    assert loop.run(100).shape == (0, 2)
    assert loop.failure["reason"] == "domain"
    assert loop.failure["step"] == 0
    json.dumps(loop.failure, allow_nan=False)


@pytest.mark.parametrize(("jump", "reason"), [(10.0, "jump"), (None, "domain")])
def test_an_output_that_the_arm_refuses_counts_as_a_jump(jump, reason):
    # A bias alone: the base rests at zero, then is told to go to 100 degrees within a step.
    still, away = np.zeros((81, 2)), np.zeros((81, 2))
    away[-1] = 100.0
    loop = ClosedLoop(Arm(BODY), still, AMPLITUDE, jump=jump)
    loop.run(10)
    loop.weights = away
    loop.run(10)
    assert loop.failure["reason"] == reason
    assert loop.failure["step"] == len(loop.outputs) == 10
    if reason == "jump":
        assert loop.failure["value"] == 100.0
    else:
        assert not loop.failure["low"] <= loop.failure["value"] <= loop.failure["high"]


def test_nothing_moves_after_a_failure(weights):
    loop = ClosedLoop(
        release(BODY, "quadratic", AMPLITUDE), 1.5 * weights, AMPLITUDE, jump=None, rest=None
    )
    loop.run(5_000)
    state, made, failure = loop.arm.state, len(loop.outputs), dict(loop.failure)
    outputs, lengths = loop.record(100)
    assert outputs.shape == (0, 2)
    assert lengths.shape == (0, 80)
    assert loop.arm.state == state
    assert len(loop.outputs) == made
    assert loop.failure == failure


def test_an_arm_at_rest_is_recognised(arm, weights):
    # Without weights the base stays where it is: the outputs are zero from the first step on.
    loop = ClosedLoop(arm, 0 * weights, AMPLITUDE, jump=None)
    loop.run(3 * WINDOW_STEPS)
    assert loop.failure["reason"] == "rest"
    assert loop.failure["step"] == len(loop.outputs) == WINDOW_STEPS
    loop = ClosedLoop(
        release(BODY, "quadratic", AMPLITUDE, "servo"), 0 * weights, 1.0, jump=None, rest=None
    )
    loop.run(WINDOW_STEPS + 1_000)
    assert loop.failure is None


def test_a_loop_refuses_what_cannot_be_done(arm, weights):
    with pytest.raises(ValueError, match=r"weights has shape \(79, 2\), expected \(80, 2\)"):
        ClosedLoop(arm, weights[1:], AMPLITUDE)
    for name, value in (("jump", 0.0), ("rest", -1.0), ("amplitude", float("nan"))):
        arguments = {"amplitude": AMPLITUDE} | {name: value}
        with pytest.raises(ValueError, match=f"{name} = {value}: expected a positive number"):
            ClosedLoop(arm, weights, **arguments)


def test_a_bias_is_taken_as_the_last_row(arm, weights, outputs):
    bias = np.array([[0.5, -0.25]])
    loop = ClosedLoop(arm, np.vstack((weights, bias)), AMPLITUDE)
    np.testing.assert_allclose(loop.run(1)[0], outputs[0] + bias[0], rtol=1e-12)


class TestScoreWindow:
    turn = LISSAJOUS.period / BODY.timestep

    def score(self, factor, speed=1.0):
        time = speed * np.arange(WINDOW_STEPS) * 0.01
        outputs = factor * AMPLITUDE * np.column_stack((np.sin(2 * time), np.sin(time)))
        return score_window(outputs, LISSAJOUS.orbit(AMPLITUDE), self.turn)

    def test_the_target_itself_is_held(self):
        scores = self.score(1.0)
        assert scores["held"] is True
        assert scores["max_distance"] < 1e-4
        assert scores["amplitude_ratio"] == pytest.approx(1.0, abs=1e-3)
        assert scores["period_ratio"] == pytest.approx(1.0, abs=1e-6)

    def test_a_wrong_period_is_not_held(self):
        scores = self.score(1.0, speed=1.02)
        assert scores["held"] is False
        assert scores["mean_distance"] < 1e-4
        assert scores["period_ratio"] == pytest.approx(1 / 1.02, abs=1e-6)

    def test_a_shrunken_curve_is_near_the_target_and_not_held(self):
        scores = self.score(0.05)
        assert scores["mean_distance"] < 0.05
        assert scores["period_ratio"] == pytest.approx(1.0, abs=1e-6)
        assert scores["held"] is False

    def test_distances_are_in_units_of_the_amplitude(self):
        scores = self.score(1.02)
        assert 0.005 < scores["mean_distance"] < scores["max_distance"] <= 0.0283

    def test_an_output_that_does_not_turn_has_no_period(self):
        scores = score_window(np.zeros((100, 2)), LISSAJOUS.orbit(AMPLITUDE), self.turn)
        assert scores["period_ratio"] is None
        assert scores["held"] is False
        json.dumps(scores, allow_nan=False)

    def test_no_outputs_have_no_scores(self):
        with pytest.raises(ValueError, match="outputs has no rows"):
            score_window(np.empty((0, 2)), LISSAJOUS.orbit(AMPLITUDE), self.turn)


def test_the_way_back_ends_where_the_distance_stays_small():
    distances = np.array([0.5, 0.2, 0.03, 0.2, 0.03, 0.02, 0.01])
    assert recovery_steps(distances, 0.02) == 4
    assert recovery_steps(distances, 0.0) == 6
    assert recovery_steps(distances, 1.0) == 0
    assert recovery_steps(np.empty(0), 0.1) == 0
