"""What the native batches of environments share: seeds, masks, modes, snapshots, pictures."""

from __future__ import annotations

import copy
import dataclasses
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.core import RenderFrame
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from octoarm_env.arguments import generator_seed, whole_number
from octoarm_env.arrays import Float
from octoarm_env.rendering.history import BatchHistory, ReachHistories
from octoarm_env.rendering.pictures import Pictures, Scene, warn_without_mode
from octoarm_env.settings import MadeOnce
from octoarm_env.single import SingleEnv

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
    past: BatchHistory | ReachHistories | None = dataclasses.field(
        default=None, repr=False, compare=False
    )
    generator: np.random.Generator | None = dataclasses.field(
        default=None, repr=False, compare=False
    )


class BatchEnv(MadeOnce, gym.vector.VectorEnv[Any, NDArray[np.float32], NDArray[Any]]):
    """Environments whose episodes one core computes; what those of the tasks have in common.

    Attributes:
        autoreset_mode: the ``gymnasium.vector.AutoresetMode``, as in ``metadata``.
    """

    metadata: dict[str, Any]
    autoreset_mode: AutoresetMode
    _single: ClassVar[type[SingleEnv]]
    """What one of them is, alone."""
    _id: ClassVar[str]
    """By which they are registered."""
    _seeds: list[int | None]
    _attributes: dict[str, list[Any]]
    _pictures: Pictures
    _history: BatchHistory | ReachHistories | None

    def _begin(self, num_envs: Any, render_mode: Any, autoreset_mode: Any) -> None:
        """Keep what every batch is made with."""
        self.num_envs = whole_number("num_envs", num_envs, 1)
        self.render_mode = render_mode
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = self._single.metadata | {
            "render_modes": ["rgb_array"],
            "autoreset_mode": self.autoreset_mode,
        }
        self._seeds = [None] * self.num_envs
        self._attributes = {}

    def _limit(self, max_episode_steps: Any) -> int | None:
        """Steps of an episode; the limit is an argument here, and no wrapper's."""
        if max_episode_steps is None or max_episode_steps == -1:
            self._max_episode_steps = None
        else:
            self._max_episode_steps = whole_number(
                "max_episode_steps", max_episode_steps, 1, 2**63 - 1
            )
        return self._max_episode_steps

    @abstractmethod
    def _ask(self, options: dict[str, Any] | None) -> Any:
        """What a reset is asked to begin with; unknown options are refused."""

    @abstractmethod
    def _each(self) -> dict[str, Callable[[], Iterable[Any]]]:
        """The attributes of the environments that no other base has."""

    @abstractmethod
    def _scene(self, index: int, history: Any) -> Scene:
        """What is in a picture of an environment, with the past that it shows."""

    def _columns(self, kwargs: Mapping[str, Any]) -> dict[str, list[Any]]:
        """The arguments of `gym.make` for each environment."""
        own = {name: value for name, value in kwargs.items() if name in self._single._fixed}
        return {name: [value] * self.num_envs for name, value in own.items()}

    def _kept(self, spec: EnvSpec) -> EnvSpec:
        return dataclasses.replace(super()._kept(spec), max_episode_steps=self._max_episode_steps)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Begin episodes.

        Args:
            seed: starts the generators anew: of sub-environment i with ``seed + i``, or from a
                list, in which None goes on with the present generator.
            options: ``"reset_mask"``, a bool array (N,) with at least one True, resets only those
                environments; others are the task's.

        Returns:
            The observations of all environments, and the infos of those reset.

        Raises:
            ValueError, TypeError: a bad seed, mask or other option; nothing is changed then.
        """
        ask = self._ask(options)
        mask = self._mask(options)
        seeds = self._given_seeds(seed)
        begun = np.flatnonzero(mask).tolist()
        for index in begun:
            if seeds[index] is None and self._seeds[index] is None:
                seeds[index] = int(self.np_random.integers(2**63))
        given = [None if each is None else generator_seed(each) for each in seeds]
        result: tuple[Any, dict[str, Any]] = self._core.reset(mask.tolist(), given, ask)
        for index in begun:
            if seeds[index] is not None:
                self._seeds[index] = seeds[index]
        if self._history is not None:
            self._history.begin(mask, result[1])
        return result

    def step(self, actions: NDArray[np.float32]) -> tuple[Any, Float, Flags, Flags, dict[str, Any]]:
        """Make a step of every environment.

        Args:
            actions: a row of the action space for each; ignored where the step begins a new
                episode, but checked there too.

        Returns:
            Observations, rewards (N,), terminations (N,), truncations (N,), infos;
            fresh arrays every time.

        Raises:
            ValueError, TypeError: actions of another shape or dtype, an entry outside its bounds,
                a step before `reset`, or, in DISABLED mode, after the end of an
                episode; nothing is changed then.
        """
        if self._history is None:
            result: tuple[Any, Float, Flags, Flags, dict[str, Any]] = self._core.step(actions)
            return result
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
        self._core.load(snapshot.episodes)
        self._seeds = list(snapshot.seeds)
        if snapshot.generator is not None:
            self._np_random = copy.deepcopy(snapshot.generator)
        if self._history is not None and snapshot.past is not None:
            self._history = copy.deepcopy(snapshot.past)
        elif self._history is not None:
            # A past that begins now.
            self._history.begin(np.ones(self.num_envs, dtype=np.bool_), self._core.infos())

    @property
    def threads(self) -> int:
        """Number of threads that share a step, the calling one included."""
        return int(self._core.threads)

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
        """Call a method of all environments, such as `render`, or get an attribute.

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
        values = self.get_attr(name)
        chosen = (values[index] for index in indices)
        return tuple(value(*args, **kwargs) if callable(value) else value for value in chosen)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Get an attribute of every environment, by its name in a single one.

        Raises:
            AttributeError: environments have no such attribute.
        """
        if name in self._attributes:
            return tuple(self._attributes[name])
        count = self.num_envs
        each: dict[str, Callable[[], Iterable[Any]]] = {
            "action_space": lambda: [self.single_action_space] * count,
            "arm_joints": lambda: map(self._core.joints, range(count)),
            "arm_positions": lambda: map(self._core.positions, range(count)),
            "metadata": lambda: [self._single.metadata] * count,
            "np_random_seed": lambda: self.np_random_seed,
            "observation_space": lambda: [self.single_observation_space] * count,
            "render_mode": lambda: [self.render_mode] * count,
            "spec": self._single_specs,
            **self._each(),
        }
        if name not in each:
            raise AttributeError(f"{self._id} environments have no attribute {name!r}")
        return tuple(each[name]())

    def set_attr(self, name: str, values: list[Any] | tuple[Any, ...] | Any) -> None:
        """Give every environment an attribute of your own: one value for all, or a list of N.

        Raises:
            AttributeError: an attribute that environments have themselves, such as an argument of
                theirs: it would be without effect.
            ValueError: a list of another length.
        """
        self._check_free(name)
        own = name in ("action_space", "observation_space") or hasattr(self._single, name)
        if own or name.startswith("_"):
            raise AttributeError(f"{name} of {self._id} environments cannot be changed")
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
                :meth:`octoarm_env.single.SingleEnv.render`.
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
        columns = self._columns(spec.kwargs)
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
            self._pictures.frame(index, history, self._scene(index, history))
            for index in indices
            for history in [self._history.of(index)]
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
        if not is_sequence(seed):
            first = whole_number("seed", seed, 0)
            return [first + index for index in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"seed has {len(seed)} entries, expected {self.num_envs}")
        return [
            None if each is None else whole_number(f"seed[{index}]", each, 0)
            for index, each in enumerate(seed)
        ]


def is_sequence(value: Any) -> bool:
    """Tell whether there are several values; a text is one."""
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, Sequence) and not isinstance(value, str)
