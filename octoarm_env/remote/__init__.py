"""The environments ``OctoArm-v0`` and ``OctoArmReach-v0`` on a server, one or many, over gRPC.

A server is started by ``octoarm serve``, of the same version as this package.
"""

from octoarm_env.remote.connection import Connection, RemoteError
from octoarm_env.remote.env import RemoteOctoArm
from octoarm_env.remote.reach import RemoteOctoArmReach, RemoteOctoArmReachVectorEnv
from octoarm_env.remote.vector import RemoteOctoArmVectorEnv

__all__ = [
    "Connection",
    "RemoteError",
    "RemoteOctoArm",
    "RemoteOctoArmReach",
    "RemoteOctoArmReachVectorEnv",
    "RemoteOctoArmVectorEnv",
]
