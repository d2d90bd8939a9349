"""The soft robotic octopus arm of Nakajima et al. (2013) as a Gymnasium environment.

Importing this package registers ``OctoArm-v0`` and ``OctoArmReach-v0``::

    import gymnasium as gym
    import octoarm_env

    env = gym.make("OctoArm-v0", target="quadratic")
    envs = gym.make_vec("OctoArm-v0", num_envs=64)

The body without an episode around it is :class:`Arm`, its parameters are :class:`ArmParameters`;
:mod:`octoarm_env.wrappers` scales observations for networks; :mod:`octoarm_env.reach` is reaching
with muscles.
"""

from importlib.metadata import version
from pkgutil import extend_path

from gymnasium.envs.registration import register

# In a checkout this folder hides the installed package, which holds the compiled core: look there
# too.
__path__ = extend_path(__path__, __name__)

from octoarm_env import reach, wrappers
from octoarm_env._core import DomainError, instruction_set
from octoarm_env.arm import Arm, ArmState, Energy, Linearisation
from octoarm_env.arm_batch import ArmBatch, BatchRun
from octoarm_env.env import OctoArmEnv
from octoarm_env.parameters import ArmParameters
from octoarm_env.settings import EpisodeSettings
from octoarm_env.targets import LIMIT_CYCLES, LimitCycle
from octoarm_env.teacher import TeacherPolicy
from octoarm_env.vector import OctoArmVectorEnv, VectorSnapshot

__all__ = [
    "LIMIT_CYCLES",
    "Arm",
    "ArmBatch",
    "ArmParameters",
    "ArmState",
    "BatchRun",
    "DomainError",
    "Energy",
    "EpisodeSettings",
    "LimitCycle",
    "Linearisation",
    "OctoArmEnv",
    "OctoArmVectorEnv",
    "TeacherPolicy",
    "VectorSnapshot",
    "instruction_set",
    "reach",
    "wrappers",
]
__version__ = version("octoarm-env")

register(
    id="OctoArm-v0",
    entry_point="octoarm_env.env:OctoArmEnv",
    vector_entry_point="octoarm_env.vector:OctoArmVectorEnv",
    max_episode_steps=500,
)
register(
    id="OctoArmReach-v0",
    entry_point="octoarm_env.reach.env:OctoArmReachEnv",
    vector_entry_point="octoarm_env.reach.vector:OctoArmReachVectorEnv",
    max_episode_steps=100,
)
# The same on a server, octoarm_env.remote.
register(
    id="OctoArmRemote-v0",
    entry_point="octoarm_env.remote:RemoteOctoArm",
    vector_entry_point="octoarm_env.remote:RemoteOctoArmVectorEnv",
    max_episode_steps=500,
)
register(
    id="OctoArmReachRemote-v0",
    entry_point="octoarm_env.remote:RemoteOctoArmReach",
    vector_entry_point="octoarm_env.remote:RemoteOctoArmReachVectorEnv",
    max_episode_steps=100,
)
