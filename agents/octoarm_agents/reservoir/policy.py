"""A linear readout as an agent of the environment ``OctoArm-v0``."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from octoarm_agents.common.environment import (
    ENV_ID,
    SETTINGS,
    check_spaces,
    differences,
    inspect_env,
)
from octoarm_agents.common.whole import whole_number
from octoarm_agents.reservoir.readout import Readout
from octoarm_agents.reservoir.readout_file import load_readout, save_readout
from octoarm_env import ArmParameters, TeacherPolicy

__all__ = ["ReadoutPolicy", "train_policy"]

Env = gym.Env[Any, Any]


class ReadoutPolicy:
    """Acts by a linear readout of the spring lengths; signature of a stable-baselines3 policy.

    It has no clock and no memory: the body alone tells it the phase of the motion. Usually it comes
    from `train_policy` or from its file.

    Args:
        readout: fitted, from the spring lengths [m] to the two entries of the action.
        parameters: the body it was fitted on.
        settings: the environment it was fitted in: `target`, `amplitude` [degrees],
            `control_period` [s], `actuator` and `action_range` [degrees], as in
            `octoarm_env.OctoArmEnv`.
        teaching: how it was fitted, names with plain numbers.
        seed: of the teaching.

    Raises:
        ValueError: a readout that is not fitted, or does not lead from this body's springs to an
            action.
    """

    def __init__(
        self,
        readout: Readout,
        parameters: ArmParameters,
        settings: Mapping[str, Any],
        teaching: Mapping[str, Any] | None = None,
        seed: int | None = None,
    ) -> None:
        if not hasattr(readout, "weights_"):
            raise ValueError("readout is not fitted: expected one after fit")
        found, springs = (readout.n_features_in_, readout.weights_.shape[1]), _springs(parameters)
        if found != (springs, 2):
            raise ValueError(
                f"readout leads from {found[0]} lengths to {found[1]} outputs, "
                f"expected from {springs} to 2"
            )
        if set(settings) != set(SETTINGS):
            raise ValueError(f"settings holds {sorted(settings)}, expected {sorted(SETTINGS)}")
        self.readout = readout
        self.parameters = parameters
        self.settings = dict(settings)
        self.teaching = dict(teaching or {})
        self.seed = seed
        self._weights = readout.weights_[:springs]
        self._bias = readout.weights_[springs:].sum(axis=0)

    @property
    def parameter_count(self) -> int:
        """Weights, the bias's included."""
        return int(self.readout.weights_.size)

    def predict(
        self,
        observation: ArrayLike | dict[str, Any],
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Any]:
        """Act on one observation, or on one of each of n environments.

        Args:
            observation: spring lengths, (springs,) or (n, springs) [m].
            state: given back as it is; the policy has none.
            episode_start: not used.
            deterministic: not used, the policy always is.

        Returns:
            The action, (2,) or (n, 2) float32, clipped to [-1, 1], and the state.

        Raises:
            ValueError: an observation of another shape, or with numbers that are not finite.
        """
        del episode_start, deterministic
        lengths = np.asarray(observation, dtype=np.float64)
        springs = len(self._weights)
        if lengths.ndim not in (1, 2) or lengths.shape[-1] != springs:
            raise ValueError(
                f"observation has shape {lengths.shape}, expected ({springs},) or (n, {springs})"
            )
        outputs = lengths @ self._weights + self._bias
        if not np.isfinite(outputs).all():
            raise ValueError("observation holds numbers that are not finite")
        return np.clip(outputs, -1.0, 1.0).astype(np.float32), state

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the policy to a JSON file, see `octoarm_agents.reservoir.save_readout`.

        Raises:
            OSError: the folder cannot be written to.
        """
        protocol = {"id": ENV_ID, "environment": self.settings, "teaching": self.teaching}
        save_readout(
            path, self.readout, parameters=self.parameters, protocol=protocol, seed=self.seed
        )

    @classmethod
    def load(cls, path: str | os.PathLike[str], env: Env | None = None) -> ReadoutPolicy:
        """Read a policy from its file.

        Args:
            path: the file.
            env: the environment it is to act in, however wrapped; None: whatever it was fitted in.

        Raises:
            ValueError: as `octoarm_agents.reservoir.load_readout`, a file that holds no policy, or
                one that was fitted in another environment than `env`; the message names the
                settings that differ, with both values. Rewards may differ.
            TypeError: `env` is not an ``OctoArm-v0`` environment.
            OSError: the file cannot be read.
        """
        used = None if env is None else inspect_env(env)
        saved = load_readout(path, parameters=None if used is None else used[0])
        settings = saved.protocol.get("environment")
        teaching = saved.protocol.get("teaching")
        if saved.protocol.get("id") != ENV_ID or not isinstance(settings, dict):
            raise ValueError(f"{path} holds a readout, but not a policy for {ENV_ID}")
        try:
            if not isinstance(teaching, dict):
                raise ValueError("teaching is missing")
            policy = cls(saved.readout, saved.parameters, settings, teaching, saved.seed)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
        if used is not None:
            found = differences(settings, used[1])
            if found:
                raise ValueError(f"{path} is for another environment: {found}")
        return policy


def train_policy(
    env: Env | Mapping[str, Any] | None = None,
    *,
    steps: int = 3500,
    action_noise: float = 0.01,
    noise: float = 1e-8,
    seed: int = 0,
    readout: Readout | None = None,
) -> ReadoutPolicy:
    """Teach a readout to do what the lead-compensated clock does, from the lengths alone.

    The clock's actions are followed with noise, so that the readout sees the body beside its orbit
    too: taught on the orbit alone it fits perfectly and may still be unstable in the loop. Its
    labels are the clock's actions without the noise.

    Args:
        env: an ``OctoArm-v0`` environment, however wrapped, as long as its observations are the
            lengths and its actions the fractions of `action_range`; it is reset with `seed` and
            whenever an episode ends, and left in the middle of one. Or the keyword arguments of
            ``gym.make("OctoArm-v0")``; None: its defaults.
        steps: control periods to learn from, at least one for each spring.
        action_noise: half width of the uniform noise on the actions, 0 to 1.
        noise: ν, half width of the noise on the lengths that the fit allows for [m], see `Readout`.
        seed: of the environment and of the noise on the actions.
        readout: fit this one instead of ``Readout("noise", noise=noise)``; it is fitted in place.

    Returns:
        The policy, with the environment's settings.

    Raises:
        ValueError: an argument outside its range, or an environment wrapped otherwise.
        TypeError: not an ``OctoArm-v0`` environment.
    """
    if isinstance(env, gym.Env):
        return _teach(env, steps, action_noise, noise, seed, readout)
    if not (env is None or isinstance(env, Mapping)):
        raise TypeError(
            "env must be an OctoArm-v0 environment or the arguments to make one, "
            f"not {type(env).__name__}"
        )
    own = gym.make(ENV_ID, **(env or {}))
    try:
        return _teach(own, steps, action_noise, noise, seed, readout)
    finally:
        own.close()


def _teach(
    env: Env,
    steps: int,
    action_noise: float,
    noise: float,
    seed: int,
    readout: Readout | None,
) -> ReadoutPolicy:
    parameters, settings = inspect_env(env)
    check_spaces(env)
    springs = _springs(parameters)
    # At least one for each spring.
    steps, seed = whole_number("steps", steps, springs), whole_number("seed", seed)
    if not 0 <= action_noise <= 1:
        raise ValueError(f"action_noise = {action_noise}: expected a number from 0 to 1")
    teaching: dict[str, Any] = {"steps": steps, "action_noise": action_noise}
    if readout is None:
        teaching["noise"] = noise
        readout = Readout("noise", noise=noise)
    readout.check_parameters()

    teacher, random = TeacherPolicy(env), np.random.default_rng(seed)
    observation, _ = env.reset(seed=seed)
    lengths, actions = np.empty((steps, springs)), np.empty((steps, 2))
    for step in range(steps):
        lengths[step] = observation
        actions[step], _ = teacher.predict()
        noisy = actions[step] + action_noise * random.uniform(-1, 1, 2)
        observation, _, terminated, truncated, _ = env.step(
            np.clip(noisy, -1.0, 1.0).astype(np.float32)
        )
        if terminated or truncated:
            observation, _ = env.reset()
    readout.fit(lengths, actions)
    return ReadoutPolicy(readout, parameters, settings, teaching, seed)


def _springs(parameters: ArmParameters) -> int:
    return 4 * parameters.compartments
