"""A world of its own on a server: what is common to one arm and to many."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
from gymnasium.envs.registration import EnvSpec

from octoarm_env._core import Request
from octoarm_env.arguments import flag
from octoarm_env.arrays import Float
from octoarm_env.remote.connection import TOKEN_VARIABLE, Connection, Specs
from octoarm_env.settings import Settings

_KEPT = 64
"""Requests after which the state is asked for, from which a broken stream is resumed.

The state in every answer would make a step of one arm twice as long, and that of 256 longer by a
quarter; after 64 requests it is a hundredth or less. A lease on the server would cost less, but
would go with the server.
"""

T = TypeVar("T")
StepAnswer = tuple[int, dict[int, Any]]
"""State of the protocol, and the observations by their numbers."""


@dataclass(frozen=True)
class Access:
    """How a server is reached: what `RemoteOctoArm` takes, under the same names."""

    address: str = "127.0.0.1:50051"
    token: str | None = field(default=None, repr=False)
    token_file: str | Path | None = None
    certificate: str | Path | None = None
    timeout: float = 60.0
    reconnect: bool = False

    def __post_init__(self) -> None:
        """Check what no connection checks."""
        flag("reconnect", self.reconnect)
        if self.token is not None and self.token_file is not None:
            raise ValueError("token and token_file: give one of them")

    def _secret(self) -> str | None:
        """The token as it is now: it may be exchanged while an environment lives."""
        if self.token is not None:
            return self.token
        if self.token_file is None:
            return os.environ.get(TOKEN_VARIABLE, "").strip() or None
        lines = Path(self.token_file).read_text(encoding="utf-8").splitlines()
        words = [line.split() for line in lines if line.strip() and not line.startswith("#")]
        if len(words) != 1 or len(words[0]) > 2:
            raise ValueError(
                f"token_file = {str(self.token_file)!r}: expected one token, on a line of its own"
            )
        # Before it may stand its name, as in the server's file.
        return words[0][-1]

    def connect(self, patience: float | None = None) -> Connection:
        """Open a stream, for whose server is waited so long [s]."""
        return Connection(
            self.address,
            token=self._secret(),
            certificate=self.certificate,
            timeout=self.timeout,
            patience=patience,
        )


def without_token(spec: EnvSpec) -> EnvSpec:
    """A spec as it may be written to a file."""
    kwargs = {name: value for name, value in spec.kwargs.items() if name != "token"}
    return replace(spec, kwargs=kwargs)


def world_settings(settings: Settings) -> dict[str, Any]:
    """What a server makes a world of, whose episodes have these settings."""
    world: dict[str, Any] = {}
    for name, value in settings.to_dict().items():
        if isinstance(value, dict):
            world |= {f"{name}.{entry}": each for entry, each in value.items()}
        elif value is not None:
            world[name] = value
    return world


class RemoteWorld:
    """A world, and the stream that has made and joined it.

    With `Access.reconnect`, a stream that broke is followed by another one, in a new world that is
    brought to where the old one stood: it is given the last state that was asked for, and the
    requests that changed it since then. Physics does the rest, which is the same to the bit.

    Attributes:
        connection: the present stream.
        lock: held during a request and its answer.
        observation_len: spring lengths of an arm.
        action_len: numbers of an arm's action.
        bounds: of the spring lengths [m].
    """

    def __init__(self, access: Access, settings: dict[str, Any]) -> None:
        self._access = access
        self._settings = settings
        self.lock = threading.RLock()
        # All that has brought the world to where it stands.
        self._past: list[Request] = []
        self.connection = access.connect()
        try:
            actions, observations = self._enter(self.connection)
        except BaseException:
            self.connection.close()
            raise
        self._numbers = {name: spec.number for name, spec in observations.items()}
        (action,) = actions.values()
        self._action, self.action_len = action.number, action.shape[-1]
        lengths = observations["spring_lengths"]
        self.observation_len = lengths.shape[-1]
        if not (lengths.low and lengths.high):
            raise RuntimeError("the server tells no bounds of spring_lengths")
        self.bounds = (lengths.low[0], lengths.high[0])

    def _enter(self, connection: Connection) -> tuple[Specs, Specs]:
        return connection.exchange(lambda: connection.enter_world(self._settings))

    def _resume(self) -> None:
        """Go on over a new stream, in a new world that stands where the old one stood."""
        connection = self._access.connect(self._access.timeout)

        def replay() -> None:
            for request in self._past:
                connection.post(request.blind())
            for request in self._past:
                connection.answer(request.kind)

        try:
            self._enter(connection)
            connection.exchange(replay)
        except BaseException:
            connection.close()
            raise
        lost, self.connection = self.connection, connection
        lost.close()

    def is_lost(self) -> bool:
        """Tell whether the stream has ended, and is not followed by another one by itself."""
        return not self._access.reconnect and self.connection.is_lost()

    def close(self) -> None:
        """End the stream; the server frees the world."""
        self.connection.close()

    def exchange(self, work: Callable[[Connection], T]) -> T:
        """Do as `Connection.exchange`; with `reconnect`, again where the stream broke."""
        with self.lock:
            if self._access.reconnect and self.connection.is_lost():
                self._resume()
            connection = self.connection
            try:
                return connection.exchange(lambda: work(connection))
            except ConnectionError:
                if not (self._access.reconnect and connection.is_lost()):
                    raise
            self._resume()
            connection = self.connection
            return connection.exchange(lambda: work(connection))

    def assure(self) -> None:
        """Raise ConnectionError if the stream has ended, or go on over another one.

        What is known of the world on this side holds only if the last answer was made use of.
        """
        self.exchange(lambda connection: None)

    def change(self, *requests: Request, use: Callable[[Any], T]) -> T:
        """Send requests that change the world, each after the answer to the one before it.

        Args:
            requests: at least one; a refused one changes nothing, and none follows it.
            use: makes the result of the last answer.
        """

        def work(connection: Connection) -> T:
            for request in requests:
                answer = connection.ask(request)
            result = use(answer)
            if self._access.reconnect:
                if len(self._past) >= _KEPT:
                    self._past = [Request.write("state_bytes", connection.read("state_bytes"))]
                else:
                    self._past = [*self._past, *requests]
            return result

        return self.exchange(work)

    def step_request(self, wanted: tuple[str, ...], action: Float | None = None) -> Request:
        """A step, which brings what is wanted."""
        numbers = [self._numbers[name] for name in wanted]
        return Request.step(numbers, None if action is None else (self._action, action))

    def read(self, *keys: str) -> Any:
        """Read a property, or a list of several."""
        found = self.exchange(lambda connection: [connection.read(key) for key in keys])
        return found if len(keys) > 1 else found[0]

    def table(self, key: str) -> Float:
        """Read a property that is an array of its own."""
        return np.asarray(self.read(key), np.float64)

    def save(self) -> bytes:
        """All that the episodes need to go on, as the server writes it in bytes."""
        return bytes(self.read("state_bytes"))

    def load(self, state: bytes | str) -> None:
        """Go on where a state stands: bytes, or the JSON text of a local episode or batch."""
        if not isinstance(state, bytes | str):
            raise TypeError(f"state must be bytes or a text, not {type(state).__name__}")
        key = "state" if isinstance(state, str) else "state_bytes"
        request = Request.write(key, state)

        def work(connection: Connection) -> None:
            connection.ask(request)
            begun, ended = (connection.read(name) for name in ("begun", "ended"))
            self._loaded(bool(begun), ended)
            self._past = [request]

        self.exchange(work)

    def _loaded(self, begun: bool, ended: Any) -> None:
        """Take note of where a loaded state stands."""
        raise NotImplementedError


class CycleWorld(RemoteWorld):
    """A world whose arms follow a limit cycle."""

    _info: ClassVar[tuple[str, ...]] = (
        *("base_angles", "target", "tracking_error", "reward_tracking", "reward_action_change"),
        "body",
    )
    """What a step tells of an arm in numbers."""

    @cached_property
    def action_range(self) -> float:
        """Degrees of base rotation at an action of 1."""
        return float(self.read("action_range"))

    @cached_property
    def amplitude(self) -> float:
        """Largest |angle| of the target [degrees]."""
        return float(self.read("amplitude"))

    @cached_property
    def period(self) -> float:
        """Time of one turn of the target [s]."""
        return float(self.read("period"))

    @property
    def orbit(self) -> Float:
        """The target over one period, (K, 2) [degrees]."""
        return self.table("orbit")
