"""The paper's limit cycles and the distance to an orbit."""

import numpy as np
import pytest
from octoarm_agents.reservoir import orbit_distance, turn_time

from octoarm_env import LIMIT_CYCLES, LimitCycle, OctoArmEnv

QUADRATIC = LIMIT_CYCLES["quadratic"]


@pytest.mark.parametrize("cycle", LIMIT_CYCLES.values(), ids=lambda cycle: cycle.name)
class TestEveryCycle:
    def test_the_settled_orbit_reaches_the_amplitude_and_no_further(self, cycle):
        assert np.abs(cycle.orbit(30.0)).max() == pytest.approx(30.0, rel=1e-12)

    def test_the_settled_signal_runs_on_the_orbit(self, cycle):
        settled = cycle.signal(8_000, 1.0)[3_000:]
        # The chords of the sampled orbit stray 2e-5 from the arc; the approach is long over.
        assert orbit_distance(settled, cycle.orbit(1.0)).max() < 3e-5

    def test_the_signal_starts_near_the_origin(self, cycle):
        assert np.abs(cycle.signal(1, 45.0)).max() < 2.0

    def test_the_signal_turns_with_the_period(self, cycle):
        settled = cycle.signal(20_000, 1.0)[3_000:]
        assert 1e-3 * turn_time(settled[:, 1]) == pytest.approx(cycle.period, rel=1e-5)

    def test_the_orbit_closes(self, cycle):
        orbit = cycle.orbit(1.0)
        gaps = np.linalg.norm(np.diff(orbit, axis=0), axis=1)
        assert np.linalg.norm(orbit[0] - orbit[-1]) < 1.01 * gaps.max()

    def test_a_longer_signal_begins_with_the_shorter(self, cycle):
        np.testing.assert_array_equal(cycle.signal(300, 7.0)[:200], cycle.signal(200, 7.0))

    @pytest.mark.parametrize("amplitude", [0.0, -1.0, np.nan, np.inf])
    def test_an_impossible_amplitude_is_refused(self, cycle, amplitude):
        with pytest.raises(ValueError, match="amplitude"):
            cycle.signal(10, amplitude)


def test_the_oscillators_follow_their_equations():
    # Centred differences of a signal with step 0.01 are off by about 1e-4 of its derivative.
    for name, x1_rate, x2_rate in (
        ("van_der_pol", lambda x, y: y, lambda x, y: -x + (1 - x**2) * y),
        (
            "quadratic",
            lambda x, y: x + y - 5 * x * (x**2 + y**2),
            lambda x, y: -2 * x + y - y * (x**2 + y**2),
        ),
    ):
        cycle = LIMIT_CYCLES[name]
        signal = cycle.signal(3_000, 1.0)
        x, y = 0.01 * signal.T / signal[0, 0]  # they start at (0.01, 0.01)
        for signal, rate in ((x, x1_rate), (y, x2_rate)):
            slope = (signal[2:] - signal[:-2]) / 0.02
            np.testing.assert_allclose(slope, rate(x, y)[1:-1], atol=2e-3)


def test_the_known_periods():
    # Van der Pol with μ = 1: 6.66328686 (e.g. Amore et al. 2018, doi:10.1016/j.amc.2018.02.012).
    # The signal's own Runge-Kutta method at 0.01 a step is off by less than 1e-7 of that.
    assert LIMIT_CYCLES["van_der_pol"].period == pytest.approx(0.666328686, rel=1e-9)
    assert LIMIT_CYCLES["lissajous"].period == pytest.approx(0.2 * np.pi, rel=1e-12)


def test_the_environment_follows_the_same_orbit():
    for name, cycle in LIMIT_CYCLES.items():
        env = OctoArmEnv(target=name, amplitude=12.0)
        np.testing.assert_array_equal(env.orbit, cycle.orbit(12.0))
        assert env.period == cycle.period


def test_an_unknown_cycle_is_refused():
    with pytest.raises(ValueError, match="square"):
        LimitCycle("square")


class TestOrbitDistance:
    def test_it_is_zero_on_the_orbit(self):
        orbit = QUADRATIC.orbit(40.0)
        assert orbit_distance(orbit, orbit).max() == 0.0
        middles = 0.5 * (orbit + np.roll(orbit, -1, axis=0))
        assert orbit_distance(middles, orbit).max() < 1e-13

    def test_a_circle_is_as_far_as_the_radii_differ(self):
        angles = np.linspace(0, 2 * np.pi, 1000, endpoint=False)
        circle = np.stack((np.cos(angles), np.sin(angles)), axis=1)
        for radius in (0.5, 0.99, 1.5, 20.0):
            # A chord of a thousand strays 1 - cos(π/1000) = 5e-6 from the arc.
            np.testing.assert_allclose(
                orbit_distance(radius * circle[::7], circle), abs(radius - 1), atol=1e-5
            )

    @pytest.mark.parametrize("name", ["van_der_pol", "lissajous"])
    def test_it_equals_the_least_distance_to_all_chords(self, name):
        orbit = LIMIT_CYCLES[name].orbit(1.0)[::20]
        points = np.random.default_rng(0).uniform(-1.2, 1.2, (5_000, 2))
        begins, chords = orbit, np.roll(orbit, -1, axis=0) - orbit
        offsets = points[:, None] - begins
        fractions = np.clip((offsets * chords).sum(-1) / (chords**2).sum(-1), 0, 1)
        exact = np.linalg.norm(offsets - fractions[..., None] * chords, axis=-1).min(axis=1)
        np.testing.assert_allclose(orbit_distance(points, orbit), exact, atol=1e-14)

    def test_no_points_have_no_distances(self):
        assert orbit_distance(np.empty((0, 2)), QUADRATIC.orbit(1.0)).shape == (0,)


def test_a_signal_that_does_not_turn_has_no_period():
    assert np.isnan(turn_time(np.ones(100)))
    assert np.isnan(turn_time(np.empty(0)))
