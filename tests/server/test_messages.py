"""Messages that are none, too large or senseless: each is answered or ends its own stream alone."""

from __future__ import annotations

import json
import math
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import grpc
import hypothesis
import numpy as np
import pytest
from clients import (
    ALL,
    DATA,
    END_HEADERS,
    HEADERS,
    PATIENCE,
    PING,
    PREFACE,
    SETTINGS,
    Bystander,
    Client,
    RawPeer,
    RefusedError,
    assert_no_nan,
    call_headers,
    drain,
    frame,
    grpc_message,
    nothing_left,
    open_channel,
    property_request,
    read_request,
    status_of,
    step_request,
    tensor,
    write_request,
)
from dm_env_rpc.v1 import dm_env_rpc_pb2 as pb
from dm_env_rpc.v1.extensions import properties_pb2
from google.protobuf import any_pb2, message_factory
from google.protobuf.descriptor import FieldDescriptor
from hypothesis import strategies as st
from octoarm_agents.common.serving import ServerProcess

Code = grpc.StatusCode
INVALID_ARGUMENT, NOT_FOUND, FAILED_PRECONDITION, INTERNAL = 3, 5, 9, 13
RUNNING, INTERRUPTED = 1, 3
CREATE = pb.EnvironmentRequest(create_world=pb.CreateWorldRequest())


@pytest.fixture
def server(watched_server: ServerProcess) -> ServerProcess:
    return watched_server


VALID = [
    CREATE,
    pb.EnvironmentRequest(
        create_world=pb.CreateWorldRequest(
            settings={
                "num_envs": tensor(3),
                "amplitude": tensor(12.5),
                "target": tensor("lissajous"),
            }
        )
    ),
    pb.EnvironmentRequest(join_world=pb.JoinWorldRequest(world_name="0" * 32)),
    step_request([0.5, -0.5]),
    pb.EnvironmentRequest(reset=pb.ResetRequest(settings={"phase": tensor(0.5)})),
    read_request("version"),
    write_request("seed", 3),
]


def corrupt(request: pb.EnvironmentRequest, place: int, byte: int, cut: int) -> bytes:
    """A message with one byte changed, and some of its end missing."""
    data = bytearray(request.SerializeToString())
    data[place % len(data)] = byte
    return bytes(data[: len(data) - cut])


def test_random_bytes_as_messages(server: ServerProcess) -> None:
    corrupted = st.builds(
        corrupt,
        st.sampled_from(VALID),
        st.integers(0, 1000),
        st.integers(0, 255),
        st.sampled_from([0, 0, 1, 5]),
    )
    with open_channel(server.address) as channel:

        @hypothesis.settings(max_examples=60, deadline=None, database=None)
        @hypothesis.given(st.lists(st.binary(max_size=200) | corrupted, min_size=1, max_size=4))
        def answered_or_ended(messages: list[bytes]) -> None:
            with Client(channel=channel, raw=True, timeout=PATIENCE) as client:
                for message in messages:
                    client.send(message)
                client.hang_up()
                answers, status = drain(client)
                if len(answers) < len(messages):
                    # That is how gRPC calls a message that cannot be parsed.
                    assert status is Code.INTERNAL
                    assert "decode" in client.stream.details()
                else:
                    assert status is Code.OK
                    assert len(answers) == len(messages)
                for answer in answers:
                    response = pb.EnvironmentResponse.FromString(answer)
                    assert response.WhichOneof("payload")
                    assert response.error.code != INTERNAL

        answered_or_ended()


def raw_traffic() -> dict[str, list[bytes]]:
    """What no client sends, as pieces of a TCP connection that ends after them."""
    rng = np.random.default_rng(0)
    hello = PREFACE + frame(SETTINGS, 0, 0)
    call = hello + frame(HEADERS, END_HEADERS, 1, call_headers())
    create = grpc_message(CREATE.SerializeToString())
    return {
        "random bytes": [rng.bytes(5000)],
        "random bytes after the preface": [PREFACE, rng.bytes(5000)],
        "random bytes after the settings": [hello, rng.bytes(5000)],
        "random frames": [
            hello,
            *(
                frame(int(rng.integers(10)), int(rng.integers(256)), int(rng.integers(8)), part)
                for part in (rng.bytes(int(rng.integers(40))) for _ in range(50))
            ),
        ],
        "HTTP/1": [b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n"],
        "TLS": [b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + rng.bytes(508)],
        "half a preface": [PREFACE[:12]],
        "half a frame's head": [hello, frame(HEADERS, 0, 1)[:5]],
        "half of the headers": [hello, frame(HEADERS, END_HEADERS, 1, call_headers())[:40]],
        "headers that do not end": [hello, frame(HEADERS, 0, 1, call_headers())],
        "data without a stream": [hello, frame(DATA, 0, 1, create)],
        "half of the data": [call, frame(DATA, 0, 1, create)[:-1]],
        "half of a message": [call, frame(DATA, 1, 1, create[:-1])],
        "a message in the dark": [call, frame(DATA, 1, 1, grpc_message(b"\1\2\3", compressed=1))],
        "a message of 4 GiB": [call, frame(DATA, 0, 1, grpc_message(b"", length=2**32 - 1))],
        "an unknown kind of compression": [call, frame(DATA, 1, 1, b"\x07" + create[1:])],
        "a frame beyond the largest": [call, frame(DATA, 0, 1, bytes(100_000))],
        "pings without end": [hello, frame(PING, 0, 0, bytes(8)) * 20_000],
    }


@pytest.mark.parametrize("kind", raw_traffic())
def test_what_is_no_grpc(server: ServerProcess, kind: str) -> None:
    for reset in (False, True):
        with RawPeer(server) as peer:
            try:
                for piece in raw_traffic()[kind]:
                    peer.send(piece)
                if reset:
                    peer.drop()
                else:
                    peer.socket.shutdown(socket.SHUT_WR)
                    peer.wait_for_end()
            except TimeoutError:
                raise
            except OSError:
                # The server has had enough.
                continue


def test_compression_and_methods_that_there_are_not(server: ServerProcess) -> None:
    with open_channel(server.address) as channel:
        with Client(channel=channel, compression=grpc.Compression.Gzip) as client:
            long_name = pb.JoinWorldRequest(world_name="x" * 5000)
            client.send(pb.EnvironmentRequest(join_world=long_name))
            assert status_of(client) is Code.UNIMPLEMENTED
        for method in ("/dm_env_rpc.v1.Environment/Other", "/other.Service/Process", "/"):
            call = channel.unary_unary(method)
            with pytest.raises(grpc.RpcError) as error:
                call(b"", timeout=PATIENCE)
            assert error.value.code() is Code.UNIMPLEMENTED
        with Client(channel=channel) as client:
            assert client.create()


NUMBERS = [
    0.0,
    -0.0,
    0.5,
    1.0,
    -1.0,
    3.0,
    20.0,
    1e-300,
    5e-324,
    1e300,
    math.inf,
    -math.inf,
    math.nan,
]


WHOLE = [
    0,
    1,
    -1,
    2,
    3,
    11,
    12,
    200,
    2**31 - 1,
    -(2**31),
    2**32 - 1,
    2**63 - 1,
    -(2**63),
    2**64 - 1,
]


TEXTS = [
    "",
    "quadratic",
    "van_der_pol",
    "lissajous",
    "servo",
    "direct",
    "{}",
    "[]",
    "null",
    "1e999",
]


NAMES = [
    "task",
    "goals",
    "goal",
    "segments",
    "max_force",
    "reward_type",
    "observe_rates",
    "target",
    "amplitude",
    "control_period",
    "actuator",
    "action_range",
    "tracking_weight",
    "reward_width",
    "action_change_weight",
    "length_noise",
    "action_noise",
    "delay",
    "dropout",
    "bodies",
    "body_seed",
    "vary",
    "vary.arm_density",
    "vary.colour",
    "seed",
    "phase",
    "num_envs",
    "threads",
    "max_episode_steps",
    "arm",
    "arm.",
    "arm.timestep",
    "arm.compartments",
    "arm.rest_length",
    "arm.base_radius",
    "arm.longitudinal_mass",
    "arm.longitudinal_stiffness",
    "arm.gravity",
    "arm.drag_coefficients",
    "arm.water_density",
    "arm.servo_frequency",
    "arm.colour",
    "colour",
]


KEYS = [
    "version",
    "worlds",
    "settings",
    "action_range",
    "amplitude",
    "period",
    "orbit",
    "teacher_action",
    "arm_positions",
    "arm_joints",
    "elapsed_steps",
    "seed",
    "state",
]


JOINED = "the world that is joined"


SPARE = "the world that nobody has joined"


_float = st.sampled_from(NUMBERS) | st.floats()


_text = st.sampled_from(TEXTS) | st.text(max_size=20)


def _whole(low: int, high: int) -> st.SearchStrategy[int]:
    known = [value for value in WHOLE if low <= value <= high]
    return st.sampled_from(known) | st.integers(low, high)


SCALARS = {
    FieldDescriptor.CPPTYPE_DOUBLE: _float,
    FieldDescriptor.CPPTYPE_FLOAT: st.sampled_from([0.5, math.nan, math.inf]) | st.floats(width=32),
    FieldDescriptor.CPPTYPE_INT32: _whole(-(2**31), 2**31 - 1),
    FieldDescriptor.CPPTYPE_INT64: _whole(-(2**63), 2**63 - 1),
    FieldDescriptor.CPPTYPE_UINT32: _whole(0, 2**32 - 1),
    FieldDescriptor.CPPTYPE_UINT64: _whole(0, 2**64 - 1),
    FieldDescriptor.CPPTYPE_BOOL: st.booleans(),
}


SPECIAL = {
    "dm_env_rpc.v1.Tensor.shape": st.lists(
        st.sampled_from([-1, 0, 1, 2, 3, 80, 2**20 + 1, 2**31 - 1, -(2**31)]), max_size=4
    ),
    "dm_env_rpc.v1.StepRequest.requested_observations": st.just(ALL)
    | st.lists(st.integers(1, 12) | _whole(0, 2**64 - 1), max_size=5),
}


def _scalar(field: FieldDescriptor) -> st.SearchStrategy[Any]:
    if field.name == "world_name":
        return st.sampled_from([JOINED, JOINED, SPARE]) | _text
    if field.containing_type.full_name.endswith("SettingsEntry"):
        return st.sampled_from(NAMES) | _text
    if field.containing_type.full_name.endswith("PropertyRequest"):
        return st.sampled_from(KEYS) | _text
    if field.cpp_type == FieldDescriptor.CPPTYPE_STRING:
        return st.binary(max_size=8) if field.type == FieldDescriptor.TYPE_BYTES else _text
    return SCALARS[field.cpp_type]


def _value(field: FieldDescriptor) -> st.SearchStrategy[Any]:
    if field.full_name in SPECIAL:
        return SPECIAL[field.full_name]
    inner = field.message_type
    if inner is not None and inner.GetOptions().map_entry:
        entry = inner.fields_by_name
        return st.dictionaries(_value(entry["key"]), _value(entry["value"]), max_size=3)
    one = _scalar(field) if inner is None else messages(message_factory.GetMessageClass(inner))
    return st.lists(one, max_size=3) if field.is_repeated else one


def _extensions() -> st.SearchStrategy[any_pb2.Any]:
    name = properties_pb2.PropertyRequest.DESCRIPTOR.full_name
    properties = messages(properties_pb2.PropertyRequest).map(
        lambda request: property_request(request).extension
    )
    nonsense = st.builds(
        any_pb2.Any,
        type_url=st.sampled_from([name, f"type.googleapis.com/{name}", f"/{name}/"]) | _text,
        value=st.binary(max_size=20),
    )
    return properties | properties | nonsense


def messages(kind: Any) -> st.SearchStrategy[Any]:
    """Messages of a kind: well-formed, and nothing more."""
    descriptor = kind.DESCRIPTOR
    if descriptor is any_pb2.Any.DESCRIPTOR:
        return st.deferred(_extensions)
    free = {}
    built = []
    for field in descriptor.fields:
        if field.containing_oneof is None:
            free[field.name] = st.deferred(lambda field=field: _value(field))
    rest = st.fixed_dictionaries({}, optional=free)
    for oneof in descriptor.oneofs:
        choices = [
            st.deferred(lambda field=field: st.fixed_dictionaries({field.name: _value(field)}))
            for field in oneof.fields
        ]
        built.append(st.one_of(*choices))
    plain = st.tuples(rest, *built).map(
        lambda parts: kind(**{name: value for part in parts for name, value in part.items()})
    )
    if descriptor is not pb.Tensor.DESCRIPTOR:
        return plain
    # Among all that does not fit there must be something that does.
    return plain | st.builds(tensor, st.sampled_from([1, 3, 0.5, [0.5, -0.5], *TEXTS]) | _float)


def assert_proper(request: pb.EnvironmentRequest, response: pb.EnvironmentResponse) -> None:
    kind = response.WhichOneof("payload")
    if kind == "error":
        assert 0 < response.error.code < 17
        assert response.error.code != INTERNAL, response
        assert response.error.message
    else:
        assert kind == request.WhichOneof("payload")
    if kind == "step":
        assert_no_nan(response.step)


def test_well_formed_nonsense() -> None:
    # What is allowed must be quick.
    limits = ("--max-physics-steps", "16000", "--max-num-envs", "4")
    with (
        ServerProcess("--metrics-port", "0", *limits) as server,
        nothing_left(server),
        Bystander(server),
        open_channel(server.address) as channel,
    ):

        @hypothesis.settings(
            max_examples=50,
            deadline=None,
            database=None,
            suppress_health_check=[hypothesis.HealthCheck.too_slow],
        )
        @hypothesis.given(
            st.lists(messages(pb.EnvironmentRequest), min_size=1, max_size=8),
            st.sampled_from([{}, {"num_envs": 2}]),
        )
        def each_is_answered(requests: list[pb.EnvironmentRequest], world: dict[str, int]) -> None:
            with Client(channel=channel, timeout=PATIENCE) as client:
                names = {SPARE: client.create(), JOINED: client.enter(**world).world}
                client.step()
                for request in requests:
                    kind = request.WhichOneof("payload")
                    inner = getattr(request, kind) if kind else None
                    if hasattr(inner, "world_name"):
                        inner.world_name = names.get(inner.world_name, inner.world_name)
                    client.send(request)
                    assert_proper(request, client.read())
                    # If there were a second answer, it would come instead of the version.
                    assert client.property("version")
                # Where it stands now, nobody knows; the next world is as good as any.
                client.leave()
                client.enter()
                assert_no_nan(client.step())

        each_is_answered()


def leaves(tree: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The places in JSON, from the whole to every number."""
    yield path
    branches = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for key, value in branches:
        if isinstance(value, dict | list):
            yield from leaves(value, (*path, key))
        else:
            yield (*path, key)


def changed(text: str, place: int, value: Any) -> str:
    """A state with one thing changed."""
    tree = {"state": json.loads(text)}
    places = list(leaves(tree))[1:]
    path = places[place % len(places)]
    inner: Any = tree
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return json.dumps(tree["state"])


@pytest.mark.parametrize("world", [{}, {"num_envs": 2}], ids=["one", "batch"])
def test_states_that_were_tampered_with(server: ServerProcess, world: dict[str, int]) -> None:
    odd = st.sampled_from(
        [
            None,
            True,
            -1,
            0,
            2**31,
            2**63,
            -(2**63),
            2**64,
            2**70,
            1e-300,
            1e5,
            1e300,
            -1e308,
            "",
            [],
            {},
        ]
    )
    with Client(server.address) as client:
        client.enter(seed=0, max_episode_steps=-1, **world)
        for _ in range(3):
            client.step()
        good = client.property("state")
        client.ask(write_request("state", good))
        after = client.observe()

        @hypothesis.settings(max_examples=60, deadline=None, database=None)
        @hypothesis.given(st.integers(0, 10_000), odd | st.floats(-1e3, 1e3))
        def refused_or_followed(place: int, value: Any) -> None:
            client.ask(write_request("state", good))
            request = write_request("state", changed(good, place, value))
            response = client.ask(request)
            assert_proper(request, response)
            if response.HasField("error"):
                assert client.property("state") == good
            else:
                for _ in range(3):
                    request = step_request()
                    assert_proper(request, client.ask(request))
            client.ask(write_request("state", good))
            again = client.observe()
            assert all(again[name].tobytes() == after[name].tobytes() for name in after)

        refused_or_followed()


@pytest.mark.parametrize("world", [{}, {"num_envs": 2}], ids=["one", "batch"])
def test_a_state_from_before_the_first_episode(
    server: ServerProcess, world: dict[str, int]
) -> None:
    with Client(server.address) as client:
        client.enter(**world)
        request = write_request("state", client.property("state"))
        assert_proper(request, client.ask(request))
        assert client.step().state == RUNNING


@pytest.mark.parametrize("world", [{}, {"num_envs": 2}], ids=["one", "batch"])
@pytest.mark.parametrize(
    "given",
    [
        {"amplitude": 5e-324},
        {"amplitude": 1e-200, "reward_width": 1e-200},
        {"amplitude": 1e-5, "reward_width": 5e-324, "actuator": "direct"},
        {"tracking_weight": 1e6, "action_change_weight": 1e6},
        {"tracking_weight": 5e-324, "action_change_weight": 5e-324},
        {"action_range": 5e-324},
        {"action_range": 360.0},
    ],
    ids=str,
)
def test_settings_at_their_bounds_give_no_nan(
    server: ServerProcess, world: dict[str, int], given: dict[str, Any]
) -> None:
    with Client(server.address) as client:
        try:
            client.enter(seed=0, **world, **given)
        except RefusedError:
            return
        shape = (2, 2) if world else (2,)
        for step in range(20):
            assert_no_nan(client.step(np.full(shape, (-1.0) ** step)))


def test_a_shape_of_many_sizes() -> None:
    deep = tensor(1.5)
    deep.shape.extend([1] * 200_000)
    with ServerProcess("--metrics-port", "0") as server, nothing_left(server), Bystander(server):
        for request in (
            pb.EnvironmentRequest(create_world=pb.CreateWorldRequest(settings={"amplitude": deep})),
            pb.EnvironmentRequest(reset=pb.ResetRequest(settings={"phase": deep})),
        ):
            with Client(server.address) as client:
                client.enter()
                assert client.ask(request).error.code == INVALID_ARGUMENT


def peak_memory(server: ServerProcess) -> int:
    """Most memory that the process has ever had [bytes]."""
    status = Path(f"/proc/{server.process.pid}/status").read_text(encoding="utf-8")
    return 1024 * int(status.partition("VmHWM:")[2].split()[0])


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc")
def test_a_small_request_takes_little_memory() -> None:
    large = tensor(1.5)
    large.shape.append(2**20)
    given = {f"name{index}": large for index in range(20)}
    request = pb.EnvironmentRequest(create_world=pb.CreateWorldRequest(settings=given))
    assert request.ByteSize() < 1000
    with (
        ServerProcess("--metrics-port", "0") as server,
        nothing_left(server),
        Client(server.address) as client,
    ):
        client.enter()
        before = peak_memory(server)
        assert client.ask(request).error.code == INVALID_ARGUMENT
        # A million numbers, the most that one setting may have, take 32 MiB.
        assert peak_memory(server) - before < 100 << 20


@pytest.mark.parametrize("letter", ["x", "\x01"])
@pytest.mark.parametrize("kind", ["world", "setting", "text", "property", "extension"])
def test_a_long_name_has_an_answer_that_can_be_read(
    server: ServerProcess, kind: str, letter: str
) -> None:
    name = letter * 3_000_000
    request = {
        "world": pb.EnvironmentRequest(join_world=pb.JoinWorldRequest(world_name=name)),
        "setting": pb.EnvironmentRequest(
            create_world=pb.CreateWorldRequest(settings={name: tensor(1)})
        ),
        "text": pb.EnvironmentRequest(
            create_world=pb.CreateWorldRequest(settings={"target": tensor(name)})
        ),
        "property": read_request(name),
        "extension": pb.EnvironmentRequest(extension=any_pb2.Any(type_url=name)),
    }[kind]
    with Client(server.address) as client:
        assert client.ask(request).error.code
        assert client.create()


def empty_request(size: int) -> bytes:
    """A request that is nothing but a field of bytes that nobody knows."""
    length = size - 6
    digits = [length >> shift & 0x7F for shift in (0, 7, 14, 21)]
    return (
        b"\xfa\x01"
        + bytes(digit | 0x80 for digit in digits[:3])
        + bytes([digits[3]])
        + bytes(length)
    )


@pytest.mark.parametrize(
    ("options", "limit"), [((), 4 << 20), (("--max-message-size", "1000"), 1000)]
)
def test_messages_beyond_the_limit(options: tuple[str, ...], limit: int) -> None:
    with (
        ServerProcess("--metrics-port", "0", *options) as server,
        nothing_left(server),
        Bystander(server),
        open_channel(server.address, options=[("grpc.max_receive_message_length", -1)]) as channel,
        Client(channel=channel) as neighbour,
    ):
        neighbour.enter()
        for size, fits in ((limit, True), (limit + 1, False), (3 * limit, False)):
            with Client(channel=channel, raw=True) as client:
                client.send(empty_request(size))
                if fits:
                    response = pb.EnvironmentResponse.FromString(client.read())
                    assert response.error.code == INVALID_ARGUMENT
                else:
                    assert status_of(client) in {Code.RESOURCE_EXHAUSTED, Code.OUT_OF_RANGE}
            # A stream of the same connection goes on.
            assert neighbour.step().state == RUNNING


def test_unknown_worlds_are_named(server: ServerProcess) -> None:
    with Client(server.address) as client:
        for name in ("", "nowhere", "0" * 32):
            for request in (client.join, client.reset_world, client.destroy):
                with pytest.raises(RefusedError, match=f'world_name = "{name}"') as error:
                    request(name)
                assert error.value.code == NOT_FOUND
        with pytest.raises(RefusedError, match="no world is joined") as error:
            client.step()
        assert error.value.code == FAILED_PRECONDITION
        assert client.enter().step().state == RUNNING
