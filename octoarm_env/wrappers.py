"""Observations in the units that networks like."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from octoarm_env.arguments import positive
from octoarm_env.arrays import Float32

__all__ = ["Strain", "VectorStrain"]

Env = gym.Env[Any, Any]
VectorEnv = gym.vector.VectorEnv[Any, Any, Any]
if TYPE_CHECKING:
    _VectorWrapper = gym.vector.VectorWrapper[Any, Any, Any, Any, Any]
else:  # older Gymnasiums give it no parameters
    _VectorWrapper = gym.vector.VectorWrapper

_LONGEST = 3.0
"""Upper bound of an observation, in rest lengths l_0."""


class Strain(gym.ObservationWrapper[Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Spring lengths l as strains, ``scale * (l / l_0 - 1)``, of order 1 where lengths are 0.02 m.

    Lengths in metres differ by a few parts in a hundred of a small number: a network that is given
    them as they are learns nothing.

    Args:
        env: an ``OctoArm-v0`` or ``OctoArmRemote-v0`` environment, however wrapped, whose
            observations are still the lengths; or a vector environment of them, for which this
            makes a :class:`VectorStrain`.
        scale: factor, above 0; the default gives strains in percent.

    Observations are float32, (80,), between ``-0.95 * scale`` and ``2 * scale``.

    Raises:
        TypeError: observations that are not spring lengths.
        ValueError: a scale that is not a positive number.
    """

    def __new__(cls, env: Env | VectorEnv | None = None, scale: float = 100.0) -> Any:
        """Make the wrapper that `env` needs."""
        if isinstance(env, gym.vector.VectorEnv):
            return VectorStrain(env, scale)
        return super().__new__(cls)

    def __init__(self, env: Env, scale: float = 100.0) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, scale=scale)
        gym.ObservationWrapper.__init__(self, env)
        self._scale = positive("scale", scale)
        self._rest = _rest_length(env.observation_space)
        self.observation_space = _strains(env.observation_space, self._scale)

    def observation(self, observation: Any) -> Float32:
        """Turn lengths [m] into strains."""
        return _strain(observation, self._rest, self._scale)


class VectorStrain(_VectorWrapper):
    """The :class:`Strain` of every environment of a vector environment, each with its own l_0.

    Args:
        env: a vector environment of ``OctoArm-v0`` whose observations are still the lengths. In the
            autoreset mode SAME_STEP the last observations in the infos, ``final_obs``, are strains
            too.
        scale: as :class:`Strain` takes it, with the same errors.

    Observations are float32, (N, 80).
    """

    def __init__(self, env: VectorEnv, scale: float = 100.0) -> None:
        super().__init__(env)
        self._scale = positive("scale", scale)
        self._rest = _rest_length(env.observation_space)
        self.single_observation_space = _strains(env.single_observation_space, self._scale)
        self.observation_space = gym.vector.utils.batch_space(
            self.single_observation_space, env.num_envs
        )

    @property
    def autoreset_mode(self) -> gym.vector.AutoresetMode:
        """What happens when an episode has ended, as torchrl asks for it."""
        mode: gym.vector.AutoresetMode = self.metadata["autoreset_mode"]
        return mode

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Float32, dict[str, Any]]:
        """Begin episodes, as the environment inside does it."""
        lengths, infos = self.env.reset(seed=seed, options=options)
        return _strain(lengths, self._rest, self._scale), infos

    def step(self, actions: Any) -> tuple[Float32, Any, Any, Any, dict[str, Any]]:
        """Step, as the environment inside does it."""
        lengths, *others, infos = self.env.step(actions)
        if "final_obs" in infos:
            last = infos["final_obs"]
            for index in np.flatnonzero(infos["_final_obs"]):
                last[index] = _strain(last[index], self._rest[index], self._scale)
        return _strain(lengths, self._rest, self._scale), *others, infos


def _strain(lengths: Any, rest: NDArray[np.float64], scale: float) -> Float32:
    return np.asarray(scale * (lengths / rest - 1), dtype=np.float32)


def _strains(lengths: gym.Space[Any], scale: float) -> spaces.Box:
    """The strains that lengths within their bounds can have, the same for every rest length."""
    low, high = np.float32(scale * (0.05 - 1)), np.float32(scale * (_LONGEST - 1))
    return spaces.Box(low, high, lengths.shape, np.float32)


def _rest_length(lengths: gym.Space[Any]) -> NDArray[np.float64]:
    """l_0 [m] of every length in a space: its upper bound is three of it."""
    if not isinstance(lengths, spaces.Box) or lengths.dtype != np.float64:
        raise TypeError(f"env has observations {lengths}, expected spring lengths, float64")
    if not np.isclose(lengths.high, 60 * lengths.low, rtol=1e-9, atol=0).all():
        raise TypeError(f"env has observations {lengths}, expected spring lengths in metres")
    return np.asarray(lengths.high, dtype=np.float64) / _LONGEST
