"""A stream to a server: requests, and their answers in the same order."""

from __future__ import annotations

import ipaddress
import os
import re
import threading
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple, TypeVar
from urllib.parse import urlsplit

from octoarm_env import _core
from octoarm_env._core import Request
from octoarm_env.arguments import positive
from octoarm_env.remote.tls import diagnose

_PORT = 50051
_INVALID_ARGUMENT, _FAILED_PRECONDITION = 3, 9
_VERSION = version("octoarm-env")
TOKEN_VARIABLE = "OCTOARM_TOKEN"
"""Environment variable that holds the token where no argument does."""
_CONNECTING = 10.0
"""Longest wait for somebody to answer at an address, unless more is asked for [s]."""
_QUICK = 0.5
"""Time after which is looked what stands between if nobody has answered [s]."""
_PROXIES = ("grpc_proxy", "https_proxy", "http_proxy")
"""Variables that name a proxy, as other clients of gRPC read them: the first that is set."""
_DIRECT = ("no_grpc_proxy", "no_proxy")
"""Variables that name the hosts to which no proxy leads: the first that is set."""

T = TypeVar("T")


class Spec(NamedTuple):
    """What there is of an action or an observation.

    Attributes:
        number: of its tensors in requests and answers.
        shape: of its tensors.
        low, high: bounds, where they are doubles: one for all elements, or one for each.
    """

    number: int
    shape: list[int]
    low: list[float] | None
    high: list[float] | None


Specs = dict[str, Spec]


class RemoteError(RuntimeError):
    """The server refused a request.

    Attributes:
        code: the canonical code of gRPC, such as 8 for RESOURCE_EXHAUSTED.
    """

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code

    def __reduce__(self) -> tuple[Any, ...]:
        return RemoteError, (self.code, str(self))


class _Refused(Exception):  # noqa: N818, it carries the error
    """The server's answer is an error; no signal handler raises this one."""

    def __init__(self, error: ValueError | RemoteError) -> None:
        super().__init__()
        self.error = error


class Connection:
    """A stream to a server.

    Requests and their answers go through :meth:`exchange`, which keeps them together.

    Args:
        address, token, certificate, timeout: as `RemoteOctoArm` takes them.
        patience: longest wait for somebody to answer at the address [s]; None: `timeout`, but at
            most 10 s.

    To 127.0.0.1, ::1 and ``localhost`` no proxy is asked. To other machines the way leads
    through the one that ``grpc_proxy``, ``https_proxy`` or ``http_proxy`` names, unless
    ``no_proxy`` names the host.

    Raises:
        ValueError, TypeError: a wrong argument, by name, with its value and what is allowed.
        ConnectionError: nobody answers.
        OSError: the certificate cannot be read.
    """

    def __init__(
        self,
        address: str,
        *,
        token: str | None = None,
        certificate: str | Path | None = None,
        timeout: float = 60.0,
        patience: float | None = None,
    ) -> None:
        host, port, encrypted = _parse(address, certificate)
        self._timeout = positive("timeout", timeout, "time [s]")
        patience = min(self._timeout, _CONNECTING) if patience is None else patience
        if token is not None and not (isinstance(token, str) and re.fullmatch("[!-~]+", token)):
            # Which is not shown.
            raise ValueError("token: expected a text of printable ASCII characters without spaces")
        local = _is_this_machine(host)
        if token is not None and not encrypted and not local:
            raise ValueError(
                f"address = {address!r}: a token is not sent to another machine without TLS; "
                "use https://, a certificate, or an SSH tunnel to the server's machine"
            )
        self.address = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        name, proxy = ("", "") if local else _variable(_PROXIES)
        self._proxy = _told(name, proxy) if proxy else ""
        roots = None if certificate is None else Path(certificate).read_bytes()
        self._hint = "" if token else f"; give token or token_file, or set {TOKEN_VARIABLE}"
        # Held during an exchange.
        self.lock = threading.RLock()
        # Whether a request was sent whose answer has not been made use of.
        self._owed = False
        # Why nothing can be sent any more.
        self._fault: str | None = None
        self._given_up = False
        self._interrupted = (
            f"the connection to {self.address} was closed: a request was interrupted before its "
            "answer came"
        )
        self._stream = _core.Stream(
            host,
            port,
            encrypted=encrypted,
            roots=roots,
            token=token,
            proxy=(proxy, _variable(_DIRECT)[1]) if proxy else None,
            patience=patience,
        )
        try:
            ready = self._stream.ready(min(_QUICK, patience))
            # What a proxy leads to cannot be looked at.
            fault = None if ready or proxy else diagnose(host, port, encrypted, roots)
            if fault is not None:
                raise ConnectionError(f"no way to the server at {self.address}: {fault}")
            if not (ready or self._stream.ready(patience)):
                how = "with TLS and a trusted certificate" if encrypted else "without TLS"
                raise ConnectionError(
                    f"no server answers at {self.address} {how} within {patience:g} s{self._proxy}"
                )
        except BaseException:
            self.close()
            raise

    def is_lost(self) -> bool:
        """Tell whether the stream has ended otherwise than by :meth:`close`.

        An interrupt on the way out of an :meth:`exchange` ends it here, and so does a signal's
        handler that asks in the midst of one.
        """
        with self.lock:
            if self._owed:
                self._end(self._interrupted)
            return self._fault is not None and not self._given_up

    def close(self) -> None:
        """End the stream; the server frees what it made. Any thread may do it at any time."""
        self._given_up = True
        self._end(f"the connection to {self.address} is closed")

    def _end(self, fault: str) -> None:
        self._fault = self._fault or fault
        self._stream.close()

    def exchange(self, work: Callable[[], T]) -> T:
        """Do something that sends requests, takes all their answers, and makes use of them.

        Threads take turns. What breaks in, such as Ctrl-C or what a signal's handler raises, ends
        the stream: an answer that is still to come must not be taken for that to another request.

        Raises:
            ValueError: the server found a value that it cannot use.
            RemoteError: the server refused the request for another reason.
            PermissionError: the server wants a token, or another one.
            ConnectionError: the stream is broken, or was ended before, which the message tells.
            TimeoutError: an answer took longer than `timeout`; the stream is ended.
        """
        with self.lock:
            hint = "; reset() connects anew and begins an episode" if self.is_lost() else ""
            if self._fault is not None:
                raise ConnectionError(self._fault + hint)
            try:
                result = work()
            except _Refused as refused:
                self._owed = False
                raise refused.error from None
            except BaseException:
                if self._owed:
                    self._end(self._interrupted)
                raise
            self._owed = False
            return result

    def post(self, request: Request) -> None:
        """Send a request, within an :meth:`exchange`, without waiting for its answer."""
        self._owed = True
        self._stream.send(request)

    def ask(self, request: Request) -> Any:
        """Send a request, within an :meth:`exchange`, and give what is answered."""
        self.post(request)
        return self.answer(request.kind)

    def answer(self, kind: str) -> Any:
        """Wait, within an :meth:`exchange`, for the next answer, which must be of this kind."""
        received = self._stream.receive(self._timeout)
        if received is None:
            fault = (
                f"timeout = {self._timeout:g} s: the server at {self.address} has not answered "
                f"{kind} within that time"
            )
            raise self._broken(fault, TimeoutError)
        found, content = received
        if found == "ended":
            raise self._ended(*content)
        if found == "error":
            code, message = content
            raise _Refused(
                ValueError(message) if code == _INVALID_ARGUMENT else RemoteError(code, message)
            )
        if found != kind:
            raise self._broken(f"the server at {self.address} answered {kind} by {found}")
        return content

    def _ended(self, code: str, details: str) -> OSError:
        """The exception for a stream that ended so."""
        if code == "OK":
            return self._broken(f"the server at {self.address} ended the stream")
        if code == "UNAUTHENTICATED":
            refusal = f"the server at {self.address} refuses: {details}{self._hint}"
            return self._broken(refusal, PermissionError)
        proxy = self._proxy if code == "UNAVAILABLE" else ""
        return self._broken(
            f"the connection to {self.address} is broken: {details} ({code}){proxy}"
        )

    def _broken(self, fault: str, kind: type[OSError] = ConnectionError) -> OSError:
        """The exception for a stream that broke, unless it was closed from this side meanwhile."""
        if self._fault is not None:
            return ConnectionError(self._fault)
        self._end(fault)
        return kind(fault)

    def enter_world(self, settings: dict[str, Any]) -> tuple[Specs, Specs]:
        """Make a world and join it; the specs of its actions and observations.

        Raises:
            RemoteError: the server is of another version, or refuses.
        """
        self._check_version(str(self.read("version")))
        world_name: str = self.ask(Request.create_world(settings))
        actions, observations = self.ask(Request.join_world(world_name))
        return (
            {name: Spec(*entries) for name, entries in actions.items()},
            {name: Spec(*entries) for name, entries in observations.items()},
        )

    def _check_version(self, found: str) -> None:
        # Before the first major version, a minor one breaks what there was.
        if found.split(".")[:2] != _VERSION.split(".")[:2]:
            raise RemoteError(
                _FAILED_PRECONDITION,
                f"the server at {self.address} is octoarm-server {found}, this is octoarm_env "
                f"{_VERSION}: they go together if the first two numbers are the same; install "
                "the one that is older anew",
            )

    def read(self, key: str) -> Any:
        """Read a property."""
        return self.ask(Request.read(key))


def _parse(address: str, certificate: str | Path | None) -> tuple[str, int, bool]:
    """Host, port, and whether TLS is spoken."""
    if not isinstance(address, str):
        raise TypeError(f"address must be a text such as 'host:port', not {address!r}")
    parts = urlsplit(address if "://" in address else f"//{address}")
    try:
        port = parts.port
    except ValueError:
        port = -1
    if parts.scheme not in ("", "http", "https") or not parts.hostname or port == -1:
        raise ValueError(
            f"address = {address!r}: expected 'host:port', 'http://host:port' or "
            "'https://host:port'"
        )
    if parts.scheme == "http" and certificate is not None:
        raise ValueError(f"address = {address!r}: a certificate needs https://")
    encrypted = parts.scheme == "https" or certificate is not None
    return parts.hostname, _PORT if port is None else port, encrypted


def _is_this_machine(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _variable(names: tuple[str, ...]) -> tuple[str, str]:
    """The first of these environment variables that is set, and what it holds; or nothing."""
    return next(((name, os.environ[name]) for name in names if name in os.environ), ("", ""))


def _told(name: str, value: str) -> str:
    """What a message says of a proxy."""
    # Without user and password.
    value = re.sub(r"^(\w+://)?.*@", r"\1", value)
    return f"; {name} = {value} leads there through a proxy, unless no_proxy names the host"
