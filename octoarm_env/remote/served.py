"""Environments whose episodes are computed by a server: what those of all tasks have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from gymnasium.envs.registration import EnvSpec

from octoarm_env.batch import BatchEnv
from octoarm_env.remote.world import Access, RemoteWorld, without_token
from octoarm_env.single import SingleEnv

ACCESS = frozenset(argument.name for argument in fields(Access))
"""Names of the arguments that say how a server is reached."""


class ServedEnv(SingleEnv):
    """An environment of one arm, before the class of its task among the bases."""

    _core: RemoteWorld

    def __init__(
        self,
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
        super().__init__(**arguments)

    def _kept(self, spec: EnvSpec) -> EnvSpec:
        return without_token(super()._kept(spec))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode, as the local environment does.

        Where the stream broke or was interrupted, on a new one, in a new world; without a seed
        `np_random` then seeds its resets, as at the first one.
        """
        core = self._core
        with core.lock:
            if core is self._core and core.is_lost():
                self._core = self._new_core()
                self._seeded = False
        return super().reset(seed=seed, options=options)

    def close(self) -> None:
        """Close the window, if there is one, and the stream; the server frees the world."""
        super().close()
        self._core.close()


class ServedBatchEnv(BatchEnv):
    """A batch of environments in one world, before the class of its task among the bases."""

    _core: RemoteWorld

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
        super().__init__(num_envs, **arguments)  # type: ignore[call-arg]  # those of the task

    def _kept(self, spec: EnvSpec) -> EnvSpec:
        return without_token(super()._kept(spec))

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Begin episodes, as :meth:`octoarm_env.batch.BatchEnv.reset` does.

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
