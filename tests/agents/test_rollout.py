"""Episodes side by side, disturbances, and the measures taken of them."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from octoarm_agents.common.environment import inspect_env, make_vector_env
from octoarm_agents.policies.evaluation import evaluate_policy
from octoarm_agents.policies.measures import (
    TargetOrbit,
    orbit_measures,
    orbit_series,
    recovery,
    tracking_measures,
)
from octoarm_agents.policies.rollout import HoldPolicy, Noise, Push, Rollout, roll_out
from octoarm_agents.reservoir import ReadoutPolicy, train_policy

from octoarm_env import ArmParameters, TeacherPolicy


class Seen:
    """A policy, and what it has seen."""

    def __init__(self, policy) -> None:
        self.policy, self.lengths = policy, []

    def predict(self, observation, *args, **kwargs):
        self.lengths.append(observation)
        return self.policy.predict(observation, *args, **kwargs)


@pytest.fixture(scope="module")
def readout() -> ReadoutPolicy:
    return train_policy(steps=1000)


def make_envs(readout: ReadoutPolicy, count: int, steps: int):
    return make_vector_env(count, readout.parameters, readout.settings, steps=steps, threads=1)


def test_a_rollout_is_what_single_environments_do(readout: ReadoutPolicy) -> None:
    seen = Seen(readout)
    rollout = roll_out(seen, make_envs(readout, 3, 60), seed=7, steps=60)
    for index in range(3):
        env = gym.make("OctoArm-v0")
        observation, _ = env.reset(seed=7 + index)
        for step in range(60):
            np.testing.assert_allclose(seen.lengths[step][index], observation, atol=1e-9)
            action, _ = readout.predict(observation)
            observation, reward, _, _, info = env.step(action)
            assert rollout.rewards[step, index] == pytest.approx(reward, abs=1e-6)
            assert rollout.errors[step, index] == pytest.approx(info["tracking_error"], abs=1e-6)
    assert rollout.alive.all()
    assert not rollout.failed.any()


def test_the_same_seed_gives_the_same_bits(readout: ReadoutPolicy) -> None:
    def run(seed: int) -> np.ndarray:
        envs = make_envs(readout, 4, 150)
        push, noise = Push(5.0, 10, 5), Noise(1e-5, 50, 20)
        return roll_out(readout, envs, seed=seed, steps=150, push=push, noise=noise).angles

    np.testing.assert_array_equal(run(1), run(1))
    assert (run(1) != run(2)).any()


def test_a_push_is_what_it_says() -> None:
    parameters, settings = inspect_env(gym.make("OctoArm-v0", amplitude=10.0))
    envs = make_vector_env(120, parameters, settings, steps=100, threads=1)
    pushed = roll_out(HoldPolicy(), envs, seed=0, steps=100, push=Push(4.0, 60, 39))
    # The servo has come to rest, and follows the push within 0.39 s.
    np.testing.assert_allclose(pushed.angles[59], 0, atol=0.01)
    sizes = np.linalg.norm(pushed.angles[98], axis=1)
    np.testing.assert_allclose(sizes, 4.0, rtol=1e-3)
    directions = np.arctan2(*pushed.angles[98].T[::-1])
    # All directions are pushed in.
    assert np.histogram(directions, 8, (-np.pi, np.pi))[0].min() > 5


def test_a_shaken_base_gets_white_noise() -> None:
    parameters, settings = inspect_env(gym.make("OctoArm-v0", amplitude=10.0))
    envs = make_vector_env(50, parameters, settings, steps=60, threads=1)
    shake = Push(4.0, 20, 30, white=True)
    angles = roll_out(HoldPolicy(), envs, seed=0, steps=60, push=shake).angles
    np.testing.assert_allclose(angles[19], 0, atol=1e-6)
    np.testing.assert_allclose(angles[50:], 0, atol=1e-6)
    shaken = angles[20:50]
    assert 3.9 < np.abs(shaken).max() <= 4.0 + 1e-5
    assert shaken.std() == pytest.approx(4 / np.sqrt(3), rel=0.03)
    assert abs(np.corrcoef(shaken[:-1].ravel(), shaken[1:].ravel())[0, 1]) < 0.05


def test_noise_reaches_the_agent_alone(readout: ReadoutPolicy) -> None:
    noisy, plain = Seen(HoldPolicy()), Seen(HoldPolicy())
    first, second = (
        roll_out(policy, make_envs(readout, 5, 40), seed=0, steps=40, noise=noise)
        for policy, noise in ((noisy, Noise(1e-4, 10, 20)), (plain, None))
    )
    np.testing.assert_array_equal(first.angles, second.angles)
    difference = np.abs(np.array(noisy.lengths) - np.array(plain.lengths))
    assert difference[:10].max() == difference[30:].max() == 0
    assert 0.99e-4 < difference[10:30].max() <= 1e-4
    assert difference[10:30].mean() == pytest.approx(0.5e-4, rel=0.05)


def test_a_failed_arm_counts_until_it_fails() -> None:
    # Thrown about by its base, the arm leaves its domain.
    parameters, settings = inspect_env(
        gym.make("OctoArm-v0", arm="inertial", actuator="servo", amplitude=20.0, action_range=180.0)
    )
    envs = make_vector_env(4, parameters, settings, steps=300, threads=1)

    class Flail(HoldPolicy):
        def predict(self, observation, state=None, *args, **kwargs):
            step = state or 0
            sign = 1 if step // 8 % 2 else -1
            return np.full((len(observation), 2), sign, np.float32), step + 1

    rollout = roll_out(Flail(), envs, seed=0, steps=300)
    assert rollout.failed.any()
    measures = tracking_measures(rollout)
    assert measures["survival"] == 1 - rollout.failed.mean()
    for index in np.flatnonzero(rollout.failed):
        lived = int(rollout.alive[:, index].sum())
        assert 0 < lived < 300
        assert rollout.alive[:lived, index].all()
        assert not rollout.rewards[lived:, index].any()
        assert np.isinf(orbit_series(rollout, np.ones((4, 2)))[lived:, index]).all()


def circle(turns: float, steps: int, radius: float = 1.0, phase: float = 0.0) -> np.ndarray:
    angles = 2 * np.pi * (np.arange(steps) / steps * turns + phase)
    return radius * np.stack((np.cos(angles), np.sin(angles)), axis=1)


TARGET = TargetOrbit(circle(1, 2048), amplitude=1.0, period=1.0, control_period=0.01)


def rollout_of(angles: np.ndarray) -> Rollout:
    steps, count, _ = angles.shape
    nothing = np.zeros((steps, count))
    return Rollout(
        nothing, angles, nothing, np.ones((steps, count), bool), np.zeros(count, bool), angles
    )


def measured(angles: np.ndarray) -> dict[str, float | None]:
    return orbit_measures(rollout_of(angles[:, np.newaxis]), TARGET, window=500)


def test_orbit_measures_do_not_see_the_phase() -> None:
    for phase in (0.0, 0.3):
        found = measured(circle(10, 1000, phase=phase))
        assert found["orbit_distance"] == pytest.approx(0, abs=1e-5)
        assert found["period"] == pytest.approx(1.0, rel=1e-3)
        assert found["held"] == found["survival"] == 1


def test_orbit_measures_see_radius_and_pace() -> None:
    found = measured(circle(10, 1000, radius=1.05))
    assert found["orbit_distance"] == pytest.approx(0.05, rel=1e-3)
    assert measured(circle(10, 1000, radius=1.2))["held"] == 0
    slow = measured(circle(8, 1000))
    assert slow["period"] == pytest.approx(1.25, rel=1e-2)
    assert slow["held"] == 0
    still = measured(np.zeros((1000, 2)))
    assert still["period"] is None
    # An arm at rest is on every orbit through the origin; that does not count.
    assert still["orbit_distance"] is None


def test_recovery_is_timed() -> None:
    angles = np.repeat(circle(10, 1000)[:, np.newaxis], 4, axis=1)
    angles[100:300, 1] *= 1.5  # back at step 300
    angles[100:, 2] *= 1.5  # never
    angles[950:, 3] *= 1.5  # off again at the end
    found = recovery(rollout_of(angles), TARGET, end=200)
    assert found["recovered"] == 0.5
    assert found["time"] is None
    resting = angles[:, :1].copy()
    resting[400:] = resting[400]  # on the orbit, but at rest
    found = recovery(rollout_of(resting), TARGET, end=200)
    assert found["recovered"] == 0
    found = recovery(rollout_of(angles[:, :2]), TARGET, end=200)
    assert found["recovered"] == 1.0
    assert found["time"] == pytest.approx(0.5)


def test_the_trivial_agents(readout: ReadoutPolicy) -> None:
    still = evaluate_policy("hold", readout, episodes=2, steps=250, threads=1)
    clock = evaluate_policy("clock", readout, episodes=2, steps=250, threads=1)
    assert still["return"] < 5
    assert clock["return"] > 249.9
    assert clock["tracking_error"] < 1e-3
    assert clock["held"] == 1
    with pytest.raises(ValueError, match="policy = 'dance'"):
        evaluate_policy("dance", readout, episodes=1)  # type: ignore[arg-type]


def test_evaluation_does_not_depend_on_threads(readout: ReadoutPolicy) -> None:
    one, two = (
        evaluate_policy(readout, readout, episodes=20, steps=100, threads=n, seed=5) for n in (1, 2)
    )
    assert one == two


def test_other_bodies_can_be_evaluated(readout: ReadoutPolicy) -> None:
    heavy = replace(readout, parameters=ArmParameters(arm_density=1100.0))
    own, other = (
        evaluate_policy(readout, home, episodes=2, steps=100, threads=1)
        for home in (readout, heavy)
    )
    assert other["return"] < own["return"]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Push(-1.0), "size = -1.0"),
        (lambda: Push(float("nan")), "size = nan"),
        (lambda: Push(1.0, -1), "begin = -1: expected a whole number, at least 0"),
        (lambda: Noise(-1.0), "size = -1.0"),
        (lambda: Noise(1.0, 0, -3), "steps = -3: expected a whole number, at least 0"),
    ],
)
def test_bad_disturbances(make, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_bad_steps(readout: ReadoutPolicy) -> None:
    with pytest.raises(ValueError, match="steps = 0"):
        roll_out(readout, make_envs(readout, 1, 10), seed=0, steps=0)


def test_teacher_in_a_rollout(readout: ReadoutPolicy) -> None:
    envs = make_envs(readout, 3, 100)
    rollout = roll_out(TeacherPolicy(envs), envs, seed=0, steps=100)
    assert rollout.returns.min() > 99.9
