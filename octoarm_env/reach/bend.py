"""The octopus's way of reaching: a bend that travels from the base of the arm to its tip.

A wave of muscles that all contract at once stiffens the arm from the base on, and pushes the bend
before it (Gutfreund et al. 1996, J. Neurosci. 16, 7297; Yekutieli et al. 2005, J. Neurophysiol. 94,
1443, whose command is such a wave of constant speed).
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from octoarm_env.arguments import number, positive
from octoarm_env.arrays import Float


def bend_wave(
    time: ArrayLike,
    segments: int,
    length: float,
    *,
    side: ArrayLike = 0.0,
    speed: float = 0.3,
    width: float = 0.03,
    beyond: float = 0.0,
) -> Float:
    """Give the activations of an arm in which the wave set out so long ago.

    Before it the muscles of one side alone are active, and bend the arm; behind it all are.

    Args:
        time: since the wave set out at the base, any shape [s]; below 0, the arm is bent and waits.
        segments: of the arm.
        length: of the arm [m].
        side: to which it is bent, broadcast with `time` [rad]: 0 is +x, π/2 is +y.
        speed: of the wave [m/s].
        width: in which the muscles become active [m].
        beyond: how far the activations are continued below 0 and above 1 before they are cut, for a
            readout that learns them as a straight line.

    Returns:
        Shape of `time` + (segments, 5), in [-beyond, 1 + beyond].
    """
    times, sides = np.broadcast_arrays(np.asarray(time, float), np.asarray(side, float))
    places = (np.arange(segments) + 0.5) * length / segments
    behind = (speed * times[..., np.newaxis] - places) / width
    behind = np.clip(behind, -beyond, 1.0 + beyond)[..., np.newaxis]
    quarters = np.arange(4) * np.pi / 2
    bent = np.clip(np.cos(sides[..., np.newaxis] - quarters), 0.0, 1.0)[..., np.newaxis, :]
    bent = np.where(bent < 1e-12, 0.0, bent)  # what rounding leaves of the cosine of a right angle
    bent = np.broadcast_to(bent, (*times.shape, segments, 4))
    along = np.where(bent > 0, np.maximum(bent, behind), behind)
    waves: Float = np.concatenate((along, np.broadcast_to(behind, (*along.shape[:-1], 1))), axis=-1)
    return waves


class BendPropagation:
    """The scripted wave: bends the arm towards the side of the goal, then lets the bend travel.

    It knows the time and the goal's direction, and nothing of the arm; signature of a
    stable-baselines3 policy.

    Args:
        env: an ``OctoArmReach-v0`` environment, however wrapped, or a vector environment of them.
        start: time at which the wave sets out [s].
        speed, width: of the wave, as in :func:`bend_wave` [m/s, m].

    Raises:
        TypeError: another environment.
        ValueError: a number out of range.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any] | gym.vector.VectorEnv[Any, Any, Any],
        *,
        start: float = 2.0,
        speed: float = 0.3,
        width: float = 0.03,
    ) -> None:
        own: Any = env.unwrapped
        if not hasattr(own, "compute_reward"):
            raise TypeError(f"env must be an OctoArmReach-v0 environment, not {own}")
        self._env = own
        self._start = number("start", start)
        self._speed, self._width = positive("speed", speed), positive("width", width)

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Any]:
        """Give the action for the present instant.

        Args:
            observation: of the environment, of which the desired goal is used.
            state: given back.
            episode_start: not used.
            deterministic: not used.

        Returns:
            The action, (5 * segments,) or (num_envs, 5 * segments) float32 in [0, 1], and `state`.
        """
        del episode_start, deterministic
        env, settings = self._env, self._env.settings
        vector = isinstance(env, gym.vector.VectorEnv)
        time = np.array(env.get_attr("time")) if vector else np.array(env.time)
        goal = np.asarray(observation["desired_goal"])
        wave = bend_wave(
            time - self._start,
            settings.segments,
            settings.arm.rest_length * settings.arm.compartments,
            side=np.arctan2(goal[..., 1], goal[..., 0]),
            speed=self._speed,
            width=self._width,
        )
        return wave.reshape(*time.shape, -1).astype(np.float32), state
