"""Reaching with muscles: the environment ``OctoArmReach-v0``."""

from octoarm_env.reach.bend import BendPropagation, bend_wave
from octoarm_env.reach.env import OctoArmReachEnv
from octoarm_env.reach.settings import ReachSettings, reachable_goals
from octoarm_env.reach.vector import OctoArmReachVectorEnv

__all__ = [
    "BendPropagation",
    "OctoArmReachEnv",
    "OctoArmReachVectorEnv",
    "ReachSettings",
    "bend_wave",
    "reachable_goals",
]
