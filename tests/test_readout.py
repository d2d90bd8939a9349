"""A linear readout of the spring lengths holds every cycle in the environment."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

from octoarm_env import TeacherPolicy

# 35 s of the teacher, its actions followed with a little noise so that the readout sees the body
# beside its orbit too; sensor noise of 1e-5 m, by its exact expectation.
STEPS = 3500
ACTION_NOISE = 0.05
SENSOR_NOISE = 1e-5


@pytest.mark.parametrize("target", ["quadratic", "van_der_pol", "lissajous"])
def test_the_readout_earns_nearly_everything(target: str) -> None:
    env = gym.make("OctoArm-v0", target=target, max_episode_steps=STEPS)
    teacher = TeacherPolicy(env)
    rng = np.random.default_rng(0)
    observation, _ = env.reset(seed=0)
    lengths, actions = np.empty((STEPS, 80)), np.empty((STEPS, 2))
    for step in range(STEPS):
        lengths[step] = observation
        actions[step], _ = teacher.predict(observation)
        noisy = np.clip(actions[step] + ACTION_NOISE * rng.uniform(-1, 1, 2), -1, 1)
        observation, *_ = env.step(noisy)
    ridge = STEPS * SENSOR_NOISE**2 / 3 * np.eye(80)
    weights = np.linalg.solve(lengths.T @ lengths + ridge, lengths.T @ actions)

    env = gym.make("OctoArm-v0", target=target)
    returns = []
    for seed in range(100, 105):  # phases not seen in training
        observation, _ = env.reset(seed=seed)
        total = 0.0
        for _ in range(500):
            action = np.clip(observation @ weights, -1, 1)
            observation, reward, terminated, _, _ = env.step(action)
            assert not terminated
            total += float(reward)
        returns.append(total / 500)
    # Measured 0.99 to 1.00 on all three; the teacher earns 0.9999.
    assert min(returns) >= 0.97
