"""The rod that PyElastica steps in the speed benchmark: it falls, swings, and stays whole."""

import math

import numpy as np
import pytest
from octoarm_agents.benchmark import elastica_rod
from octoarm_agents.benchmark.elastica_rod import ElasticaRod, has_elastica

from octoarm_env import ArmParameters

pytest.importorskip("elastica")


@pytest.fixture(scope="module")
def shared_rod():
    return ElasticaRod()


@pytest.fixture
def rod(shared_rod):
    shared_rod.reset()
    return shared_rod


def swing(rod, seconds):
    """Positions of the tip every 10 ms, (count, 3)."""
    tips = []
    for _ in range(round(seconds / 0.01)):
        rod.step(round(0.01 / rod.timestep))
        tips.append(rod.positions[-1])
    return np.array(tips)


def test_it_is_as_large_as_the_arm():
    assert has_elastica()
    arm = ArmParameters.preset("inertial")
    assert arm.compartments * arm.rest_length == pytest.approx(elastica_rod.LENGTH)
    assert (arm.base_radius + arm.tip_radius) / 2 == pytest.approx(elastica_rod.RADIUS, rel=0.01)
    assert arm.arm_density == elastica_rod.DENSITY
    stiffness = 4 * arm.longitudinal_stiffness * arm.rest_length
    section = math.pi * elastica_rod.RADIUS**2
    assert elastica_rod.YOUNGS_MODULUS * section == pytest.approx(stiffness, rel=0.001)
    weight = arm.gravity[2] * (1 - arm.water_density / arm.arm_density)
    assert pytest.approx(weight, rel=0.001) == elastica_rod.GRAVITY


def test_it_starts_straight_and_at_time_zero(rod):
    assert (rod.time, rod.timestep, rod.elements) == (0.0, 0.001, 20)
    x = np.linspace(0.0, elastica_rod.LENGTH, 21)
    np.testing.assert_allclose(rod.positions, np.outer(x, [1, 0, 0]), atol=1e-15)


def test_time_advances_by_the_steps(rod):
    rod.step()
    assert rod.time == pytest.approx(rod.timestep, rel=1e-12)
    rod.step(249)
    assert rod.time == pytest.approx(250 * rod.timestep, rel=1e-12)


def test_the_tip_falls_freely_at_first(rod):
    # The clamp is not felt so far out yet. The damper takes γ t / 3 of the fall, 1.7 per cent.
    rod.step(50)
    fall = elastica_rod.GRAVITY * rod.time**2 / 2 * (1 - elastica_rod.DAMPING * rod.time / 3)
    assert -rod.positions[-1, 2] == pytest.approx(fall, rel=0.002)


def test_it_swings_and_comes_to_rest_hanging(rod):
    tips = swing(rod, 12.0)
    np.testing.assert_array_equal(rod.positions[0], np.zeros(3))
    assert np.abs(tips[:, 1]).max() < 1e-9  # it stays in its plane
    # Never farther from the clamp than its length, a tenth of stretch added.
    assert np.linalg.norm(tips, axis=1).max() < 1.1 * elastica_rod.LENGTH
    # It swings through below the clamp, and back.
    last = tips[-100:].mean(axis=0)
    swung = tips[:, 0] - last[0]
    turns = np.count_nonzero(np.diff(np.sign(swung[np.abs(swung) > 0.01])))
    assert turns >= 3
    assert np.abs(tips[-100:] - last).max() < 0.002
    assert 0.0 < last[0] < 0.2 * elastica_rod.LENGTH
    assert -elastica_rod.LENGTH < last[2] < -0.9 * elastica_rod.LENGTH


def test_reset_repeats_the_motion_to_the_bit(rod):
    first = swing(rod, 0.5)
    rod.reset()
    assert rod.time == 0.0
    np.testing.assert_array_equal(swing(rod, 0.5), first)


def test_the_time_step_is_accurate(rod):
    coarse = swing(rod, 1.0)
    fine = swing(ElasticaRod(timestep=0.0002), 1.0)
    # Of a motion of 0.5 m; 0.2 mm measured.
    np.testing.assert_allclose(coarse, fine, atol=5e-4)


def test_the_limit_of_stability():
    """The module names 2.30 and 2.35 ms; a little farther apart for other processors."""
    ElasticaRod(timestep=0.0022).step(900)
    with pytest.raises(FloatingPointError, match="diverged before t = "):
        ElasticaRod(timestep=0.0025).step(900)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"elements": 1}, "elements must be at least 2, got 1"),
        ({"timestep": 0.0}, "timestep must be a positive number of seconds, got 0.0"),
        ({"timestep": math.nan}, "timestep must be a positive number of seconds, got nan"),
    ],
)
def test_a_wrong_argument_is_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        ElasticaRod(**arguments)


def test_a_wrong_count_is_named(rod):
    with pytest.raises(ValueError, match="count must be at least 1, got 0"):
        rod.step(0)


def test_without_pyelastica_the_extra_is_named(monkeypatch):
    def refuse(name):
        raise ImportError(name)

    monkeypatch.setattr(elastica_rod.importlib, "import_module", refuse)
    with pytest.raises(ImportError, match=r"octoarm-agents\[benchmark\]"):
        ElasticaRod()
