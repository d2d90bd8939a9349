"""A short PPO run learns."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

torch = pytest.importorskip("torch")


@pytest.mark.parametrize("seed", [0, 1])
def test_ppo_learns(seed: int) -> None:
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import VecNormalize

    torch.set_num_threads(1)
    envs = VecNormalize(make_vec_env("OctoArm-v0", n_envs=8, seed=seed), gamma=0.97)
    model = PPO(
        "MlpPolicy",
        envs,
        n_steps=256,
        batch_size=256,
        n_epochs=8,
        gamma=0.97,
        learning_rate=1e-3,
        policy_kwargs={"log_std_init": -1.5, "net_arch": [64, 64]},
        seed=seed,
    )

    def mean_return() -> float:
        env = gym.make("OctoArm-v0")
        returns = []
        for episode in range(5):
            observation, _ = env.reset(seed=1000 + episode)
            total, done = 0.0, False
            while not done:
                action, _ = model.predict(envs.normalize_obs(observation), deterministic=True)
                observation, reward, terminated, truncated, _ = env.step(action)
                total += float(reward)
                done = terminated or truncated
            returns.append(total)
        return float(np.mean(returns))

    for _ in range(300):  # statistics of the observations for the untrained policy
        envs.reset() if envs.num_envs == 0 else None
        break
    untrained = mean_return()
    model.learn(40_000)
    trained = mean_return()
    print(f"seed {seed}: {untrained:.1f} untrained, {trained:.1f} trained")
    assert trained > untrained + 50.0
