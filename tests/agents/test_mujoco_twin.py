"""The arm against its MuJoCo twin: an engine that shares no code and no formulation with it.

The twin knows neither water nor weight nor volume forces, so they are off here. Everything else is
compared: masses, springs, dampers, struts, joints, Coriolis and centrifugal terms, a turning base.
"""

import numpy as np
import pytest

from octoarm_env import Arm, ArmParameters, ArmState

pytest.importorskip("mujoco")

from octoarm_agents.benchmark.mujoco_twin import MujocoTwin

STEPS = 300

# Both engines integrate the same equations with the same method at the same step, so all that may
# differ is rounding. Over seeds 0-99 of the three bodies the lengths differed by 1.1e-15 m at most,
# coordinates by 2e-14, rates by 2e-12, energies by 1.4e-13 of their value; the tolerances leave two
# decimal places or so to other processors and versions of MuJoCo.
LENGTH_TOLERANCE = 1e-13

# MuJoCo turns the base in the world.
DRY = ArmParameters.preset("inertial").replace(
    water_density=0.0,
    arm_density=0.0,
    longitudinal_volume_gain=0.0,
    transverse_volume_gain=0.0,
)


def uneven(compartments: int) -> dict[str, np.ndarray]:
    """Stiffness, damping and masses that are random in every compartment."""
    random = np.random.default_rng(compartments)
    nominal = DRY.replace(plane_mass=0.01, plane_inertia=2e-6)
    ranges = {"stiffness": (0.6, 1.2), "damping": (0.3, 1.1), "mass": (1.0, 1.8)}
    return {
        name: getattr(nominal, name) * random.uniform(*ranges[name.split("_")[1]], compartments)
        for name in (
            *("longitudinal_stiffness", "transverse_stiffness", "longitudinal_damping"),
            *("transverse_damping", "longitudinal_mass", "transverse_mass", "plane_mass"),
        )
    } | {"plane_inertia": nominal.plane_inertia * random.uniform(0.0, 1.0, compartments)}


BODIES = {
    "inertial": DRY,
    "seven compartments, heavy planes": DRY.replace(
        compartments=7, plane_mass=0.01, plane_inertia=2e-6
    ),
    "three compartments, undamped": DRY.replace(
        compartments=3, longitudinal_damping=0.0, transverse_damping=0.0
    ),
    "each compartment its own": DRY.replace(**uneven(DRY.compartments)),
    "nine compartments, each its own": DRY.replace(compartments=9, **uneven(9)),
}


def random_state(parameters: ArmParameters, seed: int) -> ArmState:
    """A bent, stretched and moving arm on a turning base."""
    random = np.random.default_rng(seed)
    count = parameters.compartments
    arm = Arm(parameters)
    arm.reset(undeformed=True)
    coordinates = arm.state.coordinates.copy()
    radii = coordinates[:, 3:]
    coordinates[:, 0] += random.uniform(-2e-3, 2e-3, count)
    coordinates[:, 1:3] += random.uniform(-0.15, 0.15, (count, 2))
    radii += random.uniform(-4e-4, 4e-4, radii.shape) * radii / parameters.base_radius
    rates = random.uniform(-0.02, 0.02, (count, 7))
    rates[:, 1:3] = random.uniform(-1.0, 1.0, (count, 2))
    turning = random.uniform(1.0, 2.0, 2) * random.choice((-1.0, 1.0), 2)
    base = np.concatenate((random.uniform(-0.5, 0.5, 2), turning))
    return ArmState(coordinates, rates, base)


def turn_both(parameters: ArmParameters, state: ArmState) -> tuple[Arm, MujocoTwin, float]:
    """Step both from `state` with the base turning on evenly; the largest difference of lengths."""
    arm = Arm(parameters, actuator="direct")
    arm.state = state
    twin = MujocoTwin(parameters)
    twin.set_state(state.coordinates, state.rates, state.base)
    np.testing.assert_allclose(twin.lengths, arm.lengths, atol=1e-15)

    # The base already has the rate at which it is commanded: no jerk at the first step.
    times = parameters.timestep * np.arange(1, STEPS + 1)
    angles = np.degrees(state.base[:2] + times[:, None] * state.base[2:])
    difference = np.abs(arm.run(angles) - twin.run(STEPS)).max()
    return arm, twin, float(difference)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("body", BODIES)
def test_lengths_and_state_agree(body, seed):
    state = random_state(BODIES[body], seed)
    arm, twin, difference = turn_both(BODIES[body], state)
    assert np.abs(arm.state.rates).max() > 1e-3, "the arm should still be moving"
    assert difference < LENGTH_TOLERANCE

    coordinates, rates, base = twin.state
    np.testing.assert_allclose(arm.state.coordinates, coordinates, atol=2e-12)
    np.testing.assert_allclose(arm.state.rates, rates, atol=2e-10)
    np.testing.assert_allclose(arm.state.base, base, atol=2e-11)
    np.testing.assert_allclose(arm.positions, twin.positions, atol=2e-12)


@pytest.mark.parametrize("body", BODIES)
def test_muscles_pull_alike(body):
    parameters = BODIES[body]
    state = random_state(parameters, 3)
    random = np.random.default_rng(3)
    muscles = random.uniform(-0.2, 0.1, (2, parameters.compartments, 4))
    arm, twin = Arm(parameters, actuator="direct"), MujocoTwin(parameters)
    arm.state = state
    arm.muscles = muscles[0], muscles[1]
    twin.set_state(state.coordinates, state.rates, state.base)
    twin.set_muscles(*muscles)
    times = parameters.timestep * np.arange(1, STEPS + 1)
    angles = np.degrees(state.base[:2] + times[:, None] * state.base[2:])
    with_muscles = arm.run(angles)
    assert np.abs(with_muscles - twin.run(STEPS)).max() < LENGTH_TOLERANCE
    arm.state = state
    assert np.abs(arm.run(angles) - with_muscles).max() > 1e-3


@pytest.mark.parametrize("body", BODIES)
def test_energies_agree(body):
    arm, twin, _ = turn_both(BODIES[body], random_state(BODIES[body], 7))
    np.testing.assert_allclose(arm.energy(), twin.energy(), rtol=1e-11)
    assert min(arm.energy()) > 1e-5


def test_the_comparison_would_notice_a_small_error():
    """One millionth of the stiffness is seen a thousand times above the tolerance."""
    state = random_state(DRY, 0)
    arm = Arm(DRY.replace(longitudinal_stiffness=DRY.longitudinal_stiffness * (1 + 1e-6)))
    arm.state = state
    twin = MujocoTwin(DRY)
    twin.set_state(state.coordinates, state.rates, state.base)
    times = DRY.timestep * np.arange(1, STEPS + 1)
    angles = np.degrees(state.base[:2] + times[:, None] * state.base[2:])
    assert np.abs(arm.run(angles) - twin.run(STEPS)).max() > 1000 * LENGTH_TOLERANCE
