"""What the tests of the server's faults and limits share: clients, metrics, waiting."""

from __future__ import annotations

import http.client
import queue
import select
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import Any, Self
from urllib.parse import urlsplit

import grpc
import gymnasium as gym
import numpy as np
from dm_env_rpc.v1 import dm_env_rpc_pb2 as pb
from dm_env_rpc.v1.extensions import properties_pb2
from google.protobuf import any_pb2
from octoarm_agents.common.serving import ServerProcess

from octoarm_env import OctoArmEnv

METHOD = "/dm_env_rpc.v1.Environment/Process"
ALL = tuple(range(1, 12))
"""The numbers of all observations; their names are in the specs."""
PATIENCE = 120.0
"""Seconds after which something is taken to never happen; all of it is a matter of milliseconds."""

_CHANNEL_OPTIONS = (
    # Otherwise the channels of a process share one connection.
    ("grpc.use_local_subchannel_pool", 1),
    ("grpc.enable_http_proxy", 0),
)


def wait_until(condition: Callable[[], Any], what: str, timeout: float = PATIENCE) -> Any:
    """Wait until a condition holds, and give its value."""
    end = time.monotonic() + timeout
    while True:
        value = condition()
        if value:
            return value
        assert time.monotonic() < end, f"not within {timeout} s: {what}"
        time.sleep(0.01)


def open_channel(
    address: str,
    credentials: grpc.ChannelCredentials | None = None,
    options: Sequence[tuple[str, Any]] = (),
) -> grpc.Channel:
    """A channel with a connection of its own."""
    options = (*_CHANNEL_OPTIONS, *options)
    if credentials is None:
        return grpc.insecure_channel(address, options=options)
    return grpc.secure_channel(address, credentials, options=options)


def tensor(value: Any) -> pb.Tensor:
    """A number, a text, or an array of doubles as the protocol has it."""
    message = pb.Tensor()
    if isinstance(value, str):
        message.strings.array.append(value)
    elif isinstance(value, bool):
        message.bools.array.append(value)
    elif isinstance(value, int):
        message.int64s.array.append(value)
    else:
        array = np.asarray(value, dtype=np.float64)
        message.doubles.array.extend(array.ravel().tolist())
        message.shape.extend(array.shape)
    return message


def settings(values: dict[str, Any]) -> dict[str, pb.Tensor]:
    """Settings by name; `arm__timestep` stands for `arm.timestep`."""
    return {name.replace("__", "."): tensor(value) for name, value in values.items()}


def step_request(action: Any = None, observations: Sequence[int] = ALL) -> pb.EnvironmentRequest:
    step = pb.StepRequest(requested_observations=observations)
    if action is not None:
        step.actions[1].CopyFrom(tensor(action))
    return pb.EnvironmentRequest(step=step)


def property_request(request: properties_pb2.PropertyRequest) -> pb.EnvironmentRequest:
    extension = any_pb2.Any()
    extension.Pack(request)
    return pb.EnvironmentRequest(extension=extension)


def read_request(key: str) -> pb.EnvironmentRequest:
    """Asks for a property."""
    read = properties_pb2.ReadPropertyRequest(key=key)
    return property_request(properties_pb2.PropertyRequest(read_property=read))


def write_request(key: str, value: Any) -> pb.EnvironmentRequest:
    """Sets a property."""
    write = properties_pb2.WritePropertyRequest(key=key, value=tensor(value))
    return property_request(properties_pb2.PropertyRequest(write_property=write))


def array_of(observation: pb.Tensor) -> np.ndarray:
    """An observation's elements, in its shape."""
    payload = getattr(observation, observation.WhichOneof("payload"))
    return np.array(payload.array).reshape(observation.shape)


class RefusedError(Exception):
    """The server answered with an error."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(f"{code}: {message}")
        self.code = code
        self.message = message


class Client:
    """A stream, with a connection of its own unless a channel is given.

    Requests are sent and answers read as they are: a test can do what no decent client does.
    """

    def __init__(
        self,
        address: str = "",
        *,
        channel: grpc.Channel | None = None,
        token: str | None = None,
        timeout: float | None = 120.0,
        raw: bool = False,
        compression: grpc.Compression | None = None,
    ) -> None:
        self._own = channel is None
        self.channel = channel or open_channel(address)
        call = self.channel.stream_stream(
            METHOD,
            request_serializer=None if raw else pb.EnvironmentRequest.SerializeToString,
            response_deserializer=None if raw else pb.EnvironmentResponse.FromString,
        )
        self._requests: queue.SimpleQueue[Any] = queue.SimpleQueue()
        metadata = None if token is None else [("authorization", f"Bearer {token}")]
        self.stream = call(
            iter(self._requests.get, None),
            metadata=metadata,
            timeout=timeout,
            compression=compression,
        )
        self.world = ""
        self._names: dict[int, str] = {}

    def send(self, request: Any) -> None:
        """Send a request and do not wait."""
        self._requests.put(request)

    def read(self) -> Any:
        """The next answer; a grpc.RpcError if the stream has ended with an error."""
        return next(self.stream)

    def ask(self, request: Any) -> Any:
        """Send a request, and give the answer as it comes."""
        self.send(request)
        return self.read()

    def _answer(self, **payload: Any) -> Any:
        response = self.ask(pb.EnvironmentRequest(**payload))
        kind = response.WhichOneof("payload")
        if kind == "error":
            raise RefusedError(response.error.code, response.error.message)
        assert kind in payload
        return getattr(response, kind)

    def create(self, **given: Any) -> str:
        """Make a world; its name."""
        request = pb.CreateWorldRequest(settings=settings(given))
        return self._answer(create_world=request).world_name

    def join(self, name: str) -> None:
        specs = self._answer(join_world=pb.JoinWorldRequest(world_name=name)).specs
        self._names = {uid: spec.name for uid, spec in specs.observations.items()}
        self.world = name

    def enter(self, **given: Any) -> Self:
        """Make a world and join it."""
        self.join(self.create(**given))
        return self

    def step(self, action: Any = None, observations: Sequence[int] = ALL) -> pb.StepResponse:
        return self._answer(step=step_request(action, observations).step)

    def observe(self, action: Any = None) -> dict[str, np.ndarray]:
        """Step, and give the observations by name."""
        return self.named(self.step(action))

    def named(self, step: pb.StepResponse) -> dict[str, np.ndarray]:
        """The observations of a step, by name."""
        return {self._names[uid]: array_of(found) for uid, found in step.observations.items()}

    def reset(self, **given: Any) -> None:
        self._answer(reset=pb.ResetRequest(settings=settings(given)))

    def reset_world(self, name: str, **given: Any) -> None:
        request = pb.ResetWorldRequest(world_name=name, settings=settings(given))
        self._answer(reset_world=request)

    def leave(self) -> None:
        self._answer(leave_world=pb.LeaveWorldRequest())

    def destroy(self, name: str) -> None:
        self._answer(destroy_world=pb.DestroyWorldRequest(world_name=name))

    def property(self, key: str) -> Any:
        """The value of a property, a scalar or text."""
        answer = properties_pb2.PropertyResponse()
        assert self._answer(extension=read_request(key).extension).Unpack(answer)
        value = answer.read_property.value
        return getattr(value, value.WhichOneof("payload")).array[0]

    def hang_up(self) -> None:
        """Send nothing more."""
        self._requests.put(None)

    def close(self) -> None:
        """End the stream, without leaving the world first."""
        self.stream.cancel()
        self.hang_up()
        if self._own:
            self.channel.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


def drain(client: Client) -> tuple[list[Any], grpc.StatusCode]:
    """Read to the stream's end: the answers, and how it ended."""
    answers = []
    try:
        for answer in client.stream:
            answers.append(answer)
    except grpc.RpcError as error:
        return answers, error.code()
    return answers, client.stream.code()


def status_of(client: Client) -> grpc.StatusCode:
    """Read to the stream's end, and tell how it ended."""
    return drain(client)[1]


def fetch(url: str, path: str | None = None) -> tuple[int, str]:
    """Status and text of a page."""
    place = urlsplit(url)
    connection = http.client.HTTPConnection(place.netloc, timeout=PATIENCE)
    try:
        connection.request("GET", place.path if path is None else path)
        response = connection.getresponse()
        return response.status, response.read().decode()
    finally:
        connection.close()


def metrics(server: ServerProcess) -> dict[str, float]:
    """All that the server tells Prometheus, by name and labels as they are written."""
    assert server.metrics_url is not None
    status, text = fetch(server.metrics_url)
    assert status == 200
    assert text.endswith("# EOF\n")
    lines = (line.rpartition(" ") for line in text.splitlines() if not line.startswith("#"))
    return {name: float(value) for name, _, value in lines}


def levels(server: ServerProcess) -> dict[str, int]:
    """What the server holds for its clients."""
    text = metrics(server)
    return {name: int(text[f"octoarm_{name}"]) for name in ("connections", "streams", "worlds")}


def wait_for_levels(server: ServerProcess, timeout: float = PATIENCE, **expected: int) -> None:
    """Wait until the server holds so many connections, streams or worlds."""
    wait_until(lambda: expected.items() <= levels(server).items(), f"levels {expected}", timeout)


@contextmanager
def nothing_left(server: ServerProcess) -> Iterator[None]:
    """The server lives, and holds no more than before."""
    before = levels(server)
    yield
    assert server.process.poll() is None, server.log
    wait_for_levels(server, **before)


class Bystander:
    """A decent client that steps in a thread while the ``with`` block does its mischief.

    At the end its results must be those of an environment of this process, bit for bit.
    """

    def __init__(self, server: ServerProcess, seed: int = 7) -> None:
        self._client = Client(server.address)
        self._seed = seed
        self._rng = np.random.default_rng(seed)
        self._steps: list[tuple[np.ndarray, dict[str, np.ndarray]]] = []
        self._stop = threading.Event()
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                self._step()
                # The processor is not its alone.
                time.sleep(0.002)
        except Exception as error:
            self._error = error

    def _step(self) -> None:
        action = self._rng.uniform(-1.0, 1.0, 2).astype(np.float32)
        self._steps.append((action, self._client.observe(action)))

    def __enter__(self) -> Self:
        self._client.enter(seed=self._seed, max_episode_steps=-1)
        self._step()
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._stop.set()
        self._thread.join(PATIENCE)
        try:
            if kind is None:
                assert not self._thread.is_alive(), "a bystander's step is not answered"
                assert self._error is None, self._error
                self._step()
                self._compare()
        finally:
            self._client.close()

    def _compare(self) -> None:
        env = OctoArmEnv()
        observation, info = env.reset(seed=self._seed)
        reward, terminated = 0.0, False
        for index, (action, found) in enumerate(self._steps):
            # The first step begins the episode.
            if index:
                observation, reward, terminated, _, info = env.step(action)
            expected = {"spring_lengths": observation, "reward": reward, **info}
            for name, value in expected.items():
                assert np.asarray(value).tobytes() == found[name].tobytes(), (index, name)
            assert terminated == found["terminated"].item()


PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
DATA, HEADERS, RST_STREAM, SETTINGS, PING = 0, 1, 3, 4, 6
END_HEADERS = 4


def frame(kind: int, flags: int, stream: int, payload: bytes = b"") -> bytes:
    """A frame of HTTP/2."""
    head = struct.pack(">I", len(payload))[1:] + struct.pack(">BBI", kind, flags, stream)
    return head + payload


def grpc_message(message: bytes, compressed: int = 0, length: int | None = None) -> bytes:
    """A message as gRPC frames it."""
    return struct.pack(">BI", compressed, len(message) if length is None else length) + message


def call_headers(path: str = METHOD) -> bytes:
    """The headers of a call, none of them compressed."""
    fields = {
        ":method": "POST",
        ":scheme": "http",
        ":path": path,
        ":authority": "localhost",
        "content-type": "application/grpc",
        "te": "trailers",
    }
    return b"".join(
        b"\0" + bytes([len(name)]) + name.encode() + bytes([len(value)]) + value.encode()
        for name, value in fields.items()
    )


class RawPeer:
    """A TCP connection to the server, for what no library would do."""

    def __init__(self, server: ServerProcess) -> None:
        host, _, port = server.address.rpartition(":")
        self.socket = socket.create_connection((host, int(port)), timeout=PATIENCE)

    def send(self, data: bytes) -> Self:
        self.socket.sendall(data)
        return self

    def greet(self) -> Self:
        """Speak HTTP/2 as far as it must be spoken first."""
        return self.send(PREFACE + frame(SETTINGS, 0, 0))

    def call(self, *messages: bytes) -> Self:
        """Open a stream, and send gRPC messages over it."""
        self.send(frame(HEADERS, END_HEADERS, 1, call_headers()))
        for message in messages:
            self.send(frame(DATA, 0, 1, message))
        return self

    def send_message(self, message: bytes) -> Self:
        """Send a gRPC message over the stream."""
        return self.send(frame(DATA, 0, 1, grpc_message(message)))

    def receive(self, length: int) -> bytes:
        data = b""
        while len(data) < length:
            part = self.socket.recv(length - len(data))
            if not part:
                raise ConnectionError("closed")
            data += part
        return data

    def frames(self) -> Iterator[tuple[int, int, int, bytes]]:
        """Kind, flags, stream and payload of all that the server sends."""
        while True:
            head = self.receive(9)
            kind, flags, stream = struct.unpack(">BBI", head[3:])
            yield kind, flags, stream, self.receive(int.from_bytes(head[:3], "big"))

    def wait_for_data(self) -> bytes:
        """The first piece of a stream's answer."""
        return next(payload for kind, _, _, payload in self.frames() if kind == DATA)

    def wait_for_end(self) -> bytes:
        """Read until the server has closed the connection; a TimeoutError if it does not."""
        data = b""
        try:
            while part := self.socket.recv(65536):
                data += part
        except ConnectionResetError:
            pass
        return data

    def drop(self) -> None:
        """Close without a goodbye: the server gets a reset."""
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self.socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.socket.close()


def assert_no_nan(step: pb.StepResponse) -> None:
    for uid, observation in step.observations.items():
        value = array_of(observation)
        if value.dtype == np.float64:
            assert not np.isnan(value).any(), (uid, value)


NOT_OVER_A_SERVER = {"body_factors", "action_noise", "true_lengths", "dropped", "delay"}
"""Keys of infos that an environment on a server does not have."""


class WithoutDisturbances(gym.Wrapper):
    """A local environment that tells in its infos what one on a server tells."""

    def reset(self, **given: Any) -> Any:
        observation, info = self.env.reset(**given)
        return observation, _over_a_server(info)

    def step(self, action: Any) -> Any:
        *result, info = self.env.step(action)
        return *result, _over_a_server(info)


def _over_a_server(info: dict[str, Any]) -> dict[str, Any]:
    return {key: info[key] for key in info if key.removeprefix("_") not in NOT_OVER_A_SERVER}


def assert_same(found: Any, expected: Any) -> None:
    """Compare results of `reset` or `step`: types, shapes and every bit."""
    assert type(found) is type(expected)
    if isinstance(expected, dict):
        expected = _over_a_server(expected)
        assert list(found) == list(expected)
        for key in expected:
            assert_same(found[key], expected[key])
    elif isinstance(expected, tuple):
        assert len(found) == len(expected)
        for one, other in zip(found, expected, strict=True):
            assert_same(one, other)
    elif isinstance(expected, np.ndarray):
        assert (found.dtype, found.shape) == (expected.dtype, expected.shape)
        if expected.dtype.kind == "O":
            assert_same(tuple(found), tuple(expected))
        else:
            assert found.tobytes() == expected.tobytes()
    else:
        assert repr(found) == repr(expected)


class Proxy:
    """A proxy that keeps what it was sent, and refuses everybody or leads all to one place."""

    def __init__(self) -> None:
        self.received: list[bytes] = []
        self.place: str | None = None
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            with client:
                self.received.append(client.recv(65536))
                if self.place is None:
                    client.sendall(b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\n\r\n")
                else:
                    client.sendall(b"HTTP/1.1 200 OK\r\n\r\n")
                    self._lead(client, self.place)

    def _lead(self, client: socket.socket, place: str) -> None:
        host, _, port = place.rpartition(":")
        with socket.create_connection((host, int(port))) as server:
            other = {client: server, server: client}
            while True:
                for end in select.select([client, server], [], [])[0]:
                    data = end.recv(65536)
                    if not data:
                        return
                    other[end].sendall(data)
                    self.received.append(data)

    def close(self) -> None:
        # Also of the thread that waits in it.
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
