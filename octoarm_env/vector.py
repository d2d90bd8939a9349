"""Many environments ``OctoArm-v0`` at once."""

from __future__ import annotations

import copy
import dataclasses
import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ClassVar, Literal

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.core import RenderFrame
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_differing_spaces, batch_space
from numpy.typing import ArrayLike, NDArray

from octoarm_env._core import EpisodeBatch
from octoarm_env.arguments import generator_seed, thread_count, whole_number
from octoarm_env.arrays import Float
from octoarm_env.env import OctoArmEnv
from octoarm_env.parameters import ArmParameters, BodyLike
from octoarm_env.rendering.camera import Camera
from octoarm_env.rendering.history import BatchHistory
from octoarm_env.rendering.pictures import Pictures, Scene, render_fps, warn_without_mode
from octoarm_env.settings import EpisodeSettings, MadeOnce, phase_option
from octoarm_env.targets import TargetName

Flags = NDArray[np.bool_]


@dataclasses.dataclass(frozen=True)
class VectorSnapshot:
    """Everything that a vector environment needs to go on; made by its `snapshot`.

    Attributes:
        episodes: the episodes' states, exact to the bit: as JSON text, or as the bytes of a server.
        seeds: the seeds that the environments were last given.
        past: what the pictures show of the past; None without a render mode. Snapshots are equal
            whatever their pictures show.
        generator: what draws the seeds of environments that were not given one; None if all were.
    """

    episodes: str | bytes = dataclasses.field(repr=False)
    seeds: tuple[int | None, ...]
    past: BatchHistory | None = dataclasses.field(default=None, repr=False, compare=False)
    generator: np.random.Generator | None = dataclasses.field(
        default=None, repr=False, compare=False
    )


class OctoArmVectorEnv(MadeOnce, gym.vector.VectorEnv[Float, NDArray[np.float32], NDArray[Any]]):
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

    ``pickle`` and ``copy.deepcopy`` continue the whole batch exactly where it stands, and so does
    :meth:`restore` of a :meth:`snapshot`.
    """

    metadata: dict[str, Any]
    _core: EpisodeBatch
    _single: ClassVar[type[OctoArmEnv]] = OctoArmEnv
    """What one of them is, alone."""

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
        self.num_envs = whole_number("num_envs", num_envs, 1)
        self.render_mode = render_mode
        self.autoreset_mode = mode = AutoresetMode(autoreset_mode)
        self.metadata = OctoArmEnv.metadata | {
            "render_modes": ["rgb_array"],
            "autoreset_mode": mode,
        }
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
        if max_episode_steps == -1:
            max_episode_steps = None
        elif max_episode_steps is not None:
            max_episode_steps = whole_number("max_episode_steps", max_episode_steps, 1, 2**63 - 1)
        self._max_episode_steps = max_episode_steps
        self._settings = tuple(settings)
        # The same text for the same settings: it is read once.
        texts = [each.text for each in settings]
        self._arguments = (texts, max_episode_steps, mode.name.lower(), thread_count(threads))
        self._core = self._new_core()
        self.metadata["render_fps"] = render_fps(control_period)
        modes = self.metadata["render_modes"]
        self._pictures = Pictures(settings, render_mode, modes, width, height, camera, overlay)
        self._history = None if render_mode is None else BatchHistory(control_period, self.num_envs)
        self._seeds: list[int | None] = [None] * self.num_envs
        self._attributes: dict[str, list[Any]] = {}

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

    def _kept(self, spec: EnvSpec) -> EnvSpec:
        # The limit is an argument here, and no wrapper's.
        return dataclasses.replace(super()._kept(spec), max_episode_steps=self._max_episode_steps)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Float, dict[str, Any]]:
        """Begin episodes on the orbit.

        Args:
            seed: starts the generators of phases anew: of sub-environment i with ``seed + i``, or
                from a list, in which None goes on with the present generator.
            options: ``"reset_mask"``, a bool array (N,) with at least one True, resets only those
                environments; ``"phase"`` begins at that phase of the target, in turns from 0 to 1.

        Returns:
            The spring lengths of all environments, (N, 80) [m], and the infos of those reset.

        Raises:
            ValueError, TypeError: a bad seed, mask or phase, or an unknown option; nothing is
                changed then.
        """
        phase = phase_option(options, "reset_mask")
        mask = self._mask(options)
        seeds = self._given_seeds(seed)
        begun = np.flatnonzero(mask).tolist()
        for index in begun:
            if seeds[index] is None and self._seeds[index] is None:
                seeds[index] = int(self.np_random.integers(2**63))
        given = [None if each is None else generator_seed(each) for each in seeds]
        result = self._core.reset(mask.tolist(), given, phase)
        for index in begun:
            if seeds[index] is not None:
                self._seeds[index] = seeds[index]
        if self._history is not None:
            self._history.begin(mask, result[1])
        return result

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[Float, Float, Flags, Flags, dict[str, Any]]:
        """Turn every base for one control period.

        Args:
            actions: (N, 2), each entry in [-1, 1]; ignored where the step begins a new episode, but
                checked there too.

        Returns:
            Observations (N, 80) [m], rewards (N,), terminations (N,), truncations (N,), infos;
            fresh arrays every time.

        Raises:
            ValueError, TypeError: actions of another shape or dtype, an entry that is not a finite
                number in [-1, 1], a step before `reset`, or, in DISABLED mode, after the end of an
                episode; nothing is changed then.
        """
        if self._history is None:
            return self._core.step(actions)
        begun = np.array(self._core.ended)
        result = _, rewards, terminated, truncated, infos = self._core.step(actions)
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            begun = terminated | truncated
        self._history.add(infos, rewards, begun)
        return result

    def snapshot(self) -> VectorSnapshot:
        """Save the whole batch, to go on from here later."""
        generator = copy.deepcopy(self.np_random) if None in self._seeds else None
        past = copy.deepcopy(self._history)
        return VectorSnapshot(self._core.save(), tuple(self._seeds), past, generator)

    def restore(self, snapshot: VectorSnapshot) -> None:
        """Go on exactly where a batch with the same arguments was saved.

        Raises:
            ValueError, TypeError: something else than a snapshot, or one of another batch; nothing
                is changed then.
        """
        if not isinstance(snapshot, VectorSnapshot):
            kind = type(snapshot).__name__
            raise TypeError(f"snapshot must be a VectorSnapshot, not {kind}")
        self._core.load(snapshot.episodes)  # type: ignore[arg-type]  # checked there
        self._seeds = list(snapshot.seeds)
        if snapshot.generator is not None:
            self._np_random = copy.deepcopy(snapshot.generator)
        if self._history is not None and snapshot.past is not None:
            self._history = copy.deepcopy(snapshot.past)
        elif self._history is not None:
            # A past that begins now.
            self._history.begin(np.ones(self.num_envs, dtype=np.bool_), self._core.infos())

    def teacher_actions(self) -> Float:
        """Give the lead-compensated clocks' actions now, (N, 2); they depend on the time alone."""
        return self._core.teacher_actions()

    @property
    def threads(self) -> int:
        """Number of threads that share a step, the calling one included."""
        return self._core.threads

    @property
    def np_random(self) -> np.random.Generator:
        """What draws the seeds of environments that are first reset without one.

        After another was assigned, every environment draws a seed from it at its next reset.
        """
        return super().np_random

    @np_random.setter
    def np_random(self, value: np.random.Generator) -> None:
        self._np_random = value
        self._seeds = [None] * self.num_envs

    @property
    def np_random_seed(self) -> tuple[int | None, ...]:  # type: ignore[override]
        """The seeds that the environments were last given, or have drawn; None before that."""
        return tuple(self._seeds)

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of all environments (`teacher_action`, `render`), or get an attribute.

        Returns:
            One result an environment.
        """
        return self.call_at(range(self.num_envs), name, *args, **kwargs)

    def call_at(
        self, indices: Iterable[int], name: str, *args: Any, **kwargs: Any
    ) -> tuple[Any, ...]:
        """Do as :meth:`call` for some of the environments."""
        if name == "render":
            return self._frames(indices) or tuple(None for _ in indices)
        if name == "teacher_action":
            actions = self._core.teacher_actions()
            return tuple(actions[index].copy() for index in indices)
        values = self.get_attr(name)
        chosen = (values[index] for index in indices)
        return tuple(value(*args, **kwargs) if callable(value) else value for value in chosen)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Get an attribute of every environment, by its name in `OctoArmEnv`.

        Raises:
            AttributeError: environments have no such attribute.
        """
        if name in self._attributes:
            return tuple(self._attributes[name])
        core, count = self._core, self.num_envs
        each: dict[str, Callable[[], Iterable[Any]]] = {
            "action_range": core.action_ranges.tolist,
            "action_space": lambda: [self.single_action_space] * count,
            "amplitude": core.amplitudes.tolist,
            "arm_joints": lambda: map(core.joints, range(count)),
            "arm_positions": lambda: map(core.positions, range(count)),
            "metadata": lambda: [OctoArmEnv.metadata] * count,
            "np_random_seed": lambda: self.np_random_seed,
            "observation_space": lambda: [self.single_observation_space] * count,
            "orbit": lambda: core.orbit_tables,
            "period": core.periods.tolist,
            "render_mode": lambda: [self.render_mode] * count,
            "settings": lambda: self._settings,
            "spec": self._single_specs,
        }
        if name not in each:
            raise AttributeError(f"OctoArm-v0 environments have no attribute {name!r}")
        return tuple(each[name]())

    def set_attr(self, name: str, values: list[Any] | tuple[Any, ...] | Any) -> None:
        """Give every environment an attribute of your own: one value for all, or a list of N.

        Raises:
            AttributeError: an attribute that environments have themselves, such as an argument of
                theirs: it would be without effect.
            ValueError: a list of another length.
        """
        self._check_free(name)
        own = name in ("action_space", "observation_space") or hasattr(OctoArmEnv, name)
        if own or name.startswith("_"):
            raise AttributeError(f"{name} of OctoArm-v0 environments cannot be changed")
        if not isinstance(values, list | tuple):
            values = [values] * self.num_envs
        if len(values) != self.num_envs:
            raise ValueError(f"values has {len(values)} entries, expected {self.num_envs}")
        self._attributes[name] = list(values)

    def render(self) -> tuple[RenderFrame, ...] | None:
        """Give a picture of every environment; None, and a warning, without a render mode.

        :func:`octoarm_env.rendering.tile_images` makes one of them.

        Returns:
            N arrays (height, width, 3), 0 to 255.

        Raises:
            gymnasium.error.ResetNeeded, gymnasium.error.DependencyNotInstalled: as
                :meth:`octoarm_env.OctoArmEnv.render`.
        """
        return self._frames(range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Let go of what drew."""
        self._pictures.close()

    def _single_specs(self) -> list[EnvSpec | None]:
        """What `gym.make` makes each environment of."""
        spec, count = self.spec, self.num_envs
        if spec is None:
            return [None] * count
        columns = {
            name: _per_env(name, value, count)
            for name, value in spec.kwargs.items()
            if name in self._single._fixed
        }
        return [
            dataclasses.replace(
                spec, kwargs={name: column[index] for name, column in columns.items()}
            )
            for index in range(count)
        ]

    def _frames(self, indices: Iterable[int]) -> tuple[NDArray[np.uint8], ...] | None:
        if self._history is None:
            warn_without_mode()
            return None

        return tuple(
            self._pictures.frame(index, self._history.of(index), self._scene(index))
            for index in indices
        )

    def _scene(self, index: int) -> Scene:
        core = self._core
        return Scene(
            core.joints(index), lambda: (core.orbit_tables[index], core.action_ranges[index].item())
        )

    def _mask(self, options: dict[str, Any] | None) -> Flags:
        """Which environments are to be reset."""
        if not options or "reset_mask" not in options:
            return np.ones(self.num_envs, dtype=np.bool_)
        mask, name = options["reset_mask"], "options['reset_mask']"
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
            found = f"dtype {mask.dtype}" if isinstance(mask, np.ndarray) else type(mask).__name__
            raise TypeError(f"{name} must be an array of bool, not {found}")
        if mask.shape != (self.num_envs,):
            raise ValueError(f"{name} has shape {mask.shape}, expected ({self.num_envs},)")
        if not mask.any():
            raise ValueError(f"{name} has no True: expected at least one environment to reset")
        return mask

    def _given_seeds(self, seed: Any) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if not _is_sequence(seed):
            first = whole_number("seed", seed, 0)
            return [first + index for index in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"seed has {len(seed)} entries, expected {self.num_envs}")
        return [
            None if each is None else whole_number(f"seed[{index}]", each, 0)
            for index, each in enumerate(seed)
        ]


def _is_sequence(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, Sequence) and not isinstance(value, str)


def _per_env(name: str, value: Any, count: int) -> list[Any]:
    """One value an environment."""
    several = name in ("target", "amplitude", "arm") and _is_sequence(value)
    if several and name == "target":
        # An array, or another (T, 2) nesting of numbers, is one target.
        targets = [] if isinstance(value, np.ndarray) else value
        several = any(isinstance(each, str) or np.ndim(each) == 2 for each in targets)
    if not several:
        return [value] * count
    if len(value) != count:
        raise ValueError(f"{name} has {len(value)} entries, expected one or {count} (num_envs)")
    return list(value)
