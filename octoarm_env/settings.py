"""What `gym.make` and `gym.make_vec` take, checked and written as the physics reads it."""

from __future__ import annotations

import copy
import dataclasses
import functools
import json
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Self

import numpy as np
from gymnasium.envs.registration import EnvSpec

from octoarm_env._core import drawn_bodies
from octoarm_env.arguments import actuator_name, number, whole_number
from octoarm_env.parameters import ArmParameters, plain
from octoarm_env.targets import TARGET_NAMES


class MadeOnce:
    """An environment keeps the arguments that it was made with.

    Its `spec` holds them as JSON can, so that an environment is made again from the text of one.
    Pickles and copies go on in a core of their own, where this one stands.
    """

    _core: Any
    """What computes the episodes; saves all that they depend on, and loads it."""

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

    def _new_core(self) -> Any:
        """Make the core from the arguments."""
        raise NotImplementedError

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

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_core": self._core.save()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        episodes = state.pop("_core")
        self.__dict__.update(state)
        self._core = self._new_core()
        self._core.load(episodes)

    def __copy__(self) -> Self:
        """Do as deepcopy does: half a copy would share seeds and past."""
        return copy.deepcopy(self)


class Settings:
    """What the settings of all tasks can do; they are frozen dataclasses."""

    @property
    def text(self) -> str:
        """The settings as the physics reads them."""
        raise NotImplementedError

    def to_dict(self) -> dict[str, Any]:
        """All settings as JSON can hold them; `from_dict` gives them back."""
        raise NotImplementedError

    @staticmethod
    def _draw(text: str) -> list[str]:
        """Give the bodies that settings draw, both as text."""
        raise NotImplementedError

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Self:
        """Read settings; what is left out takes its default.

        Raises:
            ValueError, TypeError: naming what is unknown or cannot be used.
        """
        known = [field.name for field in dataclasses.fields(cls)]  # type: ignore[arg-type]  # each is a dataclass
        unknown = sorted(set(content) - set(known))
        if unknown:
            raise ValueError(f"unknown settings {unknown}; known are {known}")
        return cls(**content)

    @functools.cached_property
    def drawn_bodies(self) -> tuple[ArmParameters, ...]:
        """The bodies that episodes are made with, in the order of ``info["body"]``."""
        return tuple(
            ArmParameters.from_dict(json.loads(each)) for each in type(self)._draw(self.text)
        )


@dataclasses.dataclass(frozen=True)
class EpisodeSettings(Settings):
    """What an episode is made of: the arguments of `OctoArmEnv` under their names.

    Attributes:
        target: name of a limit cycle, or the rows (θ, φ) of one period of another [degrees].
        amplitude: largest angle of the target [degrees]; None: the paper's, or the rows' own.
        control_period: time from one action to the next [s].
        actuator: ``"direct"`` or ``"servo"``.
        arm: the body.
        action_range: base angle of an action of 1 [degrees]; None: 1.3 times the amplitude.
        tracking_weight: reward of an exactly tracked step.
        reward_width: tracking error at which it has fallen to 1/e, as a share of the amplitude.
        action_change_weight: cost of a unit of squared action change.
        length_noise: half width of white noise on the lengths that are seen [m].
        action_noise: half width of white noise on the commanded angles [degrees].
        delay: control periods that a reading takes to the agent.
        dropout: springs, drawn at every reset, whose rest length is seen in place of their length.
        vary: factors (low, high) on numbers of the arm, by their names; those of a body are drawn
            between them.
        bodies: how many bodies are drawn, one of which is at hand for each episode.
        body_seed: of these bodies.
    """

    target: str | tuple[tuple[float, float], ...] = "quadratic"
    amplitude: float | None = None
    control_period: float = 0.01
    actuator: Literal["direct", "servo"] = "direct"
    arm: ArmParameters = dataclasses.field(default_factory=ArmParameters)
    action_range: float | None = None
    tracking_weight: float = 1.0
    reward_width: float = 0.3
    action_change_weight: float = 0.01
    length_noise: float = 0.0
    action_noise: float = 0.0
    delay: int = 0
    dropout: int = 0
    vary: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict, hash=False)
    bodies: int = 1
    body_seed: int = 0

    @staticmethod
    def _draw(text: str) -> list[str]:
        return drawn_bodies(text)

    def __post_init__(self) -> None:
        """Bring what was given into its plain form.

        Raises:
            ValueError, TypeError: naming the argument, its value and what is allowed. Ranges are
                checked by the physics, when it reads the settings.
        """
        plain_form: dict[str, Any] = {
            "target": _target(self.target),
            "actuator": actuator_name(self.actuator),
            "arm": ArmParameters.of(self.arm),
            "delay": whole_number("delay", self.delay, 0),
            "dropout": whole_number("dropout", self.dropout, 0),
            "vary": body_factors(self.vary),
            "bodies": whole_number("bodies", self.bodies, 1),
            "body_seed": whole_number("body_seed", self.body_seed, 0, 2**64 - 1),
        }
        for field in dataclasses.fields(self):
            name, value = field.name, getattr(self, field.name)
            if name in plain_form:
                value = plain_form[name]
            elif value is not None or field.default is not None:
                value = number(name, value)
            object.__setattr__(self, name, value)

    def to_dict(self) -> dict[str, Any]:
        """All settings as JSON can hold them; `from_dict` gives them back."""
        return dataclasses.asdict(self) | {"target": plain(self.target), "vary": plain(self.vary)}

    @property
    def title(self) -> str:
        """Of a picture."""
        return self.target if isinstance(self.target, str) else "own target"

    @functools.cached_property
    def text(self) -> str:
        """The settings as the physics reads them."""
        return json.dumps(self.to_dict())


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


def body_factors(value: Any) -> dict[str, tuple[float, float]]:
    """Give the factors (low, high) on numbers of the arm, by their names."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise TypeError(f"vary must be a mapping from names, not {type(value).__name__}")
    factors = {}
    for name, pair in plain(value).items():
        if not isinstance(pair, list) or len(pair) != 2:
            raise ValueError(f"vary[{name!r}] = {pair!r}: expected two factors, (low, high)")
        low, high = (number(f"vary[{name!r}][{index}]", each) for index, each in enumerate(pair))
        factors[str(name)] = low, high
    return factors


def _target(value: Any) -> str | tuple[tuple[float, float], ...]:
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
    return tuple((theta, phi) for theta, phi in samples.astype(np.float64).tolist())
