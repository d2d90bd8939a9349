"""Agents in the environment: episodes side by side, undisturbed or disturbed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from octoarm_agents.common.whole import whole_fields, whole_number
from octoarm_env import OctoArmVectorEnv

__all__ = ["Acting", "HoldPolicy", "Noise", "Push", "Rollout", "roll_out"]

Float = NDArray[np.float64]


class Acting(Protocol):
    """Anything that acts as a policy of stable-baselines3 does."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        """Give the action and the next state."""


class HoldPolicy:
    """Holds the base still in the middle: what doing nothing earns."""

    parameter_count = 0

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Any]:
        """Give zeros, (2,) or (n, 2)."""
        del episode_start, deterministic
        return np.zeros((*np.shape(observation)[:-1], 2), np.float32), state


@dataclass(frozen=True)
class Push:
    """Somebody leans on the base: for a while its command is another one than the agent's.

    Attributes:
        size: added to the command, in a direction drawn for each episode [degrees].
        begin: first step of it.
        steps: number of steps.
    """

    size: float
    begin: int = 100
    steps: int = 20

    def __post_init__(self) -> None:
        if not 0 <= self.size < float("inf"):
            raise ValueError(f"size = {self.size}: expected a number of degrees, not negative")
        whole_fields(self, begin=0, steps=0)

    @classmethod
    def after_a_second(cls, size: float, control_period: float) -> Push:
        """A push for 0.2 s that begins after 1 s, whatever the seconds of a step."""
        return cls(size, round(1 / control_period), max(1, round(0.2 / control_period)))


@dataclass(frozen=True)
class Noise:
    """The springs are read badly for a while: white noise on every length that the agent sees.

    Attributes:
        size: half width ν of the uniform noise [m].
        begin: first step of it.
        steps: number of steps; None: to the end.
    """

    size: float
    begin: int = 0
    steps: int | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.size < float("inf"):
            raise ValueError(f"size = {self.size}: expected metres, not negative")
        whole_fields(self, begin=0, steps=0)

    def at(self, step: int) -> bool:
        """Whether it is on at a step."""
        return step >= self.begin and (self.steps is None or step < self.begin + self.steps)


@dataclass(frozen=True, eq=False)
class Rollout:
    """Episodes side by side; what comes after the end of one is zero, its `alive` False.

    Attributes:
        rewards: (T, n).
        angles: base angles at the end of each step, (T, n, 2) [degrees].
        errors: distance of the base from its target, (T, n) [degrees].
        alive: whether the episode still ran when the step began, (T, n).
        failed: whether the arm left its domain, (n,).
        lengths: spring lengths that were to be seen when the step began, (T, n, springs) [m], or
            None if they were not asked for.
        actions: what the agent did, (T, n, 2).
    """

    rewards: Float
    angles: Float
    errors: Float
    alive: NDArray[np.bool_]
    failed: NDArray[np.bool_]
    actions: Float
    lengths: Float | None = None

    @property
    def returns(self) -> Float:
        """Sum of rewards of each episode, (n,)."""
        total: Float = self.rewards.sum(axis=0)
        return total


def roll_out(
    policy: Acting,
    envs: OctoArmVectorEnv,
    *,
    seed: int,
    steps: int = 500,
    push: Push | None = None,
    noise: Noise | None = None,
    keep_lengths: bool = False,
) -> Rollout:
    """Let an agent act in as many episodes as there are environments.

    Args:
        policy: acts on all of them at once.
        envs: none of them may truncate before `steps`.
        seed: episode i begins with seed + i; directions and noise are drawn from it too.
        steps: T, control periods.
        push: disturbs the base.
        noise: disturbs what the agent sees.
        keep_lengths: keep the lengths (without noise).

    Returns:
        What happened; the same for a seed, to the bit, on one machine.

    Raises:
        ValueError: fewer than one step, or a seed below 0.
    """
    steps, seed = whole_number("steps", steps, 1), whole_number("seed", seed)
    count = envs.num_envs
    random = np.random.default_rng(seed)
    directions = random.uniform(0, 2 * np.pi, count)
    offsets = np.stack((np.cos(directions), np.sin(directions)), axis=1)
    if push is not None:
        ranges = np.array(envs.get_attr("action_range"))
        offsets *= push.size / ranges[:, np.newaxis]
    rewards, errors = np.zeros((steps, count)), np.zeros((steps, count))
    angles, actions = np.zeros((steps, count, 2)), np.zeros((steps, count, 2))
    alive = np.zeros((steps, count), dtype=bool)
    running, failed = np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
    starts, state = np.ones(count, dtype=bool), None
    observations, _ = envs.reset(seed=seed)
    kept = np.empty((steps, *observations.shape)) if keep_lengths else None
    for step in range(steps):
        if kept is not None:
            kept[step] = observations
        seen = observations
        if noise is not None and noise.at(step):
            seen = observations + noise.size * random.uniform(-1, 1, observations.shape)
        chosen, state = policy.predict(seen, state=state, episode_start=starts)
        starts = np.zeros(count, dtype=bool)
        command = np.asarray(chosen, dtype=np.float32)
        if push is not None and push.begin <= step < push.begin + push.steps:
            command = np.clip(command + offsets, -1, 1).astype(np.float32)
        observations, reward, terminated, _, infos = envs.step(command)
        alive[step], actions[step] = running, chosen
        rewards[step] = np.where(running, reward, 0.0)
        errors[step] = np.where(running, infos["tracking_error"], 0.0)
        angles[step] = np.where(running[:, np.newaxis], infos["base_angles"], 0.0)
        failed |= running & terminated
        running &= ~terminated
    return Rollout(rewards, angles, errors, alive, failed, actions, kept)
