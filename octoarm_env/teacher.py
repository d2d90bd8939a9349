"""The clock that knows the target: teacher of the readout, and upper bound of the return."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray


class TeacherPolicy:
    """The lead-compensated clock: reads the environment's time, sees no springs.

    A servo lags its command, so commanding the target itself would miss it. The teacher commands
    what brings an undisturbed base exactly onto the target at the end of every control period; with
    a `direct` base that is the target itself. It earns all that can be earned while nothing
    disturbs the base.

    Args:
        env: an ``OctoArm-v0`` environment, however wrapped, or a vector environment of them.
    """

    def __init__(self, env: gym.Env[Any, Any] | gym.vector.VectorEnv[Any, Any, Any]) -> None:
        self._env = env
        vector = isinstance(env, gym.vector.VectorEnv)
        if not (vector or hasattr(env.unwrapped, "teacher_action")):
            raise TypeError(f"env must be an OctoArm-v0 environment, not {env.unwrapped}")

    def predict(
        self,
        observation: Any = None,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Any]:
        """Give the action for the present instant; signature of a stable-baselines3 policy.

        Returns:
            The action, (2,) or (num_envs, 2) float32 in [-1, 1], and the state unchanged.
        """
        del observation, episode_start, deterministic
        env: Any = self._env.unwrapped
        vector = isinstance(env, gym.vector.VectorEnv)
        actions = env.call("teacher_action") if vector else env.teacher_action()
        return np.asarray(actions, dtype=np.float32), state
