"""Reinforcement learning: many arms at once for stable-baselines3, training, and what is kept."""

try:
    from octoarm_agents.rl.hyperparameters import ALGORITHMS, Hyperparameters
    from octoarm_agents.rl.sb3_vec_env import Sb3VecEnv, make_sb3_vec_env
    from octoarm_agents.rl.task import Training
    from octoarm_agents.rl.training import train
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        f'{error}. octoarm_agents.rl needs more packages: pip install "octoarm-agents[rl]"',
        name=error.name,
    ) from error

__all__ = [
    "ALGORITHMS",
    "Hyperparameters",
    "Sb3VecEnv",
    "Training",
    "make_sb3_vec_env",
    "train",
]
