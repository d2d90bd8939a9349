"""A stream to a server: requests, and their answers in the same order."""

from __future__ import annotations

import ipaddress
import queue
import weakref
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import grpc

from octoarm_env.remote.messages import (
    EnvironmentRequest,
    EnvironmentResponse,
    PropertyRequest,
    pack,
    unpack,
    unwrap,
    wrap,
)

__all__ = ["Connection", "RemoteError"]

_METHOD = "/dm_env_rpc.v1.Environment/Process"
_PORT = 50051
_INVALID_ARGUMENT = 3


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


class Connection:
    """A stream to a server.

    Args:
        address: ``host:port``, or a URL: ``http://host:port``, ``https://host:port`` for TLS.
        token: what a server that asks for one is told.
        certificate: a file (PEM) with the certificate that the server's is signed with, or its own;
            implies TLS. None: the machine's usual ones.
        timeout: time to wait for the server [s].

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
        timeout: float = 10.0,
    ) -> None:
        host, port, encrypted = _parse(address, certificate)
        if token is not None and not encrypted and not _is_this_machine(host):
            raise ValueError(
                f"address = {address!r}: a token is not sent to another machine without TLS; "
                "use https:// or a certificate"
            )
        self.address = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        # Streams that share a connection would wait for each other where a server allows it only so
        # many; the answer to a step of many arms may be large; a dead server is noticed.
        options = [
            ("grpc.use_local_subchannel_pool", 1),
            ("grpc.max_receive_message_length", -1),
            ("grpc.keepalive_time_ms", 30_000),
            ("grpc.keepalive_timeout_ms", 20_000),
        ]
        if encrypted:
            roots = None if certificate is None else Path(certificate).read_bytes()
            credentials = grpc.ssl_channel_credentials(root_certificates=roots)
            channel = grpc.secure_channel(self.address, credentials, options=options)
        else:
            channel = grpc.insecure_channel(self.address, options=options)
        try:
            grpc.channel_ready_future(channel).result(timeout)
        except grpc.FutureTimeoutError:
            channel.close()
            how = "with TLS and a trusted certificate" if encrypted else "without TLS"
            raise ConnectionError(
                f"no server answers at {self.address} {how} within {timeout:g} s"
            ) from None
        requests: queue.SimpleQueue[Any] = queue.SimpleQueue()
        metadata = () if token is None else (("authorization", f"Bearer {token}"),)
        call = channel.stream_stream(
            _METHOD,
            request_serializer=EnvironmentRequest.SerializeToString,
            response_deserializer=EnvironmentResponse.FromString,
        )(iter(requests.get, None), metadata=metadata)
        self._requests = requests
        self._call = call
        self._close = weakref.finalize(self, _end, requests, call, channel)

    @property
    def closed(self) -> bool:
        """Whether the stream has been closed from this side."""
        return not self._close.alive

    def close(self) -> None:
        """End the stream; the server frees what it made."""
        self._close()

    def post(self, request: Any) -> None:
        """Send a request without waiting for its answer."""
        self._requests.put(request)

    def answer(self, kind: str) -> Any:
        """Wait for the next answer, which must be of this kind.

        Raises:
            ValueError: the server found a value that it cannot use.
            RemoteError: the server refused the request for another reason.
            PermissionError: the server wants a token, or another one.
            ConnectionError: the stream is broken.
        """
        if self.closed:
            raise ConnectionError(f"the connection to {self.address} is closed")
        try:
            response = next(self._call)
        except StopIteration:
            raise ConnectionError(f"the server at {self.address} ended the stream") from None
        except grpc.RpcError as error:
            raise _broken(self.address, error) from None
        found = response.WhichOneof("payload")
        if found == "error":
            code, message = response.error.code, response.error.message
            raise ValueError(message) if code == _INVALID_ARGUMENT else RemoteError(code, message)
        if found != kind:
            raise ConnectionError(f"the server at {self.address} answered {kind} by {found}")
        return getattr(response, found)

    def create_world(self, settings: Mapping[str, Any]) -> str:
        """Make a world; its name."""
        request = EnvironmentRequest()
        request.create_world.SetInParent()
        for name, value in settings.items():
            pack(request.create_world.settings[name], value)
        self.post(request)
        return str(self.answer("create_world").world_name)

    def join_world(self, name: str) -> Any:
        """Join a world; its ActionObservationSpecs."""
        request = EnvironmentRequest()
        request.join_world.world_name = name
        self.post(request)
        return self.answer("join_world").specs

    def read(self, keys: Iterable[str]) -> list[Any]:
        """Read properties, all in one go."""
        keys = list(keys)
        for key in keys:
            self._post_property(PropertyRequest(read_property={"key": key}))
        return [
            unpack(unwrap(envelope).read_property.value)
            for envelope in self._answers("extension", len(keys))
        ]

    def write(self, key: str, value: Any) -> None:
        """Write a property."""
        message = PropertyRequest(write_property={"key": key})
        pack(message.write_property.value, value)
        self._post_property(message)
        self.answer("extension")

    def _post_property(self, message: Any) -> None:
        request = EnvironmentRequest()
        wrap(request.extension, message)
        self.post(request)

    def _answers(self, kind: str, count: int) -> list[Any]:
        """Take all of some answers, also when one is a refusal."""
        answers, refusal = [], None
        for _ in range(count):
            try:
                answers.append(self.answer(kind))
            except (ValueError, RemoteError) as error:
                refusal = refusal or error
        if refusal is not None:
            raise refusal
        return answers


def _end(requests: queue.SimpleQueue[Any], call: Any, channel: grpc.Channel) -> None:
    requests.put(None)
    call.cancel()
    channel.close()


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


def _broken(address: str, error: grpc.RpcError) -> OSError:
    """The exception for a stream that broke."""
    code = error.code() if isinstance(error, grpc.Call) else None
    details = error.details() if isinstance(error, grpc.Call) else str(error)
    if code == grpc.StatusCode.UNAUTHENTICATED:
        return PermissionError(f"the server at {address} refuses: {details}")
    name = "" if code is None else f" ({code.name})"
    return ConnectionError(f"the connection to {address} is broken: {details}{name}")
