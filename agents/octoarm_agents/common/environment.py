"""The environment that an agent belongs to: read from one, compared with one, made again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from octoarm_env import LIMIT_CYCLES, ArmParameters, OctoArmEnv, OctoArmVectorEnv

Env = gym.Env[Any, Any]

ENV_ID = "OctoArm-v0"

SETTINGS = ("target", "amplitude", "control_period", "actuator", "action_range")
"""Arguments of the environment that an agent depends on, beside the body; rewards may differ."""

TARGETS: tuple[str, ...] = tuple(LIMIT_CYCLES)
"""The targets that agents are trained and compared on."""


def inspect_env(env: Env) -> tuple[ArmParameters, dict[str, Any]]:
    """Give an environment's body and `SETTINGS`; amplitude and action range as they really are.

    Args:
        env: an ``OctoArm-v0`` environment, however wrapped.

    Raises:
        TypeError: another environment.
    """
    arm_env = env.unwrapped if isinstance(env, gym.Env) else env
    if not isinstance(arm_env, OctoArmEnv):
        raise TypeError(f"env must be an {ENV_ID} environment, not {arm_env}")
    actual = {"amplitude": arm_env.amplitude, "action_range": arm_env.action_range}
    settings = arm_env.settings.to_dict() | actual
    return arm_env.settings.arm, {name: settings[name] for name in SETTINGS}


def check_spaces(env: Env) -> None:
    """Raise a ValueError if wrappers make of lengths and actions something else."""
    bare = env.unwrapped
    if env.observation_space != bare.observation_space:
        raise ValueError(
            f"env has observations {env.observation_space}, expected the spring lengths "
            f"themselves, {bare.observation_space}"
        )
    # ClipAction takes any number and changes none that is allowed.
    any_number = gym.spaces.Box(-np.inf, np.inf, (2,))
    if env.action_space not in (bare.action_space, any_number):
        raise ValueError(f"env has actions {env.action_space}, expected {bare.action_space}")


#: What every body was before these parameters existed.
_FORMERLY = {"base_coupling": "inertial", "longitudinal_mass_share": 1.0}


def decode_body(entries: dict[str, Any]) -> ArmParameters:
    """Give the body that a file describes.

    Raises:
        ValueError: a parameter is missing, unknown or out of its range.
    """
    entries = _FORMERLY | entries
    # A parameter left out would silently take its default of today.
    missing = [field.name for field in fields(ArmParameters) if field.name not in entries]
    if missing:
        raise ValueError(f"body lacks {missing}")
    try:
        return ArmParameters.from_dict(entries)
    except (TypeError, ValueError) as error:
        raise ValueError(f"body: {error}") from None


def differences(saved: Mapping[str, Any], used: Mapping[str, Any]) -> str:
    """What differs between the settings in a file and those in use; empty if nothing does."""
    return "; ".join(
        f"{name} is {_short(value)} in the file and {_short(used[name])} where it is to be used"
        for name, value in saved.items()
        if value != used[name]
    )


def make_vector_env(
    num_envs: int,
    parameters: ArmParameters,
    settings: Mapping[str, Any],
    *,
    steps: int,
    threads: int | None = None,
) -> OctoArmVectorEnv:
    """Make the environments that an agent with these settings is at home in.

    Args:
        num_envs: how many.
        parameters: the body of all.
        settings: `SETTINGS` and their values.
        steps: after which an episode is truncated.
        threads: that share a step; None: as many as the processor runs at once.
    """
    return OctoArmVectorEnv(
        num_envs,
        **settings,
        arm=parameters,
        max_episode_steps=steps,
        autoreset_mode=AutoresetMode.NEXT_STEP,
        threads=threads,
    )


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 100 else f"{text[:100]} …"
