"""Reaching with muscles: the environment ``OctoArmReach-v0``."""

from octoarm_env.reach.env import OctoArmReachEnv
from octoarm_env.reach.settings import ReachSettings, reachable_goals
from octoarm_env.reach.vector import OctoArmReachVectorEnv

__all__ = ["OctoArmReachEnv", "OctoArmReachVectorEnv", "ReachSettings", "reachable_goals"]
