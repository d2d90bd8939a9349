"""Many environments whose episodes are computed by a server, in one world."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from octoarm_env import _core
from octoarm_env.arrays import Float
from octoarm_env.remote.env import RemoteOctoArm
from octoarm_env.remote.messages import EnvironmentRequest, pack, unpack
from octoarm_env.remote.world import INFO, Access, RemoteWorld, without_token, world_settings
from octoarm_env.settings import EpisodeSettings
from octoarm_env.vector import Flags, OctoArmVectorEnv

__all__ = ["RemoteOctoArmVectorEnv"]

_OBSERVED = ("spring_lengths", "reward", "terminated", "truncated", *INFO, "failure")
_FINAL = ("final_spring_lengths", *(f"final_{name}" for name in (*INFO, "failure")))

Infos = dict[str, Any]


class RemoteEpisodeBatch(RemoteWorld):
    """Episodes in a world of their own on a server; methods as of the compiled `EpisodeBatch`.

    Errors are a ValueError or TypeError that names the argument, its value and what is allowed;
    nothing is changed then.
    """

    def __init__(
        self,
        access: Access,
        settings: Sequence[EpisodeSettings],
        max_episode_steps: int | None,
        autoreset: AutoresetMode,
        threads: int | None,
    ) -> None:
        for name in ("target", "amplitude", "arm"):
            if any(getattr(each, name) != getattr(settings[0], name) for each in settings):
                raise ValueError(
                    f"{name}: a world of a server has one for all its arms; make an environment "
                    "for each of them"
                )
        self._count = len(settings)
        self.threads = 0 if threads is None else threads
        self._wanted: tuple[str, ...] = _OBSERVED
        if autoreset is AutoresetMode.SAME_STEP:
            self._wanted += _FINAL
        super().__init__(
            access,
            world_settings(settings[0])
            | {
                "num_envs": self._count,
                "max_episode_steps": -1 if max_episode_steps is None else max_episode_steps,
                "autoreset_mode": autoreset.name.lower(),
                "threads": self.threads,
            },
        )
        self.observation_bounds = [self.bounds] * self._count
        self.ended: Flags = np.zeros(self._count, np.bool_)
        self._begun = False
        self._standing: dict[str, Float] = {}

    def reset(
        self, mask: list[bool], seeds: list[int | None], phase: float | None
    ) -> tuple[Float, Infos]:
        request = EnvironmentRequest()
        request.reset.SetInParent()
        settings = request.reset.settings
        chosen = np.array(mask, np.bool_)
        given = np.array([each is not None for each in seeds])
        if not chosen.all():
            pack(settings["reset_mask"], chosen)
        if given.any():
            pack(settings["seed"], np.array([each or 0 for each in seeds], np.uint64))
            pack(settings["seed_mask"], given)
        if phase is not None:
            pack(settings["phase"], phase)

        def use(answer: Any) -> tuple[Float, Infos]:
            lengths, _, _, _, infos = self._result(answer, chosen)
            self.ended = self.ended & ~chosen
            return lengths, infos

        return self.change(request, self.step_request(_OBSERVED), use=use)

    def step(self, actions: ArrayLike) -> tuple[Float, Float, Flags, Flags, Infos]:
        def use(answer: Any) -> tuple[Float, Float, Flags, Flags, Infos]:
            result = self._result(answer, np.ones(self._count, np.bool_))
            _, _, terminated, truncated, infos = result
            self.ended = terminated | truncated
            if self._wanted is not _OBSERVED and self.ended.any():
                self._add_finals(infos, answer, self.ended)
                self.ended = np.zeros(self._count, np.bool_)
            return result

        with self.lock:
            self.assure()
            request = self.step_request(self._wanted)
            pack(request.step.actions[self._action], _core.check_actions(actions, self._count))
            if not self._begun:
                raise ValueError(
                    "step of environment 0: no episode runs before reset or after its end; call "
                    "reset first"
                )
            return self.change(request, use=use)

    def _result(self, answer: Any, chosen: Flags) -> tuple[Float, Float, Flags, Flags, Infos]:
        """What an answer brings; infos of those that are chosen."""
        self._begun = True
        self._standing = {}
        lengths, rewards, terminated, truncated = (
            self._observation(answer, name) for name in _OBSERVED[:4]
        )
        everybody = chosen.all()
        infos: Infos = {}
        for name in INFO:
            values = self._observation(answer, name)
            if not everybody:
                values[~chosen] = 0
            infos |= {name: values, f"_{name}": chosen.copy()}
        if everybody and terminated.any():
            # An episode that begins has no failure.
            self._add_failures(infos, self._observation(answer, "failure"), np.arange(self._count))
        return lengths, rewards, terminated, truncated, infos

    def _observation(self, answer: Any, name: str) -> Any:
        return unpack(answer.observations[self._uids[name]])

    def _add_failures(self, infos: Infos, texts: list[str], places: NDArray[np.int64]) -> None:
        """Add why episodes failed, where they did."""
        pairs = [(place, text) for place, text in zip(places.tolist(), texts, strict=True) if text]
        if pairs:
            infos["failure"] = np.full(self._count, None, object)
            infos["_failure"] = np.zeros(self._count, np.bool_)
            for place, text in pairs:
                infos["failure"][place], infos["_failure"][place] = text, True

    def _add_finals(self, infos: Infos, answer: Any, ended: Flags) -> None:
        """Add the ends of episodes in whose places others have begun within the same step."""
        places = np.flatnonzero(ended)
        final: Infos = {}
        for name in INFO:
            rows = self._observation(answer, f"final_{name}")
            values = np.zeros((self._count, *rows.shape[1:]), rows.dtype)
            values[places] = rows
            final |= {name: values, f"_{name}": ended.copy()}
        self._add_failures(final, self._observation(answer, "final_failure"), places)
        last = np.full(self._count, None, object)
        rows = self._observation(answer, "final_spring_lengths")
        for place, row in zip(places.tolist(), rows, strict=True):
            last[place] = row.copy()
        infos |= {"final_info": final, "_final_info": ended.copy()}
        infos |= {"final_obs": last, "_final_obs": ended.copy()}

    def infos(self) -> Infos:
        found = self.read(*INFO)
        infos: Infos = {}
        for name, values in zip(INFO, found, strict=True):
            infos |= {name: values, f"_{name}": np.ones(self._count, np.bool_)}
        return infos

    def teacher_actions(self) -> Float:
        return self.table("teacher_action")

    def _loaded(self, begun: bool, ended: Any) -> None:
        self._begun, self.ended = begun, ended
        self._standing = {}

    def joints(self, index: int) -> Float:
        return np.array(self._of_all("arm_joints")[index])

    def positions(self, index: int) -> Float:
        return np.array(self._of_all("arm_positions")[index])

    def _of_all(self, key: str) -> Float:
        """A property of all arms, which is asked for once where they stand."""
        if key not in self._standing:
            self._standing[key] = self.table(key)
        return self._standing[key]

    @property
    def action_ranges(self) -> Float:
        return np.full(self._count, self.action_range)

    @property
    def amplitudes(self) -> Float:
        return np.full(self._count, self.amplitude)

    @property
    def periods(self) -> Float:
        return np.full(self._count, self.period)

    @property
    def orbit_tables(self) -> list[Float]:
        orbit = self.orbit
        return [orbit.copy() for _ in range(self._count)]


class RemoteOctoArmVectorEnv(OctoArmVectorEnv):
    """The batch of environments ``OctoArm-v0`` computed by a server, in one world, over one stream.

    What ``gym.make_vec("OctoArmRemote-v0", num_envs=..., address=...)`` makes. Spaces, rewards,
    autoreset modes, infos, seeds, pictures, pickle and deepcopy are those of
    :class:`octoarm_env.OctoArmVectorEnv`, to the bit; a step of all arms is one round trip. Errors,
    interrupts and threads are those of :class:`octoarm_env.remote.RemoteOctoArm`: after a stream
    that broke or was interrupted, a :meth:`reset` of all environments goes on, in a new world.

    A ``snapshot`` holds states as bytes, less than half as many as their JSON text has;
    ``restore`` takes those of the local batch too.

    Args:
        num_envs: number of environments N, from 1 to what the server allows.
        address, token, token_file, certificate, timeout, reconnect: as `RemoteOctoArm` takes them.
        arguments: those of :class:`octoarm_env.OctoArmVectorEnv`, by name; but `target`,
            `amplitude` and `arm` are the same for all. `threads` are the server's: None, as many as
            it allows.
    """

    def __init__(
        self,
        num_envs: int = 1,
        address: str = "127.0.0.1:50051",
        *,
        token: str | None = None,
        token_file: str | Path | None = None,
        certificate: str | Path | None = None,
        timeout: float = 60.0,
        reconnect: bool = False,
        **arguments: Any,
    ) -> None:
        self._access = Access(address, token, token_file, certificate, timeout, reconnect)
        super().__init__(num_envs, **arguments)

    _fixed = OctoArmVectorEnv._fixed | RemoteOctoArm._fixed
    _remedy = 'gym.make_vec("OctoArmRemote-v0", ..., {}=...)'
    _single = RemoteOctoArm
    _core: RemoteEpisodeBatch  # type: ignore[assignment]  # it does what the compiled one does

    def _new_core(self) -> RemoteEpisodeBatch:  # type: ignore[override]
        _, max_episode_steps, _, threads = self._arguments
        return RemoteEpisodeBatch(
            self._access, self._settings, max_episode_steps, self.autoreset_mode, threads
        )

    def _kept(self, spec: EnvSpec) -> EnvSpec:
        return without_token(super()._kept(spec))

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Float, Infos]:
        """Begin episodes on the orbit, as :meth:`octoarm_env.batch.BatchEnv.reset` does.

        Where the stream broke or was interrupted, a reset of all goes on, on a new one, in a new
        world; environments without a seed then draw theirs from `np_random`, as at the first reset.
        """
        core = self._core
        with core.lock:
            if core is self._core and core.is_lost() and self._mask(options).all():
                self._core = self._new_core()
                self._seeds = [None] * self.num_envs
        return super().reset(seed=seed, options=options)

    def close_extras(self, **kwargs: Any) -> None:
        """Let go of what drew, and end the stream; the server frees the world."""
        super().close_extras(**kwargs)
        self._core.close()
