"""Policies in the environment: episodes side by side, undisturbed or disturbed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from octoarm_agents.common.whole import whole_fields, whole_number
from octoarm_env import OctoArmVectorEnv
from octoarm_env.arrays import Float


class PolicyPredictor(Protocol):
    """Anything that acts as a policy of stable-baselines3 does, which has the same word for it."""

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

    @property
    def held(self) -> Float:
        """The action, (2,)."""
        return np.zeros(2)

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Any]:
        """Give the action that is held, (2,) or (n, 2)."""
        del episode_start, deterministic
        return np.full((*np.shape(observation)[:-1], 2), self.held, np.float32), state


class RandomPolicy:
    """Draws every action anew, from all that are allowed alike.

    Args:
        seed: of what is drawn.
    """

    def __init__(self, seed: int) -> None:
        # Not the generator of pushes and noise, which begins with the bare seed.
        self._random = np.random.default_rng([seed, 1])

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Any]:
        """Draw an action, (2,) or (n, 2)."""
        del episode_start, deterministic
        actions = self._random.uniform(-1, 1, (*np.shape(observation)[:-1], 2))
        return actions.astype(np.float32), state


@dataclass(frozen=True)
class Push:
    """Somebody leans on the base: for a while its command is another one than the policy's.

    Attributes:
        size: added to the command, in a direction drawn for each episode [degrees].
        begin: first step of it.
        steps: number of steps.
        white: whether the base is shaken instead: both entries of the command get white noise of
            this half width, as the paper's bursts ε (section 3.2).
    """

    size: float
    begin: int = 100
    steps: int = 20
    white: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.size < float("inf"):
            raise ValueError(f"size = {self.size}: expected a number of degrees, not negative")
        whole_fields(self, begin=0, steps=0)

    def at(self, step: int) -> bool:
        """Whether the base is pushed in a step."""
        return self.begin <= step < self.begin + self.steps

    @classmethod
    def after_a_second(cls, size: float, control_period: float) -> Push:
        """A push for 0.2 s that begins after 1 s, whatever the seconds of a step."""
        return cls(size, round(1 / control_period), max(1, round(0.2 / control_period)))


@dataclass(frozen=True)
class Noise:
    """The springs are read badly for a while: white noise on every length that the policy sees.

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
        actions: what the policy did, (T, n, 2).
    """

    rewards: Float
    angles: Float
    errors: Float
    alive: NDArray[np.bool_]
    failed: NDArray[np.bool_]
    actions: Float

    @property
    def returns(self) -> Float:
        """Sum of rewards of each episode, (n,)."""
        total: Float = self.rewards.sum(axis=0)
        return total


class Episodes:
    """Episodes side by side, one step after the other; one of them is as good as many.

    Args:
        policy: acts on all of them at once.
        envs: an environment for each; none of them may truncate before `steps`. They are reset.
        seed: episode i begins with seed + i; directions and noise are drawn from it too.
        steps: T, control periods.
        push: disturbs the base.
        noise: disturbs what the policy sees.

    Attributes:
        steps_made: so far.
        lengths: of the springs now, without noise, (n, springs) [m].
        infos: of the last step, or of the reset.
        rollout: what happened so far; what is still to come is zero.

    Raises:
        ValueError: fewer than one step, or a seed below 0.
    """

    def __init__(
        self,
        policy: PolicyPredictor,
        envs: OctoArmVectorEnv,
        *,
        seed: int,
        steps: int,
        push: Push | None = None,
        noise: Noise | None = None,
    ) -> None:
        self.steps, self.seed = whole_number("steps", steps, 1), whole_number("seed", seed)
        self.envs, self.push, self.noise = envs, push, noise
        self._policy, self._state = policy, None
        count, shape = envs.num_envs, (self.steps, envs.num_envs)
        self._random = np.random.default_rng(seed)
        directions = self._random.uniform(0, 2 * np.pi, count)
        self._offsets = np.stack((np.cos(directions), np.sin(directions)), axis=1)
        if push is not None:
            self._reach = push.size / np.array(envs.get_attr("action_range"))[:, np.newaxis]
            self._offsets *= self._reach
        self._running = np.ones(count, dtype=bool)
        self.rollout = Rollout(
            rewards=np.zeros(shape),
            angles=np.zeros((*shape, 2)),
            errors=np.zeros(shape),
            alive=np.zeros(shape, dtype=bool),
            failed=np.zeros(count, dtype=bool),
            actions=np.zeros((*shape, 2)),
        )
        self.steps_made = 0
        self.lengths, self.infos = envs.reset(seed=seed)

    def step(self) -> NDArray[np.float32]:
        """Let the policy act once; give what the bases were told, pushes included, (n, 2)."""
        step, seen, done = self.steps_made, self.lengths, self.rollout
        if self.noise is not None and self.noise.at(step):
            seen = seen + self.noise.size * self._random.uniform(-1, 1, seen.shape)
        starts = np.full(len(seen), step == 0)
        chosen, self._state = self._policy.predict(seen, state=self._state, episode_start=starts)
        command = np.asarray(chosen, dtype=np.float32)
        if self.push is not None and self.push.at(step):
            if self.push.white:
                self._offsets = self._reach * self._random.uniform(-1, 1, command.shape)
            command = np.clip(command + self._offsets, -1, 1).astype(np.float32)
        running = self._running
        self.lengths, rewards, terminated, _, self.infos = self.envs.step(command)
        done.alive[step], done.actions[step] = running, chosen
        done.rewards[step] = np.where(running, rewards, 0.0)
        done.errors[step] = np.where(running, self.infos["tracking_error"], 0.0)
        angles = self.infos["base_angles"]
        done.angles[step] = np.where(running[:, np.newaxis], angles, 0.0)
        done.failed[running & terminated] = True
        self._running = running & ~terminated
        self.steps_made += 1
        return command


def roll_out(
    policy: PolicyPredictor,
    envs: OctoArmVectorEnv,
    *,
    seed: int,
    steps: int = 500,
    push: Push | None = None,
    noise: Noise | None = None,
) -> Rollout:
    """Let a policy act in as many episodes as there are environments.

    Args:
        policy: acts on all of them at once.
        envs: none of them may truncate before `steps`.
        seed: episode i begins with seed + i; directions and noise are drawn from it too.
        steps: T, control periods.
        push: disturbs the base.
        noise: disturbs what the policy sees.

    Returns:
        What happened; the same for a seed, to the bit, on one machine.

    Raises:
        ValueError: fewer than one step, or a seed below 0.
    """
    episodes = Episodes(policy, envs, seed=seed, steps=steps, push=push, noise=noise)
    for _ in range(episodes.steps):
        episodes.step()
    return episodes.rollout
