"""A policy: what acts, the body and the environment that it belongs to, and how it came about."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from octoarm_agents.common.environment import (
    SETTINGS,
    check_spaces,
    decode_body,
    differences,
    inspect_env,
)
from octoarm_agents.policies.network import Network
from octoarm_agents.policies.policy_file import read_policy_file, write_policy_file
from octoarm_env import ArmParameters


@dataclass(eq=False, repr=False)
class Policy:
    """Acts by a readout or a trained network; signature of a stable-baselines3 policy.

    Args:
        network: from the spring lengths to the action.
        algorithm: what trained it: ``"ppo"``, …, ``"readout"``.
        parameters: the body it was trained on.
        settings: the environment it was trained in: `target`, `amplitude` [degrees],
            `control_period` [s], `actuator` and `action_range` [degrees], as in
            `octoarm_env.OctoArmEnv`.
        training: how it was trained, names with plain numbers and texts.
        seed: of the training.

    Raises:
        ValueError: a network for another number of springs, or settings that are not these.
    """

    network: Network
    algorithm: str
    parameters: ArmParameters
    settings: dict[str, Any]
    training: dict[str, Any] = field(default_factory=dict)
    seed: int | None = None

    def __post_init__(self) -> None:
        self.settings, self.training = dict(self.settings), dict(self.training)
        springs = 4 * self.parameters.compartments
        if self.network.springs != springs:
            raise ValueError(
                f"network takes {self.network.springs} lengths, the body has {springs} springs"
            )
        if self.network.outputs != 2:
            raise ValueError(f"layers lead to {self.network.outputs} outputs, expected 2")
        if set(self.settings) != set(SETTINGS):
            raise ValueError(f"settings holds {sorted(self.settings)}, expected {sorted(SETTINGS)}")

    @property
    def parameter_count(self) -> int:
        """Trained numbers that the action depends on."""
        return self.network.parameter_count

    def predict(
        self,
        observation: ArrayLike | dict[str, Any],
        state: Any = None,
        episode_start: ArrayLike | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Any]:
        """Act on one observation, or on one of each of n environments.

        Args:
            observation: spring lengths, (springs,) or (n, springs) [m].
            state: the memory that the last call gave back; None: an episode begins. Policies
                without memory give it back as it is.
            episode_start: which episodes begin now, (n,) bool; their memory is emptied.
            deterministic: not used, the policy always is.

        Returns:
            The action, (2,) or (n, 2) float32 in [-1, 1], and the state.

        Raises:
            ValueError: an observation of another shape, or with numbers that are not finite.
        """
        del deterministic
        lengths = np.asarray(observation, dtype=np.float64)
        springs = self.network.springs
        if lengths.ndim not in (1, 2) or lengths.shape[-1] != springs:
            raise ValueError(
                f"observation has shape {lengths.shape}, expected ({springs},) or (n, {springs})"
            )
        if not np.isfinite(lengths).all():
            raise ValueError("observation holds numbers that are not finite")
        if self.network.memory is not None and state is not None and episode_start is not None:
            going_on = 1 - np.asarray(episode_start, dtype=np.float32).reshape(-1, 1)
            state = tuple(each * going_on for each in state)
        actions, state = self.network.actions(np.atleast_2d(lengths), state)
        return (actions if lengths.ndim == 2 else actions[0]), state

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the policy to a file (.npz), which appears whole or not at all.

        Raises:
            ValueError: another ending, or training or settings that JSON cannot hold.
            OSError: the folder cannot be written to.
        """
        header = {
            "algorithm": self.algorithm,
            "seed": self.seed,
            "environment": self.settings,
            "training": self.training,
            "network": self.network.describe(),
            "body": self.parameters.to_dict(),
        }
        write_policy_file(Path(path), header, self.network.arrays())

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        env: gym.Env[Any, Any] | None = None,
        *,
        settings: Mapping[str, Any] | None = None,
    ) -> Policy:
        """Read a policy, a readout or a network, from its file.

        Args:
            path: the file.
            env: the environment it is to act in, however wrapped; None: whatever it was trained in.
                Rewards may differ.
            settings: or some of that environment's settings, by name.

        Raises:
            ValueError: a file that is damaged, of another kind, version or observation layout, or
                a policy of another environment or body; the message names the file and what
                differs, with both values.
            TypeError: `env` is not an ``OctoArm-v0`` environment.
            OSError: the file cannot be read.
        """
        try:
            header, arrays = read_policy_file(Path(path))
            policy = cls(
                Network.restore(header["network"], arrays),
                header["algorithm"],
                decode_body(header["body"]),
                header["environment"],
                header["training"],
                header["seed"],
            )
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
        used = dict(settings or {})
        if env is not None:
            check_spaces(env)
            parameters, its_settings = inspect_env(env)
            found = differences(policy.parameters.to_dict(), parameters.to_dict())
            if found:
                raise ValueError(f"{path} is for another body: {found}")
            used = its_settings | used
        found = differences({name: policy.settings[name] for name in used}, used)
        if found:
            raise ValueError(f"{path} is for another environment: {found}")
        return policy
