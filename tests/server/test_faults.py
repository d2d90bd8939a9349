"""Clients that die, fall silent or do not listen: the server lives, and nobody else notices."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import pytest
from clients import (
    PREFACE,
    Bystander,
    Client,
    RawPeer,
    grpc_message,
    metrics,
    nothing_left,
    status_of,
    step_request,
    wait_for_levels,
)
from dm_env_rpc.v1 import dm_env_rpc_pb2 as pb
from octoarm_agents.common.serving import ServerProcess

from octoarm_env.remote import RemoteOctoArm

Code = grpc.StatusCode
RUNNING, INTERRUPTED = 1, 3
CREATE = pb.EnvironmentRequest(create_world=pb.CreateWorldRequest())
SLOW = {"control_period": 0.05, "num_envs": 1024}
"""A world with steps of a quarter of a second."""


@pytest.fixture
def server(watched_server: ServerProcess) -> ServerProcess:
    return watched_server


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


def test_an_environment_that_rests_is_not_given_up() -> None:
    options = ("--keepalive-interval", "0.2", "--keepalive-timeout", "1.5", "--metrics-port", "0")
    with ServerProcess(*options) as server, Bystander(server):
        env = RemoteOctoArm(server.address)
        env.reset(seed=1)
        time.sleep(3.0)
        env.step(np.zeros(2))
        env.close()


def test_a_peer_that_stops_answering_is_given_up() -> None:
    # The bystander and the quiet client too have only so long to answer, on a busy machine.
    options = ("--keepalive-interval", "0.2", "--keepalive-timeout", "0.7", "--metrics-port", "0")
    with (
        ServerProcess(*options) as server,
        nothing_left(server),
        Bystander(server),
        Client(server.address) as quiet,
        stepping_process(server) as frozen,
        # Last, for they have only so long to come to something.
        RawPeer(server) as mute,
        RawPeer(server) as greeting,
        RawPeer(server) as half,
        RawPeer(server) as owner,
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


def test_a_pause_of_the_server_ends_no_connection() -> None:
    options = ("--keepalive-interval", "0.2", "--keepalive-timeout", "0.7", "--metrics-port", "0")
    with ServerProcess(*options) as server, Client(server.address) as quiet:
        quiet.enter()
        server.process.send_signal(signal.SIGSTOP)
        # Longer than a connection may be silent.
        time.sleep(2.5)
        server.process.send_signal(signal.SIGCONT)
        time.sleep(0.3)
        assert quiet.step().state == RUNNING


def test_a_client_that_reads_no_answers_keeps_nothing() -> None:
    options = ("--idle-timeout", "3", "--metrics-port", "0")
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
    options = ("--idle-timeout", "3", "--metrics-port", "0")
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
            with pytest.raises(grpc.RpcError, match=r"no request for 3 s \(idle_timeout\)") as end:
                client.read()
            assert end.value.code() is Code.DEADLINE_EXCEEDED
        assert metrics(server)["octoarm_idle_streams_total"] == 3


def test_streams_that_wait_for_each_other_do_not_wait_forever() -> None:
    options = ("--idle-timeout", "3", "--metrics-port", "0")
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
        wait_for_levels(server, worlds=0)
        for client in (first, second):
            assert status_of(client) is Code.DEADLINE_EXCEEDED


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


def test_many_connections_come_and_go(server: ServerProcess) -> None:
    def come_and_go(count: int) -> float:
        for number in range(count):
            connect_and_drop(server, number)
        wait_for_levels(server, connections=1, streams=1, worlds=1)
        return metrics(server)["process_resident_memory_bytes"]

    warm = come_and_go(100)
    after = come_and_go(400)
    # An allocator may keep some pages more; it is 0.1 MiB. A world takes 35 KiB, a connection 27:
    # if those that came and went were kept, it would be 7 MiB for the one, 11 for the other.
    assert after - warm < 4 << 20
