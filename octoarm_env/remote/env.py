"""The environment whose episode is computed by a server."""

from __future__ import annotations

import inspect
import json
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from octoarm_env import _core
from octoarm_env.arrays import Float
from octoarm_env.env import OctoArmEnv
from octoarm_env.remote.connection import Connection
from octoarm_env.remote.messages import EnvironmentRequest, pack, unpack
from octoarm_env.settings import EpisodeSettings

__all__ = ["RemoteOctoArm"]

_RUNNING, _TERMINATED = 1, 2
_INFO = ("base_angles", "target", "tracking_error", "reward_tracking", "reward_action_change")
_OBSERVED = ("spring_lengths", "reward", *_INFO, "failure")


class RemoteEpisode:
    """An episode in a world of its own on a server, with the methods of the compiled `Episode`.

    A seed is in [0, 2**64), a saved episode is JSON text. Errors are a ValueError or TypeError that
    names the argument, its value and what is allowed; nothing is changed then.
    """

    def __init__(self, connection: Connection, settings: EpisodeSettings) -> None:
        self.connection = connection
        world: dict[str, Any] = {"max_episode_steps": -1}  # it does not end by itself
        for name, value in settings.to_dict().items():
            if isinstance(value, dict):
                world |= {f"{name}.{field}": entry for field, entry in value.items()}
            elif value is not None:
                world[name] = value
        specs = connection.exchange(lambda: connection.enter_world(world))
        observations = {spec.name: uid for uid, spec in specs.observations.items()}
        (self._action,) = (uid for uid, spec in specs.actions.items() if spec.name == "action")
        self._uids = {name: observations[name] for name in _OBSERVED}
        lengths = specs.observations[self._uids["spring_lengths"]]
        self.observation_len = int(lengths.shape[0])
        self.observation_bounds = (lengths.min.doubles.array[0], lengths.max.doubles.array[0])
        self._running = False

    def seed(self, seed: int) -> None:
        self.connection.exchange(lambda: self.connection.write("seed", seed))

    def reset(self, phase: float | None = None) -> tuple[Float, dict[str, Any]]:
        request = EnvironmentRequest()
        request.reset.SetInParent()
        if phase is not None:
            pack(request.reset.settings["phase"], phase)

        def work() -> tuple[Float, dict[str, Any]]:
            self.connection.post(request)
            # A refused reset changes nothing, so nothing may follow it.
            self.connection.answer("reset")
            self.connection.post(self._step_request())
            lengths, _, _, info = self._answer()
            return lengths, info

        return self.connection.exchange(work)

    def step(self, action: ArrayLike) -> tuple[Float, float, bool, dict[str, Any]]:
        def work() -> tuple[Float, float, bool, dict[str, Any]]:
            checked = _core.check_step(action, self._running)
            request = self._step_request()
            tensor = request.step.actions[self._action]
            tensor.doubles.array.extend(checked.tolist())
            tensor.shape.append(2)
            self.connection.post(request)
            return self._answer()

        return self.connection.exchange(work)

    def _step_request(self) -> Any:
        request = EnvironmentRequest()
        request.step.requested_observations.extend(self._uids.values())
        return request

    def _answer(self) -> tuple[Float, float, bool, dict[str, Any]]:
        step = self.connection.answer("step")
        found = step.observations
        self._running = step.state == _RUNNING
        terminated = step.state == _TERMINATED
        info: dict[str, Any] = {}
        for name in _INFO:
            value = unpack(found[self._uids[name]])
            info[name] = value if isinstance(value, np.ndarray) else np.float64(value)
        if terminated:
            info["failure"] = unpack(found[self._uids["failure"]])
        lengths = unpack(found[self._uids["spring_lengths"]])
        return lengths, unpack(found[self._uids["reward"]]), terminated, info

    def teacher_action(self) -> Float:
        return self._table("teacher_action")

    def save(self) -> str:
        return str(self._read("state"))

    def load(self, state: str) -> None:
        def work() -> None:
            self.connection.write("state", state)
            self._running = bool(json.loads(state)["running"])

        self.connection.exchange(work)

    def _read(self, key: str) -> Any:
        return self.connection.exchange(lambda: self.connection.read(key))

    def _table(self, key: str) -> Float:
        return np.asarray(self._read(key), np.float64)

    @cached_property
    def action_range(self) -> float:
        return float(self._read("action_range"))

    @cached_property
    def amplitude(self) -> float:
        return float(self._read("amplitude"))

    @cached_property
    def period(self) -> float:
        return float(self._read("period"))

    @property
    def orbit(self) -> Float:
        return self._table("orbit")

    @property
    def joints(self) -> Float:
        return self._table("arm_joints")

    @property
    def positions(self) -> Float:
        return self._table("arm_positions")


class RemoteOctoArm(OctoArmEnv):
    """``OctoArm-v0`` computed by a server: the same environment, the same bits, over gRPC.

    Spaces, rewards, starting states, ends, infos, pictures, pickle and deepcopy are those of
    :class:`octoarm_env.OctoArmEnv`. Every environment has a stream and a world of its own; both are
    freed by :meth:`close`, with the object, or with the process. A pickle holds the address and the
    token, and goes on in a world of its own on the same server; `spec` holds them too, so that
    whoever writes it to a file, as Minari does, writes the token.

    Args:
        address: where the server is: ``host:port``, ``http://host:port``, or ``https://host:port``
            for TLS.
        token: what a server that asks for one is told; never sent to another machine without TLS.
        certificate: a file (PEM) with the certificate that the server's is signed with, or its own;
            None: the machine's usual ones.
        timeout: time to wait for the server at the begin [s].
        arguments: those of :class:`octoarm_env.OctoArmEnv`, by name.

    Raises:
        ValueError, TypeError: a wrong argument, by name, with its value and what is allowed.
        ConnectionError: nobody answers; and from any method, when the stream breaks, or was ended
            by an interrupt.
        PermissionError: the server wants a token, or another one.
        RemoteError: the server refuses, such as for too many worlds.

    Ctrl-C, or an exception from a signal's handler, between a request and its answer ends the
    stream: whether the arm made that step is then unknown. Every method but :meth:`reset` and
    :meth:`close` raises ConnectionError from then on; :meth:`reset` goes on in a new world on the
    same server, as it does where the stream broke. Threads that share an environment take turns, a
    request and its answer at a time.

    As with the local environment, ``gym.make("OctoArmRemote-v0", address=...)`` adds the time limit
    of 500 steps; this class alone has none. gRPC does not survive a fork: start processes that step
    environments by ``"spawn"`` or ``"forkserver"``, or before the first environment is made.
    """

    def __init__(
        self,
        address: str = "127.0.0.1:50051",
        *,
        token: str | None = None,
        certificate: str | Path | None = None,
        timeout: float = 10.0,
        **arguments: Any,
    ) -> None:
        self._server = (address, token, certificate, timeout)
        super().__init__(**arguments)

    _fixed = OctoArmEnv._fixed | set(inspect.signature(__init__).parameters) - {"self", "arguments"}
    _remedy = 'gym.make("OctoArmRemote-v0", {}=...)'
    _core: RemoteEpisode  # type: ignore[assignment]  # it does what the compiled one does

    def _new_core(self) -> RemoteEpisode:
        address, token, certificate, timeout = self._server
        connection = Connection(address, token=token, certificate=certificate, timeout=timeout)
        try:
            return RemoteEpisode(connection, self._settings)
        except BaseException:
            connection.close()
            raise

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float, dict[str, Any]]:
        """Begin an episode on the orbit, as :meth:`octoarm_env.OctoArmEnv.reset` does.

        Where the stream broke or was interrupted, on a new one, in a new world; without a seed
        `np_random` then seeds its phases, as at the first reset.
        """
        core = self._core
        with core.connection.lock:
            if core is self._core and core.connection.is_lost():
                self._core = self._new_core()
                self._seeded = False
        return super().reset(seed=seed, options=options)

    def close(self) -> None:
        """Close the window, if there is one, and the stream; the server frees the world."""
        super().close()
        self._core.connection.close()
