"""What `gym.make` and `gym.make_vec` take, checked and written as the physics reads it."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from gymnasium.envs.registration import EnvSpec

from octoarm_env.arguments import actuator_name, number
from octoarm_env.parameters import ArmParameters, plain
from octoarm_env.targets import TARGET_NAMES

__all__ = ["MadeOnce", "episode_settings", "phase_option"]


class MadeOnce:
    """An environment keeps the arguments that it was made with.

    Its `spec` holds them as JSON can, so that an environment is made again from the text of one.
    """

    _fixed: ClassVar[frozenset[str]] = frozenset()
    """Names of the arguments. Where a class below declares one of them, it may be set."""
    _remedy: ClassVar[str] = ""
    """How another environment is made, with {} for an argument."""
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """What the environment was made of, as `gym.make` or `gym.make_vec` takes it, or None."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = spec and self._kept(spec)

    def _kept(self, spec: EnvSpec) -> EnvSpec:
        """Give the spec that is kept of a given one."""
        return dataclasses.replace(spec, kwargs=plain(spec.kwargs))

    def __setattr__(self, name: str, value: Any) -> None:
        # The constructor keeps some arguments as attributes, before it makes the core.
        if "_core" in self.__dict__ and value is not self.__dict__.get(name, self):
            self._check_free(name)
        super().__setattr__(name, value)

    def _check_free(self, name: str) -> None:
        """Raise an AttributeError for an argument, unless a class below declares its name."""
        for kind in type(self).__mro__ if name in self._fixed else ():
            if "_fixed" in vars(kind):
                raise AttributeError(
                    f"{name} of an environment cannot be changed once it is made: make another "
                    f"one with {self._remedy.format(name)}"
                )
            if name in vars(kind):
                return


def episode_settings(
    target: Any,
    amplitude: Any,
    control_period: Any,
    actuator: Any,
    arm: Any,
    action_range: Any,
    tracking_weight: Any,
    reward_width: Any,
    action_change_weight: Any,
) -> str:
    """Give the settings of one environment as JSON text.

    Raises:
        ValueError, TypeError: naming the argument, its value and what is allowed. Ranges are
            checked by the physics, when it reads the text.
    """
    return json.dumps(
        {
            "target": _target(target),
            "amplitude": None if amplitude is None else number("amplitude", amplitude),
            "control_period": number("control_period", control_period),
            "actuator": actuator_name(actuator),
            "arm": ArmParameters.of(arm).to_dict(),
            "action_range": None if action_range is None else number("action_range", action_range),
            "tracking_weight": number("tracking_weight", tracking_weight),
            "reward_width": number("reward_width", reward_width),
            "action_change_weight": number("action_change_weight", action_change_weight),
        }
    )


def phase_option(options: dict[str, Any] | None, *others: str) -> float | None:
    """Give the phase among reset options; options other than "phase" and `others` are refused."""
    if options is None:
        return None
    if not isinstance(options, Mapping):
        raise TypeError(f"options must be a mapping, not {type(options).__name__}")
    unknown = sorted(set(options) - {"phase", *others})
    if unknown:
        known = " and ".join(repr(name) for name in ("phase", *others))
        verb = "are" if others else "is"
        raise ValueError(f"unknown reset options {unknown}; known {verb} {known}")
    if "phase" not in options:
        return None
    return number("options['phase']", options["phase"])


def _target(value: Any) -> str | list[list[float]]:
    if isinstance(value, str):
        if value not in TARGET_NAMES:
            raise ValueError(
                f"target = {value!r}: expected one of {TARGET_NAMES} or an array (T, 2)"
            )
        return value
    samples = np.asarray(plain(value))
    if samples.dtype.kind not in "fiu":
        raise TypeError(f"target must be a name or an array of numbers, not dtype {samples.dtype}")
    if samples.ndim != 2 or samples.shape[1] != 2:
        raise ValueError(f"target has shape {samples.shape}, expected (T, 2)")
    if np.ma.is_masked(value):
        raise TypeError("target must be an array of numbers, not one with masked entries")
    if not np.isfinite(samples).all():
        raise ValueError("target holds numbers that are not finite")
    rows: list[list[float]] = samples.astype(np.float64).tolist()
    return rows
