"""Reinforcement learning: many arms at once for stable-baselines3."""

from octoarm_agents.rl.sb3_vec_env import Sb3VecEnv, make_sb3_vec_env

__all__ = ["Sb3VecEnv", "make_sb3_vec_env"]
