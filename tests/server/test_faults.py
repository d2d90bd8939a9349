"""Clients that die, fall silent or talk nonsense: the server lives, and nobody else notices."""

from __future__ import annotations

import json
import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
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
    array_of,
    call_headers,
    drain,
    frame,
    grpc_message,
    metrics,
    nothing_left,
    open_channel,
    property_request,
    read_request,
    status_of,
    step_request,
    tensor,
    wait_for_levels,
    wait_until,
    write_request,
)
from dm_env_rpc.v1 import dm_env_rpc_pb2 as pb
from dm_env_rpc.v1.extensions import properties_pb2
from google.protobuf import any_pb2, message_factory
from google.protobuf.descriptor import FieldDescriptor
from hypothesis import strategies as st
from octoarm_agents.serving import ServerProcess

from octoarm_env import OctoArmEnv

Code = grpc.StatusCode
INVALID_ARGUMENT, NOT_FOUND, FAILED_PRECONDITION, INTERNAL = 3, 5, 9, 13
RUNNING, INTERRUPTED = 1, 3
CREATE = pb.EnvironmentRequest(create_world=pb.CreateWorldRequest())
SLOW = {"control_period": 0.05, "num_envs": 1024}
"""A world with steps of a quarter of a second."""
SLOWER = {"control_period": 0.05, "num_envs": 4096}
"""A world with steps of a second; the server must be told to allow it."""
ALLOW = ("--max-num-envs", "65536", "--max-physics-steps", "100000000")


@pytest.fixture(scope="module")
def quiet_server() -> Iterator[ServerProcess]:
    """A server that no other file's tests use, so that its levels are those of these tests."""
    with ServerProcess("--metrics-port", "0") as server:
        yield server


@pytest.fixture
def server(quiet_server: ServerProcess) -> Iterator[ServerProcess]:
    """The server, with a bystander at its side; the test must leave nothing behind."""
    with nothing_left(quiet_server), Bystander(quiet_server):
        yield quiet_server


@contextmanager
def stepping_process(server: ServerProcess, **world: Any) -> Iterator[subprocess.Popen[str]]:
    """A process that does nothing but step."""
    program = (
        "import json, sys\n"
        "from clients import Client\n"
        "client = Client(sys.argv[1]).enter(**json.loads(sys.argv[2]))\n"
        "client.step()\n"
        "print('stepping', flush=True)\n"
        "while True:\n"
        "    client.step()\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program, server.address, json.dumps(world)],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parent)},
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "stepping\n"
        yield process
    finally:
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()


@pytest.mark.parametrize("world", [{}, SLOW], ids=["short steps", "long steps"])
def test_a_killed_client_s_world_is_freed(server: ServerProcess, world: dict[str, Any]) -> None:
    with stepping_process(server, **world) as process:
        wait_for_levels(server, connections=2, streams=2, worlds=2)
        process.send_signal(signal.SIGKILL)
        process.wait()
        wait_for_levels(server, connections=1, streams=1, worlds=1)


def test_a_peer_that_stops_answering_is_given_up() -> None:
    # The bystander and the quiet client too have only so long to answer, on a busy machine.
    options = ("--keepalive-interval", "0.2", "--keepalive-timeout", "0.7", "--metrics-port", "0")
    with (
        ServerProcess(*options) as server,
        nothing_left(server),
        Bystander(server),
        Client(server.address) as quiet,
        RawPeer(server) as mute,
        RawPeer(server) as greeting,
        RawPeer(server) as half,
        RawPeer(server) as owner,
        stepping_process(server) as frozen,
    ):
        quiet.enter()
        greeting.greet()
        half.send(PREFACE[:10])
        owner.greet().call(grpc_message(CREATE.SerializeToString()))
        owner.wait_for_data()
        wait_for_levels(server, worlds=4)
        frozen.send_signal(signal.SIGSTOP)
        for peer in (mute, greeting, half, owner):
            peer.wait_for_end()
        wait_for_levels(server, connections=2, streams=2, worlds=2)
        # It has said nothing for as long as the mute one was borne.
        time.sleep(1.8)
        assert quiet.step().state == RUNNING


def test_a_client_that_reads_no_answers_keeps_nothing() -> None:
    options = ("--idle-timeout", "1", "--metrics-port", "0")
    with (
        ServerProcess(*options) as server,
        nothing_left(server),
        Client(server.address).enter() as client,
        RawPeer(server) as peer,
    ):
        with Bystander(server):
            peer.greet().call(grpc_message(CREATE.SerializeToString()))
            created = pb.EnvironmentResponse.FromString(peer.wait_for_data()[5:])
            name = created.create_world.world_name
            join = pb.EnvironmentRequest(join_world=pb.JoinWorldRequest(world_name=name))
            peer.send_message(join.SerializeToString())
            wait_for_levels(server, worlds=3)
            step = step_request().SerializeToString()
            for _ in range(400):
                client.send(step_request())
                peer.send_message(step)
            wait_for_levels(server, worlds=1)
            assert metrics(server)["octoarm_idle_streams_total"] == 2
        # Those already on their way come, and then the end.
        assert status_of(client) is Code.DEADLINE_EXCEEDED


def test_an_idle_stream_is_ended_and_its_worlds_are_freed() -> None:
    options = ("--idle-timeout", "1", "--metrics-port", "0")
    with (
        ServerProcess(*options) as server,
        nothing_left(server),
        Bystander(server),
        Client(server.address) as joined,
        Client(server.address) as owner,
        Client(server.address) as silent,
    ):
        joined.enter()
        owner.create()
        owner.create()
        wait_for_levels(server, streams=4, worlds=4)
        wait_for_levels(server, streams=1, worlds=1)
        for client in (joined, owner, silent):
            with pytest.raises(grpc.RpcError, match=r"no request for 1 s \(idle_timeout\)") as end:
                client.read()
            assert end.value.code() is Code.DEADLINE_EXCEEDED
        assert metrics(server)["octoarm_idle_streams_total"] == 3


def test_streams_that_wait_for_each_other_do_not_wait_forever() -> None:
    options = ("--idle-timeout", "0.5", "--metrics-port", "0")
    with (
        ServerProcess(*options) as server,
        nothing_left(server),
        Client(server.address) as first,
        Client(server.address) as second,
    ):
        first.enter()
        second.enter()
        for client, other in ((first, second), (second, first)):
            reset = pb.ResetWorldRequest(world_name=other.world)
            client.send(pb.EnvironmentRequest(reset_world=reset))
        wait_for_levels(server, worlds=0, timeout=8.0)
        for client in (first, second):
            assert status_of(client) is Code.DEADLINE_EXCEEDED


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

        @hypothesis.settings(max_examples=150, deadline=None, database=None)
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
    "target",
    "amplitude",
    "control_period",
    "actuator",
    "action_range",
    "tracking_weight",
    "reward_width",
    "action_change_weight",
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
    | st.lists(st.integers(1, 11) | _whole(0, 2**64 - 1), max_size=5),
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


def assert_no_nan(step: pb.StepResponse) -> None:
    for uid, observation in step.observations.items():
        value = array_of(observation)
        if value.dtype == np.float64:
            assert not np.isnan(value).any(), (uid, value)


def test_well_formed_nonsense() -> None:
    # What is allowed must be quick.
    limits = ("--max-physics-steps", "10000", "--max-num-envs", "4")
    with (
        ServerProcess("--metrics-port", "0", *limits) as server,
        nothing_left(server),
        Bystander(server),
        open_channel(server.address) as channel,
    ):

        @hypothesis.settings(
            max_examples=120,
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

        @hypothesis.settings(max_examples=150, deadline=None, database=None)
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
    status = Path(f"/proc/{server.process.pid}/status").read_text()
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


def connect_and_drop(server: ServerProcess, number: int) -> None:
    """One of the ways to come and go."""
    way = number % 4
    if way == 0:
        RawPeer(server).socket.close()
    elif way == 1:
        RawPeer(server).drop()
    elif way == 2:
        peer = RawPeer(server).greet().call(grpc_message(CREATE.SerializeToString()))
        peer.wait_for_data()
        peer.drop()
    else:
        with Client(server.address) as client:
            client.enter().step()


def test_a_thousand_connections_come_and_go(server: ServerProcess) -> None:
    def come_and_go(count: int) -> float:
        for number in range(count):
            connect_and_drop(server, number)
        wait_for_levels(server, connections=1, streams=1, worlds=1)
        return metrics(server)["process_resident_memory_bytes"]

    warm = come_and_go(200)
    after = come_and_go(1000)
    # An allocator may keep some pages more; it is 0.1 MiB. A world takes 35 KiB, a connection 27:
    # if those that came and went were kept, it would be 17 MiB for the one, 27 for the other.
    assert after - warm < 4 << 20


def step_until_the_end(client: Client) -> Code:
    try:
        while True:
            assert_no_nan(client.step())
    except grpc.RpcError as end:
        return end.code()


def test_sigterm_under_load_ends_every_stream() -> None:
    with ExitStack() as stack:
        server = stack.enter_context(ServerProcess("--metrics-port", "0"))
        clients = [stack.enter_context(Client(server.address)) for _ in range(5)]
        for client in clients:
            client.enter(max_episode_steps=-1)
        pool = stack.enter_context(ThreadPoolExecutor(len(clients)))
        ends = [pool.submit(step_until_the_end, client) for client in clients[1:]]
        steps = 'octoarm_requests_total{request="step",result="answered"}'
        wait_until(lambda: metrics(server)[steps] > 200, "200 steps")
        server.process.send_signal(signal.SIGTERM)
        # The standard shutdown_timeout; it takes milliseconds.
        assert server.process.wait(10) == 0
        assert [end.result() for end in ends] == [Code.UNAVAILABLE] * 4
        # One that was silent hears of it too.
        assert status_of(clients[0]) is Code.UNAVAILABLE
        assert "broken off" not in server.log
        with pytest.raises(ConnectionRefusedError):
            RawPeer(server)


@pytest.mark.parametrize(
    ("timeout", "world"),
    [("20", SLOWER), ("0.1", SLOWER | {"num_envs": 16384})],
    ids=["with time enough", "with no time"],
)
def test_sigterm_while_a_long_step_runs(timeout: str, world: dict[str, Any]) -> None:
    with (
        ServerProcess("--shutdown-timeout", timeout, *ALLOW) as server,
        Client(server.address).enter(**world) as client,
    ):
        client.step(observations=[2])
        client.send(step_request(observations=[2]))
        time.sleep(0.1)
        server.process.send_signal(signal.SIGTERM)
        if timeout == "20":
            assert client.read().step.state == RUNNING
        assert status_of(client) is Code.UNAVAILABLE
        assert server.process.wait(20) == 0
        assert ("broken off" in server.log) == (timeout != "20")


def test_sigterm_while_peers_say_nothing() -> None:
    options = ("--metrics-port", "0", "--shutdown-timeout", "20")
    with (
        ServerProcess(*options) as server,
        RawPeer(server) as mute,
        RawPeer(server) as greeting,
        RawPeer(server) as owner,
        Client(server.address) as client,
    ):
        greeting.greet()
        owner.greet().call(grpc_message(CREATE.SerializeToString()))
        owner.wait_for_data()
        client.enter()
        wait_for_levels(server, connections=4, streams=2)
        server.process.send_signal(signal.SIGTERM)
        # They never say that they have understood the goodbye.
        assert server.process.wait(10) == 0
        assert "broken off" not in server.log
        for peer in (mute, greeting, owner):
            peer.wait_for_end()
        assert status_of(client) is Code.UNAVAILABLE


def test_sigterm_while_a_reset_waits() -> None:
    with (
        ServerProcess("--metrics-port", "0") as server,
        Client(server.address) as joined,
        Client(server.address) as other,
    ):
        name = joined.enter().world
        joined.step()
        other.send(pb.EnvironmentRequest(reset_world=pb.ResetWorldRequest(world_name=name)))
        wait_for_levels(server, streams=2)
        time.sleep(0.1)
        server.process.send_signal(signal.SIGTERM)
        assert server.process.wait(10) == 0
        assert status_of(joined) is Code.UNAVAILABLE
        assert status_of(other) is Code.UNAVAILABLE
        assert "broken off" not in server.log


def test_sigterm_while_answers_are_not_read() -> None:
    with (
        ServerProcess("--metrics-port", "0", "--shutdown-timeout", "0.5") as server,
        Client(server.address).enter() as client,
    ):
        for _ in range(3000):
            client.send(step_request())
        time.sleep(0.5)
        server.process.send_signal(signal.SIGTERM)
        assert server.process.wait(20) == 0


def test_a_world_that_takes_ages_to_make_keeps_no_one_waiting() -> None:
    options = ("--metrics-port", "0", "--max-threads", "1", "--shutdown-timeout", "0.2")
    endless = {"arm.timestep": tensor(1e-7), "control_period": tensor(1e-7)}
    with (
        ServerProcess(*options) as server,
        Client(server.address) as client,
        Client(server.address, timeout=5.0) as other,
    ):
        create = pb.CreateWorldRequest(settings=endless)
        client.send(pb.EnvironmentRequest(create_world=create))
        time.sleep(0.2)
        assert other.create()


def test_a_stream_that_ends_while_its_step_waits_for_a_thread() -> None:
    options = ("--metrics-port", "0", "--max-threads", "1", *ALLOW)
    with (
        ServerProcess(*options) as server,
        nothing_left(server),
        Client(server.address).enter(**SLOWER) as busy,
        Client(server.address).enter(**SLOWER) as waiting,
    ):
        busy.step(observations=[2])
        waiting.step(observations=[2])
        busy.send(step_request(observations=[2]))
        time.sleep(0.2)
        waiting.send(step_request(observations=[2]))
        time.sleep(0.2)
        waiting.close()
        busy.read()
        wait_for_levels(server, worlds=1, timeout=5.0)


def test_a_reset_of_another_s_world_waits_for_its_step(server: ServerProcess) -> None:
    env = OctoArmEnv()
    with (
        Client(server.address) as joined,
        Client(server.address) as other,
        ThreadPoolExecutor(1) as pool,
    ):
        name = joined.enter(seed=1).world
        assert joined.step().state == RUNNING
        assert joined.step([0.5, 0.5]).state == RUNNING
        reset = pool.submit(other.reset_world, name, seed=5)
        time.sleep(0.3)
        assert not reset.done()
        end = joined.step([0.5, -0.5])
        reset.result(PATIENCE)
        assert end.state == INTERRUPTED
        assert joined.named(end)["truncated"]
        # It tells where the interrupted episode stood.
        env.reset(seed=1)
        last = env.step(np.array([0.5, 0.5], dtype=np.float32))[0]
        assert joined.named(end)["spring_lengths"].tobytes() == last.tobytes()
        begin = joined.step()
        assert begin.state == RUNNING
        first = env.reset(seed=5)[0]
        assert joined.named(begin)["spring_lengths"].tobytes() == first.tobytes()
        # Where no one has joined, there is nobody to wait for.
        joined.leave()
        other.reset_world(name)


def test_a_reset_that_waits_ends_with_the_joined_stream(server: ServerProcess) -> None:
    with (
        Client(server.address) as owner,
        Client(server.address) as joined,
        ThreadPoolExecutor(2) as pool,
    ):
        name = owner.create()
        joined.join(name)
        joined.step()
        reset = pool.submit(owner.reset_world, name)
        time.sleep(0.2)
        joined.close()
        reset.result(PATIENCE)
        owner.join(name)
        assert owner.step().state == RUNNING


def test_a_world_whose_client_went_while_it_waited_can_be_reset(server: ServerProcess) -> None:
    with (
        Client(server.address) as owner,
        Client(server.address) as visitor,
        Client(server.address) as other,
        Client(server.address) as heir,
        ThreadPoolExecutor(1) as pool,
    ):
        name = owner.create()
        visitor.join(name)
        reset = pb.ResetWorldRequest(world_name=other.enter().world)
        visitor.send(pb.EnvironmentRequest(reset_world=reset))
        time.sleep(0.2)
        visitor.close()
        wait_for_levels(server, streams=4)
        heir.join(name)
        heir.step()
        waiting = pool.submit(owner.reset_world, name)
        time.sleep(0.2)
        assert heir.step().state == INTERRUPTED
        waiting.result(PATIENCE)


def test_a_joined_world_outlives_its_maker(server: ServerProcess) -> None:
    env = OctoArmEnv()
    with Client(server.address) as owner, Client(server.address) as heir:
        name, spare = owner.create(seed=3), owner.create()
        heir.join(name)
        heir.step()
        wait_for_levels(server, streams=3, worlds=3)
        owner.close()
        wait_for_levels(server, streams=2, worlds=2)
        env.reset(seed=3)
        for _ in range(20):
            found = heir.observe([0.25, -0.25])["spring_lengths"]
            expected = env.step(np.array([0.25, -0.25], dtype=np.float32))[0]
            assert found.tobytes() == expected.tobytes()
        heir.leave()
        for gone in (name, spare):
            with pytest.raises(RefusedError, match="no such world"):
                heir.join(gone)
        wait_for_levels(server, worlds=1)


def test_a_joined_world_cannot_be_destroyed_or_joined(server: ServerProcess) -> None:
    with Client(server.address) as owner, Client(server.address) as joined:
        name = owner.create()
        joined.join(name)
        for client in (owner, joined):
            with pytest.raises(RefusedError, match="its client must leave it first") as error:
                client.destroy(name)
            assert error.value.code == FAILED_PRECONDITION
        with pytest.raises(RefusedError, match="joined already") as error:
            owner.join(name)
        assert error.value.code == FAILED_PRECONDITION
        assert joined.step().state == RUNNING
        joined.leave()
        owner.destroy(name)
        with pytest.raises(RefusedError, match="no such world"):
            joined.join(name)


def test_many_streams_of_many_threads_give_the_same_bits(server: ServerProcess) -> None:
    def run(seed: int) -> None:
        env = OctoArmEnv()
        with Client(server.address) as client:
            client.enter(seed=seed)
            client.step()
            env.reset(seed=seed)
            for _ in range(50):
                found = client.observe([0.5, 0.25])["spring_lengths"]
                expected = env.step(np.array([0.5, 0.25], dtype=np.float32))[0]
                assert found.tobytes() == expected.tobytes()

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(run, range(24)))
