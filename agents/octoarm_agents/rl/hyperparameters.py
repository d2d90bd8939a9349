"""Hyper-parameters of the algorithms: YAML files in the format of rl-baselines3-zoo.

A file is keyed by environment id. Under ``OctoArm-v0``, or ``OctoArmReach-v0``, it holds the
arguments of the algorithm's class, and beside them ``n_timesteps``, ``n_envs``, ``policy``,
``normalize`` (arguments of `VecNormalize`, true or false) and ``env_kwargs``: arguments of the
environments that are trained in, while evaluation keeps to the standard episode. A number written
``lin_0.001`` falls linearly to zero over the training. The same file trains with the zoo:
``rl_zoo3 train --conf-file FILE``.
"""

from __future__ import annotations

import copy
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.utils import LinearSchedule

from octoarm_agents.common.environment import ENV_ID

_CLASSES = {"ppo": PPO, "sac": SAC, "tqc": TQC, "recurrent_ppo": RecurrentPPO}

REACH_ID = "OctoArmReach-v0"
"""The environment of the arm that reaches."""

ALGORITHMS = tuple(_CLASSES)
"""Those that `octoarm train` knows."""


def algorithm_class(algorithm: str) -> Any:
    """Give the class of stable-baselines3 or sb3-contrib that trains.

    Raises:
        ValueError: an algorithm that is not one of `ALGORITHMS`.
    """
    if algorithm not in ALGORITHMS:
        raise ValueError(f"algorithm = {algorithm!r}: expected one of {ALGORITHMS}")
    return _CLASSES[algorithm]


_PREFIXES = {ENV_ID: "", REACH_ID: "reach_"}
_BUFFERS = {"HerReplayBuffer": HerReplayBuffer}


def hyperparameter_file(algorithm: str, env_id: str = ENV_ID) -> Path:
    """The file with the hyper-parameters that were tuned for an algorithm and an environment."""
    return Path(__file__).parent / "hyperparameters" / f"{_PREFIXES[env_id]}{algorithm}.yml"


@dataclass(frozen=True)
class Hyperparameters:
    """What a training needs to know beside its environment.

    Attributes:
        steps: environment steps, over all environments.
        num_envs: environments that are stepped together.
        policy: name of the policy's class.
        normalize: arguments of `VecNormalize`.
        env: arguments of the environments that are trained in.
        arguments: of the algorithm's class, as in the file.
    """

    steps: int
    num_envs: int
    policy: str
    normalize: dict[str, Any]
    env: dict[str, Any]
    arguments: dict[str, Any]

    @classmethod
    def load(
        cls, algorithm: str, path: str | os.PathLike[str] | None = None, env_id: str = ENV_ID
    ) -> Hyperparameters:
        """Read them from a file.

        Args:
            algorithm: one of `ALGORITHMS`.
            path: the file; None: the one that comes with this distribution.
            env_id: of the environment: `ENV_ID` or `REACH_ID`.

        Raises:
            ValueError: a file that is no such YAML; the message says what is wrong.
            OSError: the file cannot be read.
        """
        algorithm_class(algorithm)
        file = hyperparameter_file(algorithm, env_id) if path is None else Path(path)
        try:
            content = yaml.safe_load(file.read_text(encoding="utf-8"))
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise ValueError(f"{file} is no YAML: {error}") from None
        if not isinstance(content, dict) or not isinstance(content.get(env_id), dict):
            raise ValueError(f"{file} has no entry {env_id!r}")
        try:
            return cls.from_entries(content[env_id])
        except ValueError as error:
            raise ValueError(f"{file}: {error}") from None

    @classmethod
    def from_entries(cls, entries: dict[str, Any]) -> Hyperparameters:
        """Take the entries under the environment's id apart."""
        rest = dict(entries)
        try:
            steps, num_envs = rest.pop("n_timesteps"), rest.pop("n_envs", 1)
            policy = rest.pop("policy")
        except KeyError as error:
            raise ValueError(f"{error} is missing") from None
        for name, number in {"n_timesteps": steps, "n_envs": num_envs}.items():
            # YAML reads 1e6 as a text, and 1.0e6 as a float.
            if isinstance(number, bool) or not isinstance(number, int | float) or number < 1:
                raise ValueError(f"{name} = {number!r}: expected a whole number, at least 1")
        normalize = rest.pop("normalize", False)
        if isinstance(normalize, bool):
            normalize = {"norm_obs": normalize, "norm_reward": normalize}
        if not isinstance(normalize, dict):
            raise ValueError(f"normalize = {normalize!r}: expected true, false or its arguments")
        env = rest.pop("env_kwargs", None) or {}
        if not isinstance(env, dict):
            raise ValueError(f"env_kwargs = {env!r}: expected the environment's arguments by name")
        if rest.keys() & {"env_wrapper", "vec_env_wrapper", "frame_stack", "callback"}:
            raise ValueError("wrappers and callbacks are not supported here, only in the zoo")
        return cls(int(steps), int(num_envs), str(policy), normalize, env, rest)

    def entries(self) -> dict[str, Any]:
        """Give them as they stand in a file, under the environment's id."""
        return {
            "normalize": self.normalize,
            "n_envs": self.num_envs,
            "n_timesteps": self.steps,
            "env_kwargs": self.env,
            "policy": self.policy,
            **self.arguments,
        }

    @property
    def schedules(self) -> list[str]:
        """Names of those that fall to zero over the training, and so depend on its length."""
        return [name for name, value in self.arguments.items() if _falls(value)]

    def model_arguments(self) -> dict[str, Any]:
        """Give the arguments of the algorithm's class, schedules made and classes found.

        Raises:
            ValueError: a replay buffer that is not known.
        """
        # A copy: stable-baselines3 adds to what it is given.
        made = {name: _schedule(value) for name, value in copy.deepcopy(self.arguments).items()}
        buffer = made.get("replay_buffer_class")
        if buffer is not None:
            if buffer not in _BUFFERS:
                raise ValueError(
                    f"replay_buffer_class = {buffer!r}: expected one of {tuple(_BUFFERS)}"
                )
            made["replay_buffer_class"] = _BUFFERS[buffer]
        return made


def _falls(value: Any) -> bool:
    return isinstance(value, str) and value.startswith("lin_")


def _schedule(value: Any) -> Any:
    if _falls(value):
        return LinearSchedule(float(value.removeprefix("lin_")), 0.0, 1.0)
    return value
