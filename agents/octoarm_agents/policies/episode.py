"""One episode, step by step: what `rollout.roll_out` does, for whoever wants to look on."""

from __future__ import annotations

from typing import Any, cast

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from octoarm_agents.common.environment import inspect_env
from octoarm_agents.common.whole import whole_number
from octoarm_agents.policies.evaluation import Trivial, acting
from octoarm_agents.policies.measures import orbit_measures, tracking_measures
from octoarm_agents.policies.rollout import Acting, Noise, Push, Rollout
from octoarm_env import OctoArmEnv

__all__ = ["Episode"]

Float = NDArray[np.float64]


class Episode:
    """An agent in one environment.

    Course and rewards are those of ``roll_out(policy, envs, seed=seed, …)`` in a single
    environment, to the bit; the direction of the push and the noise are drawn as there.

    Args:
        policy: the agent, or ``"hold"`` or ``"clock"``.
        env: in which `steps` are allowed; it is reset.
        seed: of the episode.
        steps: that it lasts.
        push: size of the push [degrees]; 0: none.
        noise: half width of the noise on the lengths that the agent sees [m]; 0: none.

    Attributes:
        arm_env: the environment without its wrappers.
        parameters: the body.
        settings: the environment's, `octoarm_agents.common.environment.SETTINGS`.
        period: seconds of a step.
        lengths: of the springs now, without noise, (4 N,) [m].
        info: of the last step, or of the reset.
        reward: of the last step, 0 before the first.
        earned: sum of the rewards.
        action: what the agent did last, (2,); before the first step zeros.
        command: what the base was told, the push included, (2,) [degrees]; before the first step
            the base angles.
        failure: why the arm left its domain; empty as long as it did not.
    """

    def __init__(
        self,
        policy: Acting | Trivial,
        env: gym.Env[Any, Any],
        *,
        seed: int,
        steps: int,
        push: float = 0.0,
        noise: float = 0.0,
    ) -> None:
        steps, seed = whole_number("steps", steps, 1), whole_number("seed", seed)
        self._policy, self._env = acting(policy, env), env
        self.arm_env = cast(OctoArmEnv, env.unwrapped)
        self.parameters, self.settings = inspect_env(env)
        self.seed, self.steps, self.steps_made = seed, steps, 0
        self.failure, self.reward, self.earned = "", 0.0, 0.0
        self.period = float(self.settings["control_period"])
        self._push = Push.after_a_second(push, self.period)
        self._noise = Noise(noise)
        self._random = np.random.default_rng(seed)
        direction = self._random.uniform(0, 2 * np.pi, 1)
        self._offset = np.stack((np.cos(direction), np.sin(direction)), axis=1)
        self._offset *= push / self.arm_env.action_range
        self._state: Any = None
        self._rewards, self._errors = np.zeros((steps, 1)), np.zeros((steps, 1))
        self._angles, self._actions = np.zeros((steps, 1, 2)), np.zeros((steps, 1, 2))
        self.lengths: Float
        self.info: dict[str, Any]
        self.lengths, self.info = env.reset(seed=seed)
        self.action: Float = np.zeros(2)
        self.command: Float = np.array(self.info["base_angles"])

    @property
    def ended(self) -> bool:
        """Whether all steps are made, or the arm left its domain."""
        return self.steps_made == self.steps or bool(self.failure)

    @property
    def pushed(self) -> bool:
        """Whether the base is pushed in the next step."""
        begin = self._push.begin
        return self._push.size > 0 and begin <= self.steps_made < begin + self._push.steps

    @property
    def noisy(self) -> bool:
        """Whether the agent sees noise."""
        return self._noise.size > 0

    @property
    def disturbances(self) -> tuple[str, ...]:
        """What disturbs the arm or the agent in the next step, in words."""
        words = ("pushed", self.pushed), ("noise", self.noisy)
        return tuple(word for word, applies in words if applies)

    @property
    def time(self) -> float:
        """Since the episode began [s]."""
        return self.steps_made * self.period

    def step(self) -> None:
        """Let the agent act once."""
        step, seen = self.steps_made, self.lengths[np.newaxis]
        if self._noise.size:
            seen = seen + self._noise.size * self._random.uniform(-1, 1, seen.shape)
        # A batch of one, as in an evaluation: a lone observation is summed in another order.
        chosen, self._state = self._policy.predict(
            seen, state=self._state, episode_start=np.array([step == 0])
        )
        command = np.asarray(chosen, dtype=np.float32).reshape(1, 2)
        if self.pushed:
            command = np.clip(command + self._offset, -1, 1).astype(np.float32)
        self.lengths, reward, terminated, _, self.info = self._env.step(command[0])
        self.action = np.asarray(chosen, dtype=np.float64).reshape(2)
        self.command = command[0].astype(np.float64) * self.arm_env.action_range
        self.reward = float(reward)
        self._rewards[step], self._errors[step] = reward, self.info["tracking_error"]
        self._angles[step], self._actions[step] = self.info["base_angles"], self.action
        self.earned += self.reward
        self.steps_made += 1
        if terminated:
            self.failure = str(self.info["failure"])

    def figures(self) -> dict[str, Any]:
        """Give the figures of the episode that has ended, as `evaluate_policy` does."""
        rollout = Rollout(
            self._rewards,
            self._angles,
            self._errors,
            alive=np.arange(self.steps)[:, np.newaxis] < self.steps_made,
            failed=np.array([bool(self.failure)]),
            actions=self._actions,
        )
        orbit = orbit_measures(
            rollout,
            self.arm_env.orbit,
            amplitude=self.arm_env.amplitude,
            period=self.arm_env.period,
            control_period=self.period,
            window=self.steps // 2,
        )
        return {**orbit, **tracking_measures(rollout)}

    def report(self) -> str:
        """Give the figures in words."""
        figures = self.figures()
        parts = [
            f"return {figures['return']:.1f} of {self.steps}",
            f"error {figures['tracking_error']:.3f}°",
            *(
                f"{name} {'-' if figures[key] is None else format(figures[key], '.4f')}"
                for name, key in (("orbit distance", "orbit_distance"), ("period", "period"))
            ),
        ]
        if self.failure:
            reason = self.failure.removeprefix("the arm left its domain: ")
            parts.append(f"left its domain after {self.time:.2f} s: {reason}")
        return f"seed {self.seed}: {', '.join(parts)}"
