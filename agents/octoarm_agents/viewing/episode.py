"""One episode, step by step, with all that is shown of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from octoarm_agents.policies.evaluation import Trivial, acting
from octoarm_agents.policies.measures import TargetOrbit, orbit_measures, tracking_measures
from octoarm_agents.policies.rollout import Episodes, Noise, PolicyPredictor, Push
from octoarm_env import OctoArmVectorEnv
from octoarm_env.arrays import Float
from octoarm_env.rendering import Camera
from octoarm_env.rendering.history import History

if TYPE_CHECKING:
    from octoarm_env.rendering.renderer import Renderer


class Episode(Episodes):
    """An episode of a policy in one environment: `rollout.Episodes` with n = 1.

    Args:
        policy: what acts, or ``"hold"`` or ``"clock"``.
        envs: one environment, in which `steps` are allowed; it is reset.
        seed: of the episode.
        steps: that it lasts.
        push: size of the push after a second [degrees]; 0: none.
        noise: half width of the noise on the lengths that the policy sees [m]; 0: none.
        title: whose episode this is.

    Attributes:
        target: what the base is to follow.
        action_range: largest angle of the base [degrees].
        control_period: seconds of a step.
        progress: called after each step.
        history: what pictures show of the past.
        command: what the base was told, the push included, (2,) [degrees]; before the first step
            the base angles.
    """

    def __init__(
        self,
        policy: PolicyPredictor | Trivial,
        envs: OctoArmVectorEnv,
        *,
        seed: int,
        steps: int,
        push: float = 0.0,
        noise: float = 0.0,
        title: str = "",
    ) -> None:
        (self.settings,), self.title = envs.settings, title
        self.control_period = self.settings.control_period
        super().__init__(
            acting(policy, envs, seed),
            envs,
            seed=seed,
            steps=steps,
            push=Push.after_a_second(push, self.control_period) if push else None,
            noise=Noise(noise) if noise else None,
        )
        self.target = TargetOrbit.of(envs)
        self.action_range: float = self._of_env("action_range")
        self.progress: Callable[[], object] = lambda: None
        self.command: Float = self.infos["base_angles"][0].copy()
        self.history = History(self.control_period)
        self.history.begin(self.info)

    def _of_env(self, name: str) -> Any:
        return self.envs.get_attr(name)[0]

    @property
    def joints(self) -> Float:
        """Ends of the springs now, as `OctoArmEnv.arm_joints`, (N + 1, 4, 3) [m]."""
        joints: Float = self._of_env("arm_joints")
        return joints

    @property
    def info(self) -> dict[str, Any]:
        """The info of the last step, or of the reset, as the single environment gives it."""
        return {name: value[0] for name, value in self.infos.items() if name[0] != "_"}

    @property
    def ended(self) -> bool:
        """Whether all steps are made, or the arm left its domain."""
        return self.steps_made == self.steps or bool(self.history.failure)

    @property
    def disturbances(self) -> tuple[str, ...]:
        """What disturbs the arm or the policy in the next step, in words."""
        pushed = self.push is not None and self.push.at(self.steps_made)
        words = ("pushed", pushed), ("noise", self.noise is not None)
        return tuple(word for word, applies in words if applies)

    def step(self) -> NDArray[np.float32]:
        """Let the policy act once."""
        self.history.disturbances = self.disturbances
        command = super().step()
        self.command = command[0].astype(np.float64) * self.action_range
        self.history.add(self.info, self.rollout.rewards[self.steps_made - 1, 0])
        self.progress()
        return command

    def figures(self) -> dict[str, Any]:
        """Give the figures of the episode that has ended, as `evaluate_policy` does."""
        orbit = orbit_measures(self.rollout, self.target, self.steps // 2)
        return {**orbit, **tracking_measures(self.rollout)}

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
        if self.history.failure:
            reason = self.history.failure.removeprefix("the arm left its domain: ")
            parts.append(f"left its domain after {self.history.time:.2f} s: {reason}")
        return f"seed {self.seed}: {', '.join(parts)}"

    def renderer(self, size: tuple[int, int], camera: Camera, *, overlay: bool = True) -> Renderer:
        """Give what draws this episode, and others of the same arm and target.

        Raises:
            ImportError: pygame-ce is not installed.
        """
        from octoarm_env.rendering.renderer import Renderer

        return Renderer(
            self.settings.arm,
            self.target.points,
            self.action_range,
            self.title,
            size=size,
            camera=camera,
            overlay=overlay,
        )
