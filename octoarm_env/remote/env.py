"""The environment whose episode is computed by a server."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from octoarm_env import _core
from octoarm_env._core import Request
from octoarm_env.arrays import Float
from octoarm_env.env import OctoArmEnv
from octoarm_env.remote.served import ACCESS, ServedEnv
from octoarm_env.remote.world import Access, CycleWorld, StepAnswer, world_settings
from octoarm_env.settings import EpisodeSettings

__all__ = ["RemoteOctoArm"]

_RUNNING, _TERMINATED = 1, 2
_OBSERVED = ("spring_lengths", "reward", *CycleWorld._info, "failure")


class RemoteEpisode(CycleWorld):
    """An episode in a world of its own on a server, with the methods of the compiled `Episode`.

    A seed is in [0, 2**64). Errors are a ValueError or TypeError that names the argument, its value
    and what is allowed; nothing is changed then.
    """

    def __init__(self, access: Access, settings: EpisodeSettings) -> None:
        # It does not end by itself.
        super().__init__(access, world_settings(settings) | {"max_episode_steps": -1})
        self.observation_bounds = self.bounds
        self._running = False

    def seed(self, seed: int) -> None:
        self.change(Request.write("seed", seed), use=lambda answer: None)

    def reset(self, phase: float | None = None) -> tuple[Float, dict[str, Any]]:
        request = Request.reset({} if phase is None else {"phase": phase})

        def use(answer: StepAnswer) -> tuple[Float, dict[str, Any]]:
            lengths, _, _, info = self._result(answer)
            return lengths, info

        return self.change(request, self.step_request(_OBSERVED), use=use)

    def step(self, action: ArrayLike) -> tuple[Float, float, bool, dict[str, Any]]:
        with self.lock:
            self.assure()
            checked = _core.check_step(action, self._running)
            return self.change(self.step_request(_OBSERVED, checked), use=self._result)

    def _result(self, answer: StepAnswer) -> tuple[Float, float, bool, dict[str, Any]]:
        state, found = answer
        self._running, terminated = state == _RUNNING, state == _TERMINATED
        info: dict[str, Any] = {}
        for name in self._info:
            value = found[self._numbers[name]]
            scalar = np.int64 if isinstance(value, int) else np.float64
            info[name] = value if isinstance(value, np.ndarray) else scalar(value)
        if terminated:
            info["failure"] = found[self._numbers["failure"]]
        lengths, reward = (found[self._numbers[name]] for name in ("spring_lengths", "reward"))
        return lengths, reward, terminated, info

    def teacher_action(self) -> Float:
        return self.table("teacher_action")

    def _loaded(self, begun: bool, ended: Any) -> None:
        self._running = begun and not ended

    @property
    def joints(self) -> Float:
        return self.table("arm_joints")

    @property
    def positions(self) -> Float:
        return self.table("arm_positions")


class RemoteOctoArm(ServedEnv, OctoArmEnv):
    """``OctoArm-v0`` computed by a server: the same environment, the same bits, over gRPC.

    Spaces, rewards, starting states, ends, infos, pictures, pickle and deepcopy are those of
    :class:`octoarm_env.OctoArmEnv`; but infos do not tell of disturbances. Every environment has a
    stream and a world of its own; both are freed by `close`, with the object, or with the process.
    A pickle holds the address and the token, and goes on in a world of its own on the same server.
    `spec` holds the address and `token_file`, but no token: an environment that is made of it takes
    ``OCTOARM_TOKEN``.

    Args:
        address: where the server is: ``host:port``, ``http://host:port``, or ``https://host:port``
            for TLS.
        token: what a server that asks for one is told; never sent to another machine without TLS.
            None: the one in `token_file`, or in the environment variable ``OCTOARM_TOKEN``, if any.
        token_file: a file with the token, which is read whenever a stream begins.
        certificate: a file (PEM) with the certificate that the server's is signed with, or its own;
            None: the machine's usual ones.
        timeout: time that the server may take for an answer [s]; somebody must answer at the
            address within 10 s of it.
        reconnect: go on by itself where the stream broke, such as over a restart of the server: in
            a new world that is brought to where the old one stood, so that not a bit of the episode
            changes. The server may be away for `timeout`.
        arguments: those of :class:`octoarm_env.OctoArmEnv`, by name.

    Raises:
        ValueError, TypeError: a wrong argument, by name, with its value and what is allowed.
        ConnectionError: nobody answers; and from any method, when the stream breaks, or was ended
            by an interrupt.
        TimeoutError: an answer took longer than `timeout`, which ends the stream.
        PermissionError: the server wants a token, or another one.
        RemoteError: the server refuses, such as for too many worlds, or is of another version.

    Ctrl-C, or an exception from a signal's handler, between a request and its answer ends the
    stream: whether the arm made that step is then unknown. Every method but `reset` and
    `close` raises ConnectionError from then on; `reset` goes on in a new world on the
    same server, as it does where the stream broke. With `reconnect` every method goes on, as if
    what was broken into had not been asked for. Threads that share an environment take turns, a
    request and its answer at a time.

    As with the local environment, ``gym.make("OctoArmRemote-v0", address=...)`` adds the time limit
    of 500 steps; this class alone has none. gRPC does not survive a fork: start processes that step
    environments by ``"spawn"`` or ``"forkserver"``, or before the first environment is made.
    """

    _fixed = OctoArmEnv._fixed | ACCESS
    _remedy = 'gym.make("OctoArmRemote-v0", {}=...)'
    _core: RemoteEpisode  # type: ignore[assignment]  # it does what the compiled one does

    def _new_core(self) -> RemoteEpisode:
        return RemoteEpisode(self._access, self._settings)
