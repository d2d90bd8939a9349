"""A Gymnasium `VectorEnv` as a `VecEnv` of stable-baselines3.

Both step many environments at once. They differ in what they give back: a `VectorEnv` five arrays
and a dictionary of arrays with masks, a `VecEnv` three arrays and a list of dictionaries. They also
differ at the end of an episode. stable-baselines3 wants the observation of the next episode at
once, with the last one of the old episode in its info as "terminal_observation"; of Gymnasium's
modes that is `AutoresetMode.SAME_STEP`. Here the one is turned into the other, environment by
environment as stable-baselines3's own `DummyVecEnv` would have it, bit by bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from typing import Any
from warnings import warn

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from numpy.typing import NDArray
from stable_baselines3.common.env_util import is_wrapped
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

import octoarm_env  # noqa: F401, registers the environment

Info = dict[str, Any]

_LAST_KEYS = ("final_info", "_final_info", "final_obs", "_final_obs")
"""What a vector environment adds to its infos when an episode has ended."""

_CONVERTERS = {"DictInfoToList", "ArrayConversion"}
"""Wrappers, and their subclasses, that make of infos and arrays what cannot be taken here."""


class Sb3VecEnv(VecEnv):
    """The environments of a Gymnasium `VectorEnv` for stable-baselines3.

    Step by step the same as `DummyVecEnv` over the same single environments. The infos are made
    anew at each step: floats are NumPy's, other numbers Python's, arrays and observations belong
    to the caller.

    Vector wrappers may add to the infos of a step, as Gymnasium's `RecordEpisodeStatistics` adds
    ``"episode"``. Where an episode has ended, what the environment itself gives belongs to the next
    episode, but what wrappers add to the one that has ended: it is in the info of its last step, as
    stable-baselines3's `Monitor` has it.

    Where the vector environment has its single environments in a list `envs`, attributes and
    methods are looked up there. Otherwise its own `call`, `call_at`, `get_attr` and `set_attr` are
    used.

    Args:
        envs: a vector environment in autoreset mode SAME_STEP, for instance
            `gym.make_vec("OctoArm-v0", num_envs=8, autoreset_mode=AutoresetMode.SAME_STEP)`,
            however wrapped. One more layer is put below its wrappers, which sees what infos they
            add.

    Attributes:
        vector_env: the vector environment.

    Raises:
        TypeError: `envs` is not a `VectorEnv`.
        ValueError: its autoreset mode is another one, or a wrapper turns its infos into a list or
            its arrays into those of another library.
    """

    actions: NDArray[Any]

    def __init__(self, envs: VectorEnv[Any, Any, Any]) -> None:
        if not isinstance(envs, VectorEnv):
            raise TypeError(
                f"envs = {envs!r}: expected a gymnasium.vector.VectorEnv, not {type(envs).__name__}"
            )
        mode = envs.metadata.get("autoreset_mode")
        if mode != AutoresetMode.SAME_STEP:
            raise ValueError(
                f"envs.metadata['autoreset_mode'] = {mode}: expected AutoresetMode.SAME_STEP"
            )
        self._own = _put_below_wrappers(envs)
        self.vector_env: Any = envs
        self._innermost: Any = envs.unwrapped
        # The base class asks for their render_mode.
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)
        self.metadata = dict(envs.metadata)

    def reset(self) -> VecEnvObs:
        """Begin an episode in every environment, with the seeds and options set before.

        Returns:
            The observations; the infos are in `reset_infos`.
        """
        seeds = None if all(seed is None for seed in self._seeds) else list(self._seeds)
        options = deepcopy(self._options[0]) or None
        observations, infos = self.vector_env.reset(seed=seeds, options=options)
        # Seeds and options are used once, as in every VecEnv.
        self._reset_seeds()
        self._reset_options()
        self.reset_infos = _rows(infos, self.num_envs)
        own: VecEnvObs = deepcopy(observations)
        return own

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions, one row an environment, for `step_wait`."""
        self.actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Step every environment; one whose episode ends begins the next one at once.

        Returns:
            Observations, rewards (float32), dones and infos. Where an episode has ended, the
            observation is the first of the next one and the info the last of the old one; the info
            of the next one is in `reset_infos`.
        """
        observations, rewards, terminated, truncated, infos = self.vector_env.step(self.actions)
        dones = np.logical_or(terminated, truncated)
        ended = np.flatnonzero(dones).tolist()
        current = {key: infos[key] for key in infos if key not in _LAST_KEYS} if ended else infos
        rows = _rows(current, self.num_envs, {"TimeLimit.truncated": False})
        if ended:
            own = infos.keys() if self._own is None else self._own.keys
            last_rows = _rows(infos["final_info"], self.num_envs)
            for index in ended:
                # What wrappers add belongs to the episode that has ended, the rest to the next one.
                row = rows[index]
                self.reset_infos[index] = {key: row[key] for key in row if key in own}
                rows[index] = last_rows[index] | {key: row[key] for key in row if key not in own}
                rows[index]["TimeLimit.truncated"] = bool(truncated[index] & ~terminated[index])
                rows[index]["terminal_observation"] = deepcopy(infos["final_obs"][index])
        return deepcopy(observations), rewards.astype(np.float32), dones, rows

    def close(self) -> None:
        """Close all environments."""
        self.vector_env.close()

    def set_options(self, options: list[Info] | Info | None = None) -> None:
        """Set the options of the next reset.

        Args:
            options: one dictionary for all environments, or a list of equal ones, one for each.

        Raises:
            ValueError: the list is too long or too short, or the options in it differ: a vector
                environment resets all its environments with the same ones.
        """
        if isinstance(options, list):
            if len(options) != self.num_envs:
                raise ValueError(
                    f"options has {len(options)} entries, expected one for each of the "
                    f"{self.num_envs} environments"
                )
            for index, entry in enumerate(options):
                if entry is not options[0] and entry != options[0]:
                    raise ValueError(
                        f"options[{index}] = {entry!r}, but options[0] = {options[0]!r}: a vector "
                        "environment takes the same options for all its environments"
                    )
        super().set_options(options)

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Give an attribute of every environment, or of those at `indices`."""
        chosen = list(self._get_indices(indices))
        envs = self._envs
        if envs is not None:
            return [envs[index].get_wrapper_attr(attr_name) for index in chosen]
        values = self._innermost.get_attr(attr_name)
        return [values[index] for index in chosen]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of every environment, or of those at `indices`, to one value."""
        chosen = list(self._get_indices(indices))
        envs = self._envs
        if envs is not None:
            for index in chosen:
                envs[index].set_wrapper_attr(attr_name, value)
            return
        if indices is None:
            values = [value] * self.num_envs
        else:
            values = list(self._innermost.get_attr(attr_name))
            for index in chosen:
                values[index] = value
        self._innermost.set_attr(attr_name, values)

    def env_method(
        self,
        method_name: str,
        *method_args: Any,
        indices: VecEnvIndices = None,
        **method_kwargs: Any,
    ) -> list[Any]:
        """Call a method of every environment, or of those at `indices`; give what they return.

        Raises:
            NotImplementedError: `indices` leave some environments out, and the vector environment
                can only call all of them.
        """
        chosen = list(self._get_indices(indices))
        envs = self._envs
        if envs is not None:
            methods = [envs[index].get_wrapper_attr(method_name) for index in chosen]
            return [method(*method_args, **method_kwargs) for method in methods]
        if sorted(chosen) == list(range(self.num_envs)):
            results = self._innermost.call(method_name, *method_args, **method_kwargs)
            return [results[index] for index in chosen]
        if not hasattr(self._innermost, "call_at"):
            raise NotImplementedError(
                f"env_method({method_name!r}, indices={chosen}): a {type(self._innermost).__name__}"
                f" can only call all of its {self.num_envs} environments; leave indices out"
            )
        return list(self._innermost.call_at(chosen, method_name, *method_args, **method_kwargs))

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Whether the environments are wrapped so.

        False where the vector environment has no single environments that could be: the native one
        has none, and limits the time of an episode by itself.
        """
        chosen = list(self._get_indices(indices))
        envs = self._envs
        if envs is None:
            return [False] * len(chosen)
        return [is_wrapped(envs[index], wrapper_class) for index in chosen]

    def get_images(self) -> Sequence[NDArray[Any] | None]:
        """Give a picture of every environment; None without the render mode "rgb_array"."""
        if self.render_mode != "rgb_array":
            warn(f"render_mode = {self.render_mode!r}: pictures need 'rgb_array'", stacklevel=2)
            return [None] * self.num_envs
        return list(self.vector_env.render())

    @property
    def _envs(self) -> Sequence[gym.Env[Any, Any]] | None:
        """The single environments, where the vector environment has any."""
        return getattr(self._innermost, "envs", None)


class _OwnInfos(VectorWrapper[Any, Any, Any, Any, Any]):
    """Notes the keys of the infos of a step before wrappers further out add theirs."""

    keys: frozenset[str] = frozenset()

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, Info]:
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        self.keys = frozenset(infos)
        return observations, rewards, terminated, truncated, infos


def _put_below_wrappers(envs: VectorEnv[Any, Any, Any]) -> _OwnInfos | None:
    """Put a layer between a vector environment and its wrappers; None if it has none.

    Raises:
        ValueError: a wrapper turns the infos or arrays into something else.
    """
    layer = envs
    while isinstance(layer, VectorWrapper):
        if _CONVERTERS & {each.__name__ for each in type(layer).__mro__}:
            raise ValueError(
                f"envs is wrapped in {type(layer).__name__}: expected NumPy's arrays, and infos in "
                "a dictionary; leave that wrapper out"
            )
        if not isinstance(layer.env, VectorWrapper):
            below = layer.env = _OwnInfos(layer.env)
            return below
        layer = layer.env
    return None


def make_sb3_vec_env(num_envs: int, *, seed: int | None = None, **kwargs: Any) -> Sb3VecEnv:
    """Make many natively stepped arms for stable-baselines3.

    Args:
        num_envs: number of environments.
        seed: environment i begins with seed + i at the first reset; None: by chance.
        **kwargs: arguments of `OctoArmEnv`, `max_episode_steps`, and what the vector environment
            takes besides.
    """
    envs = gym.make_vec(
        "OctoArm-v0",
        num_envs=num_envs,
        vectorization_mode="vector_entry_point",
        autoreset_mode=AutoresetMode.SAME_STEP,
        **kwargs,
    )
    wrapped = Sb3VecEnv(envs)
    if seed is not None:
        wrapped.seed(seed)
    return wrapped


def _rows(infos: Info, count: int, start: Info | None = None, kept: str = "fi") -> list[Info]:
    """Turn a dictionary of arrays with masks into `count` dictionaries of values.

    Infos are as `VectorEnv._add_info` makes them: entry i of `infos[key]` belongs to environment i
    if `infos["_" + key][i]`, or if there is no such mask. `start` is in every dictionary; numbers
    of the kinds `kept` stay NumPy's.
    """
    rows = [dict(start or {}) for _ in range(count)]
    for key, values in infos.items():
        if key[:1] == "_" and key[1:] in infos:
            continue
        column: list[Any]
        if isinstance(values, dict):
            # A wrapper's: counts are Python's there.
            column = _rows(values, count, kept="f")
        elif values.ndim == 1:
            # Numbers stay NumPy's, as the single environments give them.
            column = list(values) if values.dtype.kind in kept else values.tolist()
        else:
            column = list(values.copy())
        mask = infos.get(f"_{key}")
        present = [True] * count if mask is None else mask.tolist()
        for row, value, is_present in zip(rows, column, present, strict=True):
            if is_present:
                row[key] = value
    return rows
