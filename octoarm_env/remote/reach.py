"""Reaching that is computed by a server: one arm, or many in one world."""

from __future__ import annotations

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike

from octoarm_env import _core
from octoarm_env.arrays import Float
from octoarm_env.reach import OctoArmReachEnv, OctoArmReachVectorEnv, ReachSettings
from octoarm_env.remote.batch import RemoteBatch
from octoarm_env.remote.served import ACCESS, ServedBatchEnv, ServedEnv
from octoarm_env.remote.world import Access, StepAnswer, world_settings

__all__ = ["RemoteOctoArmReach", "RemoteOctoArmReachVectorEnv"]


class RemoteReachBatch(RemoteBatch):
    """Episodes of reaching in a world of their own, with the methods of the compiled batch."""

    _info = ("is_success", "distance", "body")
    _ask = "goal"

    def __init__(
        self,
        access: Access,
        settings: ReachSettings,
        count: int,
        max_episode_steps: int | None,
        autoreset: AutoresetMode,
        threads: int | None,
    ) -> None:
        self._rates = settings.observe_rates
        seen = ("spring_lengths", "achieved_goal", "desired_goal")
        super().__init__(
            access,
            world_settings(settings) | {"task": "reach"},
            count,
            (*seen, "length_rates") if self._rates else seen,
            max_episode_steps,
            autoreset,
            threads,
        )
        self.observation_bounds = self.bounds
        if self._rates:
            self.observation_len *= 2

    def _checked(self, actions: ArrayLike) -> Float:
        return _core.check_reach_actions(actions, self._count, self.action_len)

    def _seen(self, answer: StepAnswer, before: str = "") -> dict[str, Float]:
        lengths = self._observation(answer, f"{before}spring_lengths")
        if self._rates:
            rates = self._observation(answer, f"{before}length_rates")
            lengths = np.concatenate((lengths, rates), axis=1)
        goals = ("achieved_goal", "desired_goal")
        places = {name: self._observation(answer, f"{before}{name}") for name in goals}
        return {"observation": lengths, **places}

    def _row(self, seen: dict[str, Float], index: int) -> dict[str, Float]:
        return {name: values[index].copy() for name, values in seen.items()}

    def activations(self, index: int) -> Float:
        return np.array(self._of_all("activations")[index])

    @property
    def goals(self) -> Float:
        return np.array(self._of_all("desired_goal"))

    @property
    def elapsed(self) -> list[int]:
        steps: list[int] = self._of_all("elapsed_steps").tolist()
        return steps


class RemoteOctoArmReach(ServedEnv, OctoArmReachEnv):
    """``OctoArmReach-v0`` computed by a server: the same environment, the same bits, over gRPC.

    Spaces, rewards, starting states, ends, infos, pictures, pickle, deepcopy and `compute_reward`
    are those of :class:`octoarm_env.reach.OctoArmReachEnv`, but infos do not tell of disturbances;
    streams, errors, interrupts and threads those of :class:`octoarm_env.remote.RemoteOctoArm`. The
    world is a batch of one arm.

    Args:
        address, token, token_file, certificate, timeout, reconnect: as `RemoteOctoArm` takes them.
        arguments: those of :class:`octoarm_env.reach.OctoArmReachEnv`, by name.

    Raises:
        ValueError, TypeError: a wrong argument, by name, with its value and what is allowed.
        ConnectionError, TimeoutError, PermissionError, RemoteError: as of `RemoteOctoArm`.

    As with the local environment, ``gym.make("OctoArmReachRemote-v0", address=...)`` adds the time
    limit of 100 steps; this class alone has none.
    """

    _fixed = OctoArmReachEnv._fixed | ACCESS
    _remedy = 'gym.make("OctoArmReachRemote-v0", {}=...)'
    _core: RemoteReachBatch  # type: ignore[assignment]  # it does what the compiled one does

    def _new_core(self) -> RemoteReachBatch:  # type: ignore[override]
        mode = AutoresetMode.DISABLED
        return RemoteReachBatch(self._access, self._settings, 1, None, mode, 1)


class RemoteOctoArmReachVectorEnv(ServedBatchEnv, OctoArmReachVectorEnv):
    """The batch of environments ``OctoArmReach-v0`` computed by a server, in one world.

    What ``gym.make_vec("OctoArmReachRemote-v0", num_envs=..., address=...)`` makes. Everything
    returned is that of :class:`octoarm_env.reach.OctoArmReachVectorEnv`, to the bit; streams and
    snapshots are those of :class:`octoarm_env.remote.RemoteOctoArmVectorEnv`.

    Args:
        num_envs: number of environments N, from 1 to what the server allows.
        address, token, token_file, certificate, timeout, reconnect: as `RemoteOctoArm` takes them.
        arguments: those of :class:`octoarm_env.reach.OctoArmReachVectorEnv`, by name; `threads` are
            the server's: None, as many as it allows.
    """

    _fixed = OctoArmReachVectorEnv._fixed | RemoteOctoArmReach._fixed
    _remedy = 'gym.make_vec("OctoArmReachRemote-v0", ..., {}=...)'
    _single = RemoteOctoArmReach
    _core: RemoteReachBatch  # type: ignore[assignment]  # it does what the compiled one does

    def _new_core(self) -> RemoteReachBatch:  # type: ignore[override]
        return RemoteReachBatch(
            self._access,
            self._settings,
            self.num_envs,
            self._max_episode_steps,
            self.autoreset_mode,
            self._threads,
        )
