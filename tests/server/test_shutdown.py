"""SIGTERM while the server is busy: it ends in time, and tells every client."""

from __future__ import annotations

import signal
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import Any

import grpc
import pytest
from clients import (
    Client,
    RawPeer,
    assert_no_nan,
    grpc_message,
    metrics,
    status_of,
    step_request,
    wait_for_levels,
    wait_until,
)
from dm_env_rpc.v1 import dm_env_rpc_pb2 as pb
from octoarm_agents.common.serving import ServerProcess

Code = grpc.StatusCode
RUNNING, INTERRUPTED = 1, 3
CREATE = pb.EnvironmentRequest(create_world=pb.CreateWorldRequest())
SLOWER = {"control_period": 0.05, "num_envs": 4096}
"""A world with steps of a second; the server must be told to allow it."""
ALLOW = ("--max-num-envs", "65536", "--max-physics-steps", "100000000")


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
