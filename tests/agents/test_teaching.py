"""Teaching a readout a cycle: the weighted ridge, the loop's exponents, the search for ν and κ."""

from dataclasses import replace

import numpy as np
import pytest
from octoarm_agents.experiments.cycles.floquet_trials import noise_response
from octoarm_agents.reservoir import Readout
from octoarm_agents.reservoir.closed_loop import ClosedLoop, release, score_window
from octoarm_agents.reservoir.floquet import floquet_exponents
from octoarm_agents.reservoir.teaching import UNDISTURBED, ReadoutTrainer, Teaching, teach
from octoarm_agents.reservoir.tuning import tune

from octoarm_env import LIMIT_CYCLES, Arm, ArmParameters, DomainError

# Told in full where loops depend on it, whatever the default body is.
BODY = ArmParameters.preset("inertial").replace(area_scale=5.0)

QUICK = BODY.replace(compartments=10)

SOME = (1e-3, 2e-3, 5e-3, 5e-3, 2e-3, 1e-2)

GOOD = Teaching("lissajous", 20.0, 1e-4, steps=20_000, washout=4_000)
"""With this teaching the body holds the curve; with the next one it is lost at once."""
WILD = replace(GOOD, noise=1e-6)

TURN = LIMIT_CYCLES["lissajous"].period / BODY.timestep


@pytest.fixture(scope="module")
def trainer():
    return ReadoutTrainer(BODY, GOOD)


@pytest.fixture(scope="module")
def quick():
    """The trainer of a body that is quick, since it has few compartments."""
    return ReadoutTrainer(QUICK, GOOD)


@pytest.fixture(scope="module")
def good(trainer):
    return trainer.weights(GOOD.noise, UNDISTURBED)[0]


@pytest.fixture(scope="module")
def wild(trainer):
    return trainer.weights(WILD.noise, UNDISTURBED)[0]


def hold(weights):
    """The loop, 12,000 steps after the switch-on."""
    loop = ClosedLoop(release(BODY, GOOD.target, GOOD.amplitude), weights, GOOD.amplitude)
    loop.run(12_000)
    return loop


class TestTeaching:
    def test_without_disturbances_it_is_the_papers(self, trainer):
        fitted = trainer.fit(GOOD)
        signal = LIMIT_CYCLES["lissajous"].signal(20_001, 20.0)
        lengths = Arm(BODY).run(signal[:-1])[GOOD.washout :]
        readout = Readout("noise", noise=GOOD.noise).fit(lengths, signal[1 + GOOD.washout :])
        np.testing.assert_array_equal(fitted.weights_, readout.weights_)

    def test_a_trainer_gives_what_teach_gives(self, quick):
        taught = teach(QUICK, replace(GOOD, disturbances=SOME))
        assert taught.teaching == replace(GOOD, disturbances=SOME)
        exact = taught.readout.weights_
        # `teach` sums in one thread, this trainer in as many as there are: other last digits.
        again = quick.fit(taught.teaching).weights_
        np.testing.assert_allclose(again, exact, rtol=0, atol=1e-10 * np.abs(exact).max())
        weights, error = quick.weights(GOOD.noise, SOME)
        # The triangular factor of the rows loses some of 16 digits.
        np.testing.assert_allclose(weights, exact, rtol=0, atol=1e-8 * np.abs(exact).max())
        assert error == pytest.approx(taught.readout.training_error_, rel=1e-6)

    def test_sampled_noise_is_the_papers_own_training(self, trainer):
        readout = trainer.fit(replace(GOOD, sampled=True, seed=3))
        drawn = np.random.default_rng(3).uniform(-GOOD.noise, GOOD.noise, (16_000, 80))
        rows = trainer.run.lengths[GOOD.washout :] + drawn
        expected, *_ = np.linalg.lstsq(rows, trainer.run.signal[1 + GOOD.washout :])
        scale = np.abs(expected).max()
        np.testing.assert_allclose(readout.weights_, expected, rtol=0, atol=1e-9 * scale)
        # Its expectation is the ridge: the same within a few parts in a hundred.
        ridge = trainer.fit(GOOD).weights_
        np.testing.assert_allclose(readout.weights_, ridge, rtol=0, atol=0.1 * scale)
        with pytest.raises(ValueError, match="expected zeros where the noise is sampled"):
            replace(GOOD, sampled=True, disturbances=SOME)

    def test_no_noise_is_the_pseudo_inverse(self, trainer):
        fitted = trainer.fit(replace(GOOD, noise=0.0))
        lengths, signal = (
            trainer.run.lengths[GOOD.washout :],
            trainer.run.signal[1 + GOOD.washout :],
        )
        np.testing.assert_array_equal(fitted.weights_, Readout().fit(lengths, signal).weights_)

    def test_the_readout_answers_less_to_what_is_penalised(self, trainer):
        plain, plain_error = trainer.weights(1e-6, UNDISTURBED)
        weighted, weighted_error = trainer.weights(1e-6, SOME)
        assert weighted_error > plain_error
        # The body that follows a base disturbed a little, more slowly than in any of the scales.
        steps = 8_000
        slow = 0.01 * np.sin(np.arange(steps) / 80.0)[:, np.newaxis] * [1.0, 0.5]
        disturbed = Arm(BODY).run(trainer.run.signal[:steps] + slow)
        deviations = (disturbed - trainer.run.lengths[:steps])[4_000:]
        answers = [np.square(deviations @ weights).mean() for weights in (plain, weighted)]
        assert answers[1] < answers[0]

    def test_the_seed_is_that_of_the_disturbances(self, quick):
        other = ReadoutTrainer(QUICK, replace(GOOD, seed=1))
        np.testing.assert_array_equal(
            other.weights(GOOD.noise, UNDISTURBED)[0], quick.weights(GOOD.noise, UNDISTURBED)[0]
        )
        assert not np.array_equal(
            other.weights(GOOD.noise, SOME)[0], quick.weights(GOOD.noise, SOME)[0]
        )

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"target": "circle"}, "target = 'circle': expected one of"),
            ({"actuator": "muscle"}, "actuator = 'muscle': expected 'direct' or 'servo'"),
            ({"amplitude": 0.0}, "amplitude = 0.0: expected a positive number"),
            ({"amplitude": float("inf")}, "amplitude = inf"),
            ({"noise": -1e-6}, "noise = -1e-06: expected a number of metres, not negative"),
            ({"noise": float("nan")}, "noise = nan"),
            ({"disturbances": (0.1,)}, "expected 6 numbers of degrees"),
            (
                {"disturbances": (-1.0, *UNDISTURBED[1:])},
                "expected 6 numbers of degrees, not negative",
            ),
            ({"washout": -1}, "washout = -1: expected a whole number, at least 0"),
            ({"steps": 17_999}, "steps = 17999: expected a whole number, at least 18000"),
            ({"washout": 19_500}, "steps = 20000: expected a whole number, at least 20500"),
        ],
    )
    def test_what_cannot_be_is_refused(self, change, message):
        with pytest.raises(ValueError, match=message):
            replace(GOOD, **change)

    def test_a_teacher_that_is_too_much_is_reported(self):
        with pytest.raises(DomainError):
            teach(BODY, replace(GOOD, amplitude=300.0))


class TestExponents:
    def test_without_readout_the_bodys_own_deviations_die_out(self, trainer):
        none = np.zeros((80, 2))
        exponents = trainer.exponents(none)
        assert exponents.shape == (5,)
        assert np.all(np.diff(exponents) <= 0)
        assert exponents[0] < -0.1
        # A bias of zero is no readout either.
        np.testing.assert_allclose(trainer.exponents(np.zeros((81, 2))), exponents, rtol=1e-12)

    def test_a_loop_that_holds_has_no_exponent_but_the_phases(self, trainer, good):
        loop = hold(good)
        assert loop.failure is None
        orbit = LIMIT_CYCLES["lissajous"].orbit(GOOD.amplitude)
        assert score_window(loop.outputs[-5_000:], orbit, TURN)["held"] is True
        # Over eight turns the phase's exponent is zero within a few tenths.
        phase, second, *_ = trainer.exponents(good, steps=round(8 * TURN))
        assert abs(phase) < 0.3
        assert second < 0

    def test_a_loop_that_is_lost_has_a_positive_exponent(self, trainer, wild):
        assert hold(wild).failure is not None
        # A deviation grows tenfold within some steps.
        assert trainer.exponents(wild)[0] > 100

    def test_a_loop_of_boundless_gain_has_none(self, trainer, good):
        assert trainer.exponents(1e200 * good).shape == (0,)

    def test_they_belong_to_the_teachers_orbit(self, trainer, wild):
        """With the offsets added, even a loop that is lost stays on it for a while."""
        begin, steps = 6_000, 20
        arm = trainer.run.arm_after(begin)
        offsets = trainer.run.offsets(wild, begin, begin + steps)
        outputs, lengths = arm.run_closed_loop(wild, steps, offsets)
        np.testing.assert_allclose(
            outputs + offsets, trainer.run.signal[begin : begin + steps], atol=1e-6
        )
        np.testing.assert_allclose(lengths, trainer.run.lengths[begin : begin + steps], atol=1e-9)

    def test_the_seed_of_the_deviations_hardly_matters(self, trainer, wild):
        first, second = (floquet_exponents(trainer.run, wild, count=1, seed=s) for s in (0, 1))
        np.testing.assert_allclose(first, second, rtol=0.01)

    def test_what_cannot_be_is_refused(self, trainer, good):
        with pytest.raises(ValueError, match="count = 0: expected a whole number, at least 1"):
            floquet_exponents(trainer.run, good, count=0)
        with pytest.raises(ValueError, match=r"has 20000 steps, begin \+ skip \+ steps = 26000"):
            floquet_exponents(trainer.run, good, steps=20_000)


class TestNoiseResponse:
    def test_a_loop_without_readout_does_not_respond(self, trainer):
        assert noise_response(trainer.run, np.zeros((80, 2)), 1e-4, 5_000) == pytest.approx(0.0)

    def test_a_loop_that_holds_responds_and_one_that_is_lost_is_thrown_out(
        self, trainer, good, wild
    ):
        assert 0 < noise_response(trainer.run, good, 1e-5, 5_000) < 1_000
        assert noise_response(trainer.run, wild, 1e-4, 5_000) is None


class TestTuning:
    def test_the_same_seed_finds_the_same(self):
        # Some of this body's loops hold and others are lost.
        teaching = replace(GOOD, steps=18_000, washout=4_000)
        seen = []
        first = tune(QUICK, teaching, evaluations=8, seed=3, advance=lambda: seen.append(1))
        again = tune(QUICK, teaching, evaluations=8, seed=3)
        assert len(seen) == len(first.record) == 8
        assert again == first
        best = min(first.record, key=lambda result: result["score"])
        assert first.teaching == replace(
            teaching, noise=best["noise"], disturbances=tuple(best["disturbances"])
        )
        assert first.distance == best["distance"]
        for result in first.record:
            # Only what held throughout its trial has a distance.
            assert (result["distance"] is None) or result["steps"] == 12_000

    def test_what_cannot_be_is_refused(self):
        with pytest.raises(
            ValueError, match="evaluations = 7: expected a whole number, at least 8"
        ):
            tune(BODY, GOOD, evaluations=7)
        with pytest.raises(ValueError, match="noise = -1: expected a number of degrees"):
            tune(BODY, GOOD, noise=-1)
