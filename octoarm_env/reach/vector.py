"""Many environments ``OctoArmReach-v0`` at once."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import Any, ClassVar, Literal

from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike

from octoarm_env._core import ReachBatch
from octoarm_env.arguments import thread_count
from octoarm_env.batch import BatchEnv
from octoarm_env.parameters import ArmParameters, BodyLike
from octoarm_env.reach.env import OctoArmReachEnv, goal_spaces, reach_scene
from octoarm_env.reach.settings import Point, ReachSettings, goal_option, reach_bound
from octoarm_env.rendering.camera import Camera
from octoarm_env.rendering.history import ReachHistories
from octoarm_env.rendering.pictures import Pictures, Scene, render_fps

__all__ = ["OctoArmReachVectorEnv"]


class OctoArmReachVectorEnv(BatchEnv):
    """The native batch of environments ``OctoArmReach-v0``: what ``gym.make_vec`` makes.

    Sub-environment i is an :class:`octoarm_env.reach.OctoArmReachEnv` with a time limit; everything
    returned has the very bits that ``gymnasium.vector.SyncVectorEnv`` of single environments
    returns, whatever the number of threads.

    Args:
        num_envs: number of environments N, at least 1.
        arguments: those of `OctoArmReachEnv`, by name, for all.
        render_mode: None, or "rgb_array": `render` then gives a picture of every environment.
        max_episode_steps: steps after which an episode is truncated; None or -1: never.
        autoreset_mode, threads: as in :class:`octoarm_env.OctoArmVectorEnv`.

    Raises:
        ValueError, TypeError: a wrong argument, by name, with its value and what is allowed.
        AttributeError: an argument that is set later; it is what the batch was made with.

    ``reset(options={"goal": (x, y, z)})`` sets the goal of those that are reset [m].
    """

    _core: ReachBatch
    _single: ClassVar[type[OctoArmReachEnv]] = OctoArmReachEnv
    _id = "OctoArmReach-v0"

    def __init__(
        self,
        num_envs: int = 1,
        reward_type: Literal["sparse", "dense"] = "sparse",
        control_period: float = 0.05,
        segments: int = 5,
        max_force: float = 1.0,
        activation_time: float = 0.1,
        distance_threshold: float = 0.02,
        observe_rates: bool = False,
        goals: ArrayLike | None = None,
        arm: BodyLike | None = None,
        length_noise: float = 0.0,
        delay: int = 0,
        dropout: int = 0,
        vary: Mapping[str, tuple[float, float]] | None = None,
        bodies: int = 1,
        body_seed: int = 0,
        render_mode: Literal["rgb_array"] | None = None,
        width: int = 640,
        height: int = 480,
        camera: Camera | Mapping[str, Any] | str | None = None,
        overlay: bool = True,
        *,
        max_episode_steps: int | None = 100,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
    ) -> None:
        self._begin(num_envs, render_mode, autoreset_mode)
        self._settings = ReachSettings(
            ArmParameters.of(arm),
            control_period,
            segments,
            max_force,
            activation_time,
            distance_threshold,
            reward_type,
            observe_rates,
            goals,  # type: ignore[arg-type]  # brought into its plain form there
            length_noise,
            delay,
            dropout,
            {} if vary is None else vary,
            bodies,
            body_seed,
        )
        self._threads = thread_count(threads)
        self._limit(max_episode_steps)
        self._core = self._new_core()
        self.metadata["render_fps"] = render_fps(control_period)
        modes = self.metadata["render_modes"]
        self._pictures = Pictures(
            [self._settings] * self.num_envs, render_mode, modes, width, height, camera, overlay
        )
        self._history = (
            None if render_mode is None else ReachHistories(control_period, self.num_envs)
        )
        spaces = goal_spaces(self._settings, self._core)
        self.single_observation_space, self.single_action_space = spaces
        self.observation_space, self.action_space = (
            batch_space(space, self.num_envs) for space in spaces
        )

    _fixed = frozenset(inspect.signature(__init__).parameters) - {"self"}
    _remedy = 'gym.make_vec("OctoArmReach-v0", ..., {}=...)'

    def compute_reward(
        self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: Any = None
    ) -> Any:
        """Give rewards, as :meth:`octoarm_env.reach.OctoArmReachEnv.compute_reward`."""
        return self._settings.reward(achieved_goal, desired_goal)

    @property
    def settings(self) -> ReachSettings:
        """What the episodes are made of."""
        return self._settings

    def _new_core(self) -> ReachBatch:
        return ReachBatch(
            self._settings.text,
            self._settings.goal_table,
            self.num_envs,
            self._max_episode_steps,
            self.autoreset_mode.name.lower(),
            self._threads,
        )

    def _ask(self, options: dict[str, Any] | None) -> Point | None:
        return goal_option(options, reach_bound(self._settings.arm), "reset_mask")

    def _each(self) -> dict[str, Callable[[], Iterable[Any]]]:
        return {
            "activations": lambda: map(self._core.activations, range(self.num_envs)),
            "compute_reward": lambda: [self.compute_reward] * self.num_envs,
            "settings": lambda: [self._settings] * self.num_envs,
            "time": lambda: [self._settings.control_period * each for each in self._core.elapsed],
        }

    def _scene(self, index: int, history: Any) -> Scene:
        return reach_scene(self._core, index, history)
