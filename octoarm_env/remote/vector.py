"""Many environments whose episodes are computed by a server, in one world."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike

from octoarm_env import _core
from octoarm_env.arrays import Float
from octoarm_env.remote.batch import RemoteBatch
from octoarm_env.remote.env import RemoteOctoArm
from octoarm_env.remote.served import ServedBatchEnv
from octoarm_env.remote.world import Access, CycleWorld, StepAnswer, world_settings
from octoarm_env.settings import EpisodeSettings
from octoarm_env.vector import OctoArmVectorEnv

__all__ = ["RemoteOctoArmVectorEnv"]


class RemoteEpisodeBatch(RemoteBatch, CycleWorld):
    """Episodes along a target in a world of their own, with the methods of the compiled batch."""

    _ask = "phase"

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
        super().__init__(
            access,
            world_settings(settings[0]),
            len(settings),
            ("spring_lengths",),
            max_episode_steps,
            autoreset,
            threads,
        )
        self.observation_bounds = [self.bounds] * self._count

    def _checked(self, actions: ArrayLike) -> Float:
        return _core.check_actions(actions, self._count)

    def _seen(self, answer: StepAnswer, before: str = "") -> Float:
        lengths: Float = self._observation(answer, f"{before}spring_lengths")
        return lengths

    def _row(self, seen: Float, index: int) -> Float:
        row: Float = seen[index].copy()
        return row

    def teacher_actions(self) -> Float:
        return self.table("teacher_action")

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


class RemoteOctoArmVectorEnv(ServedBatchEnv, OctoArmVectorEnv):
    """The batch of environments ``OctoArm-v0`` computed by a server, in one world, over one stream.

    What ``gym.make_vec("OctoArmRemote-v0", num_envs=..., address=...)`` makes. Spaces, rewards,
    autoreset modes, infos, seeds, pictures, pickle and deepcopy are those of
    :class:`octoarm_env.OctoArmVectorEnv`, to the bit; a step of all arms is one round trip. Errors,
    interrupts and threads are those of :class:`octoarm_env.remote.RemoteOctoArm`: after a stream
    that broke or was interrupted, a `reset` of all environments goes on, in a new world.

    A ``snapshot`` holds states as bytes, less than half as many as their JSON text has;
    ``restore`` takes those of the local batch too.

    Args:
        num_envs: number of environments N, from 1 to what the server allows.
        address, token, token_file, certificate, timeout, reconnect: as `RemoteOctoArm` takes them.
        arguments: those of :class:`octoarm_env.OctoArmVectorEnv`, by name; but `target`,
            `amplitude` and `arm` are the same for all. `threads` are the server's: None, as many as
            it allows.
    """

    _fixed = OctoArmVectorEnv._fixed | RemoteOctoArm._fixed
    _remedy = 'gym.make_vec("OctoArmRemote-v0", ..., {}=...)'
    _single = RemoteOctoArm
    _core: RemoteEpisodeBatch  # type: ignore[assignment]  # it does what the compiled one does

    def _new_core(self) -> RemoteEpisodeBatch:  # type: ignore[override]
        _, max_episode_steps, _, threads = self._arguments
        return RemoteEpisodeBatch(
            self._access, self._settings, max_episode_steps, self.autoreset_mode, threads
        )
