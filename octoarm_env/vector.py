"""Many environments ``OctoArm-v0`` at once."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ClassVar, Literal

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_differing_spaces, batch_space
from numpy.typing import ArrayLike

from octoarm_env._core import EpisodeBatch
from octoarm_env.arguments import thread_count
from octoarm_env.arrays import Float
from octoarm_env.batch import BatchEnv, Flags, VectorSnapshot, is_sequence
from octoarm_env.env import OctoArmEnv
from octoarm_env.parameters import ArmParameters, BodyLike
from octoarm_env.rendering.camera import Camera
from octoarm_env.rendering.history import BatchHistory
from octoarm_env.rendering.pictures import Pictures, Scene, render_fps
from octoarm_env.settings import EpisodeSettings, phase_option
from octoarm_env.targets import TargetName

__all__ = ["Flags", "OctoArmVectorEnv", "VectorSnapshot"]


class OctoArmVectorEnv(BatchEnv):
    """The native batch of environments ``OctoArm-v0``: what ``gym.make_vec`` makes.

    Sub-environment i is an :class:`octoarm_env.OctoArmEnv` with a time limit: spaces, rewards,
    starting states, ends and infos are documented there, and everything returned has the very bits
    that ``gymnasium.vector.SyncVectorEnv`` of single environments returns. But the whole episode is
    computed by the physics, eight arms in the lanes of vector instructions, the groups of eight
    shared by threads; neither changes a result. An arm that leaves its domain ends its own episode
    and disturbs no other.

    Args:
        num_envs: number of environments N, at least 1.
        target: as in `OctoArmEnv`, for all; or a sequence of N of them.
        amplitude: as in `OctoArmEnv`, for all; or a sequence of N of them.
        arm: the body of all, as in `OctoArmEnv`; or a sequence of N bodies with one number of
            compartments.
        control_period, actuator, action_range, tracking_weight, reward_width, action_change_weight:
            as in `OctoArmEnv`.
        length_noise, action_noise, delay, dropout, vary, bodies, body_seed: as in `OctoArmEnv`.
        render_mode: None, or "rgb_array": `render` then gives a picture of every environment.
        width, height, camera, overlay: of those pictures, as in `OctoArmEnv`.
        max_episode_steps: steps after which an episode is truncated; None or -1: never.
        autoreset_mode: what happens when an episode has ended, a ``gymnasium.vector.AutoresetMode``
            or its value: NEXT_STEP, the next step ignores the action and begins a new episode;
            SAME_STEP, the step that ends the episode begins the next one, the end being in the
            infos ``final_obs`` and ``final_info``; DISABLED,
            ``reset(options={"reset_mask": mask})`` must follow, and a step before it is an error.
        threads: threads that share a step, the calling one included; None: as many as the processor
            runs at once.

    Attributes:
        autoreset_mode: the ``gymnasium.vector.AutoresetMode``, as in ``metadata``.

    Raises:
        ValueError, TypeError: a wrong argument, by name, with its value and what is allowed.
        AttributeError: an argument that is set later; it is what the batch was made with.

    ``reset(options={"phase": p})`` begins the episodes at that phase of their targets, in turns
    from 0 to 1.

    ``pickle`` and ``copy.deepcopy`` continue the whole batch exactly where it stands, and so does
    :meth:`octoarm_env.batch.BatchEnv.restore` of a snapshot.
    """

    _core: EpisodeBatch
    _single: ClassVar[type[OctoArmEnv]] = OctoArmEnv
    _id = "OctoArm-v0"

    def __init__(
        self,
        num_envs: int = 1,
        target: TargetName | ArrayLike | Sequence[TargetName | ArrayLike] = "quadratic",
        amplitude: float | Sequence[float | None] | Float | None = None,
        control_period: float = 0.01,
        actuator: Literal["direct", "servo"] = "direct",
        arm: BodyLike | Sequence[BodyLike] | None = None,
        action_range: float | None = None,
        tracking_weight: float = 1.0,
        reward_width: float = 0.3,
        action_change_weight: float = 0.01,
        length_noise: float = 0.0,
        action_noise: float = 0.0,
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
        max_episode_steps: int | None = 500,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
    ) -> None:
        self._begin(num_envs, render_mode, autoreset_mode)
        several = {"target": target, "amplitude": amplitude, "arm": arm}
        columns = (_per_env(name, value, self.num_envs) for name, value in several.items())
        others = (action_range, tracking_weight, reward_width, action_change_weight)
        noises, counts = (length_noise, action_noise), (delay, dropout)
        factors = {} if vary is None else vary
        known: dict[tuple[int, Any, int], EpisodeSettings] = {}
        settings = []
        for one_target, one_amplitude, body in zip(*columns, strict=True):
            # Arguments are mostly the same for all, and checking a body takes a while.
            key = (id(one_target), one_amplitude, id(body))
            if key not in known:
                of_one = (one_target, one_amplitude, control_period, actuator)
                known[key] = EpisodeSettings(
                    *of_one,
                    ArmParameters.of(body),
                    *others,
                    *noises,
                    *counts,
                    factors,
                    bodies,
                    body_seed,
                )
            settings.append(known[key])
        self._settings = tuple(settings)
        # The same text for the same settings: it is read once.
        texts = [each.text for each in settings]
        self._arguments = (
            texts,
            self._limit(max_episode_steps),
            self.autoreset_mode.name.lower(),
            thread_count(threads),
        )
        self._core = self._new_core()
        self.metadata["render_fps"] = render_fps(control_period)
        modes = self.metadata["render_modes"]
        self._pictures = Pictures(settings, render_mode, modes, width, height, camera, overlay)
        self._history = None if render_mode is None else BatchHistory(control_period, self.num_envs)

        bounds = self._core.observation_bounds
        shape = (self._core.observation_len,)
        self.single_observation_space = spaces.Box(*bounds[0], shape, np.float64)
        self.observation_space = (
            batch_space(self.single_observation_space, self.num_envs)
            if len(set(bounds)) == 1
            else batch_differing_spaces([spaces.Box(*each, shape, np.float64) for each in bounds])
        )
        self.single_action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    @property
    def settings(self) -> tuple[EpisodeSettings, ...]:
        """What the episodes of each sub-environment are made of."""
        return self._settings

    _fixed = frozenset(inspect.signature(__init__).parameters) - {"self"}
    _remedy = 'gym.make_vec("OctoArm-v0", ..., {}=...)'

    def _new_core(self) -> EpisodeBatch:
        return EpisodeBatch(*self._arguments)

    def call_at(
        self, indices: Iterable[int], name: str, *args: Any, **kwargs: Any
    ) -> tuple[Any, ...]:
        """Do as :meth:`octoarm_env.batch.BatchEnv.call`; `teacher_action` is a method too."""
        if name == "teacher_action":
            actions = self._core.teacher_actions()
            return tuple(actions[index].copy() for index in indices)
        return super().call_at(indices, name, *args, **kwargs)

    def teacher_actions(self) -> Float:
        """Give the lead-compensated clocks' actions now, (N, 2); they depend on the time alone."""
        return self._core.teacher_actions()

    def _ask(self, options: dict[str, Any] | None) -> float | None:
        return phase_option(options, "reset_mask")

    def _scene(self, index: int, history: Any) -> Scene:
        core = self._core
        return Scene(
            core.joints(index), lambda: (core.orbit_tables[index], core.action_ranges[index].item())
        )

    def _each(self) -> dict[str, Callable[[], Iterable[Any]]]:
        core = self._core
        return {
            "action_range": core.action_ranges.tolist,
            "amplitude": core.amplitudes.tolist,
            "orbit": lambda: core.orbit_tables,
            "period": core.periods.tolist,
            "settings": lambda: self._settings,
        }

    def _columns(self, kwargs: Mapping[str, Any]) -> dict[str, list[Any]]:
        return {
            name: _per_env(name, value, self.num_envs)
            for name, value in kwargs.items()
            if name in self._single._fixed
        }


def _per_env(name: str, value: Any, count: int) -> list[Any]:
    """One value an environment."""
    several = name in ("target", "amplitude", "arm") and is_sequence(value)
    if several and name == "target":
        # An array, or another (T, 2) nesting of numbers, is one target.
        targets = [] if isinstance(value, np.ndarray) else value
        several = any(isinstance(each, str) or np.ndim(each) == 2 for each in targets)
    if not several:
        return [value] * count
    if len(value) != count:
        raise ValueError(f"{name} has {len(value)} entries, expected one or {count} (num_envs)")
    return list(value)
