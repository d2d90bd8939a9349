"""What `gym.make("OctoArmReach-v0")` takes, checked and written as the physics reads it."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from octoarm_env import _core
from octoarm_env.arguments import flag, number, whole_number
from octoarm_env.arrays import Float
from octoarm_env.parameters import ArmParameters, plain
from octoarm_env.settings import Settings, body_factors

Point = tuple[float, float, float]


@functools.cache
def reachable_goals() -> Float:
    """Where the tip of the default body has been held by its muscles, (K, 3) [m].

    ``octoarm reach goals`` has sampled them: held activations, drawn at random, five seconds from
    rest; the points are thinned to one in every cube of 12 mm.
    """
    goals = _core.reachable_goals()
    goals.flags.writeable = False
    return goals


@dataclasses.dataclass(frozen=True)
class ReachSettings(Settings):
    """What an episode of reaching is made of: the arguments of `OctoArmReachEnv` under their names.

    Attributes:
        arm: the body.
        control_period: time from one action to the next [s].
        segments: parts along the arm whose muscles act as one.
        max_force: of a fully active muscle at the base [N].
        activation_time: time constant with which the activation follows the action [s].
        distance_threshold: distance from the goal at which it counts as reached [m].
        reward_type: ``"sparse"`` or ``"dense"``.
        observe_rates: whether the agent sees, after the lengths, how fast they have changed.
        goals: what is drawn from, rows (x, y, z) [m]; None: :func:`reachable_goals`.
        length_noise: half width of white noise on the lengths that are seen [m].
        delay: control periods that a reading takes to the agent.
        dropout: springs, drawn at every reset, whose rest length is seen in place of their length.
        vary: factors (low, high) on numbers of the arm, by their names.
        bodies: how many bodies are drawn, one of which is at hand for each episode.
        body_seed: of these bodies.
    """

    arm: ArmParameters = dataclasses.field(default_factory=ArmParameters)
    control_period: float = 0.05
    segments: int = 5
    max_force: float = 1.0
    activation_time: float = 0.1
    distance_threshold: float = 0.02
    reward_type: Literal["sparse", "dense"] = "sparse"
    observe_rates: bool = False
    goals: tuple[Point, ...] | None = None
    length_noise: float = 0.0
    delay: int = 0
    dropout: int = 0
    vary: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict, hash=False)
    bodies: int = 1
    body_seed: int = 0

    @staticmethod
    def _draw(text: str) -> list[str]:
        return _core.drawn_reach_bodies(text)

    def __post_init__(self) -> None:
        """Bring what was given into its plain form.

        Raises:
            ValueError, TypeError: naming the argument, its value and what is allowed. Ranges are
                checked by the physics, when it reads the settings.
        """
        if self.reward_type not in ("sparse", "dense"):
            raise ValueError(f"reward_type = {self.reward_type!r}: expected 'sparse' or 'dense'")
        arm = ArmParameters.of(self.arm)
        plain_form: dict[str, Any] = {
            "arm": arm,
            "segments": whole_number("segments", self.segments, 1, arm.compartments),
            "reward_type": self.reward_type,
            "observe_rates": flag("observe_rates", self.observe_rates),
            "goals": None if self.goals is None else _goals(self.goals, reach_bound(arm)),
            "delay": whole_number("delay", self.delay, 0),
            "dropout": whole_number("dropout", self.dropout, 0),
            "vary": body_factors(self.vary),
            "bodies": whole_number("bodies", self.bodies, 1),
            "body_seed": whole_number("body_seed", self.body_seed, 0, 2**64 - 1),
        }
        for field in dataclasses.fields(self):
            name = field.name
            value = plain_form[name] if name in plain_form else number(name, getattr(self, name))
            object.__setattr__(self, name, value)

    def to_dict(self) -> dict[str, Any]:
        """All settings as JSON can hold them; `from_dict` gives them back."""
        return dataclasses.asdict(self) | {"goals": plain(self.goals), "vary": plain(self.vary)}

    def reward(self, achieved: ArrayLike, desired: ArrayLike) -> Any:
        """Give the reward of a tip for a goal, (3,) both, or (K,) rewards of (K, 3) both."""
        tips = np.asanyarray(achieved)
        rewards = _core.reach_rewards(
            np.atleast_2d(tips),
            np.atleast_2d(desired),
            self.reward_type == "sparse",
            self.distance_threshold,
        )
        return rewards if tips.ndim > 1 else float(rewards[0])

    @property
    def title(self) -> str:
        """Of a picture."""
        return "reaching"

    @functools.cached_property
    def text(self) -> str:
        """The settings as the physics reads them, but for the goals."""
        return json.dumps({key: value for key, value in self.to_dict().items() if key != "goals"})

    @property
    def goal_table(self) -> Float:
        """What goals are drawn from, (G, 3) [m]."""
        return reachable_goals() if self.goals is None else np.array(self.goals)


def reach_bound(arm: ArmParameters) -> float:
    """Give the largest coordinate that any part of the arm can have [m]."""
    return 3.0 * arm.rest_length * arm.compartments


def one_goal(name: str, value: Any, bound: float) -> Point:
    """Give a goal as three numbers."""
    point = plain(value)
    if not isinstance(point, list) or len(point) != 3:
        raise ValueError(f"{name} = {point!r}: expected three numbers, x, y and z [m]")
    entries = [number(f"{name}[{axis}]", each) for axis, each in enumerate(point)]
    for axis, each in enumerate(entries):
        if abs(each) > bound:
            raise ValueError(
                f"{name}[{axis}] = {each} is outside the allowed range [-{bound:g}, {bound:g}] m"
            )
    x, y, z = entries
    return x, y, z


def _goals(value: Any, bound: float) -> tuple[Point, ...]:
    rows = plain(value)
    if not isinstance(rows, list) or not rows:
        raise ValueError(f"goals = {rows!r}: expected an array (G, 3) with at least one row")
    return tuple(one_goal(f"goals[{index}]", row, bound) for index, row in enumerate(rows))


def goal_option(options: dict[str, Any] | None, bound: float, *others: str) -> Point | None:
    """Give the goal among reset options; options other than "goal" and `others` are refused."""
    if options is None:
        return None
    if not isinstance(options, Mapping):
        raise TypeError(f"options must be a mapping, not {type(options).__name__}")
    unknown = sorted(set(options) - {"goal", *others})
    if unknown:
        known = " and ".join(repr(name) for name in ("goal", *others))
        raise ValueError(f"unknown reset options {unknown}; known: {known}")
    return one_goal("options['goal']", options["goal"], bound) if "goal" in options else None
