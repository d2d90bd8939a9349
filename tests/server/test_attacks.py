"""Attacks on the server, small and bounded; `attacks.py` has them at full size, with figures."""

from __future__ import annotations

import os
import resource
import signal
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from urllib.parse import urlsplit

import attacks
import grpc
import numpy as np
import pytest
from clients import (
    Bystander,
    Client,
    RawPeer,
    RefusedError,
    fetch,
    grpc_message,
    levels,
    metrics,
    nothing_left,
    open_channel,
    status_of,
    step_request,
    tensor,
    wait_for_levels,
    wait_until,
)
from dm_env_rpc.v1 import dm_env_rpc_pb2 as pb
from octoarm_agents.common.serving import ServerProcess

Code = grpc.StatusCode
RESOURCE_EXHAUSTED, UNAVAILABLE = 8, 14
RUNNING, INTERRUPTED = 1, 3
WATCH = "/grpc.health.v1.Health/Watch"
SERVING, NOT_SERVING = b"\x08\x01", b"\x08\x02"


def test_who_has_no_token_cannot_fill_the_memory() -> None:
    cost = attacks.attack_memory(connections=2, streams=100, seconds=10.0)
    # Of 800 MB that were to be sent.
    assert cost["memory_grown_MB"] < 64.0


def test_few_calls_at_a_time_before_one_is_let_in() -> None:
    with (
        ServerProcess(
            "--metrics-port", "0", environment={"OCTOARM_TOKEN": attacks.TOKEN}
        ) as server,
        open_channel(server.address) as channel,
        ExitStack() as stack,
    ):
        watch = channel.unary_stream(WATCH)
        calls = [watch(b"") for _ in range(8)]
        for call in calls:
            assert next(call) == SERVING
        with pytest.raises(grpc.RpcError) as refused:
            next(watch(b""))
        assert refused.value.code() is Code.RESOURCE_EXHAUSTED
        # Who has the token may have more.
        client = stack.enter_context(Client(channel=channel, token=attacks.TOKEN))
        client.enter()
        assert next(watch(b"")) == SERVING


def test_a_request_that_does_not_come_to_its_end_ends_its_stream() -> None:
    options = ("--metrics-port", "0", "--message-timeout", "0.3")
    with (
        ServerProcess(*options) as server,
        nothing_left(server),
        Bystander(server),
        RawPeer(server) as half,
        Client(server.address) as slow,
    ):
        slow.enter()
        half.greet().call(grpc_message(b"\0" * 10, length=100))
        wait_for_levels(server, streams=3)
        wait_for_levels(server, streams=2)
        # A pause between two requests is another matter.
        time.sleep(0.5)
        assert slow.step().state == RUNNING


def test_requests_on_their_way_have_so_much_room() -> None:
    options = ("--metrics-port", "0", "--max-bytes-in-flight", "2000000")
    rows = np.full((40000, 2), 10.0)
    create = pb.CreateWorldRequest(settings={"target": tensor(rows)})
    large = pb.EnvironmentRequest(create_world=create)
    with (
        ServerProcess(*options) as server,
        nothing_left(server),
        Bystander(server),
        attacks.Flood(server, 1, 1_300_000, "/dm_env_rpc.v1.Environment/Process") as flood,
        Client(server.address) as client,
        Client(server.address) as other,
    ):
        flood.run(10.0)
        held = "octoarm_in_flight_bytes"
        wait_until(lambda: metrics(server)[held] > 1_200_000, "most of the room is taken")
        client.send(large)
        assert status_of(client) is Code.RESOURCE_EXHAUSTED
        # What is small goes on.
        other.enter()
        flood.drop()
        wait_until(lambda: metrics(server)[held] < 10_000, "the room is free again")


def test_worlds_have_so_much_memory() -> None:
    limit = 20_000_000
    found = attacks.attack_worlds(10, ("--max-world-bytes", str(limit)))
    assert 1 <= found["worlds"] < 10
    assert f"{limit} that this server's worlds may have" in found["refusal"]


def test_what_is_reckoned_for_worlds_is_what_they_take() -> None:
    with ServerProcess("--metrics-port", "0") as server, Client(server.address) as client:
        client.create(num_envs=8, amplitude=50.0)
        before, reckoned = attacks.memory(server), metrics(server)["octoarm_worlds_memory_bytes"]
        for index in range(8):
            client.create(num_envs=256, amplitude=51.0 + index)
        taken = attacks.memory(server) - before
        reckoned = metrics(server)["octoarm_worlds_memory_bytes"] - reckoned
        # Ten percent more for the allocator.
        assert taken < 1.1 * reckoned
        assert reckoned < 3 * taken


def test_threads_are_few_whatever_the_worlds_ask_for() -> None:
    found = attacks.attack_threads(worlds=12, threads=64)
    assert found["threads"] <= 2 * (os.cpu_count() or 1) + 16


@pytest.mark.parametrize(("kind", "streams"), [("steps", 6), ("creates", 6), ("refused", 24)])
def test_a_decent_client_does_not_wait_for_a_greedy_one(kind: str, streams: int) -> None:
    answers: list[None] = []
    with (
        ServerProcess() as server,
        Client(server.address).enter() as bystander,
        attacks.load(server, kind, streams, answers),
    ):
        time.sleep(0.2)
        before = len(answers)
        for _ in range(5):
            bystander.step()
            bystander.create()
        # One by one would be five of the others' for each of these.
        assert len(answers) - before <= 5
        server.process.kill()


def test_silent_connections_lock_out_nobody() -> None:
    assert attacks.attack_slots(12)["served"]


def test_an_address_has_so_many_places() -> None:
    options = ("--max-connections-per-address", "3", "--metrics-port", "0")
    with ServerProcess(*options) as server, ExitStack() as stack:
        known = [stack.enter_context(Client(server.address)).enter() for _ in range(2)]
        silent = stack.enter_context(RawPeer(server))
        wait_for_levels(server, connections=3)
        # It takes the place of the one that nobody knows.
        known.append(stack.enter_context(Client(server.address)).enter())
        silent.wait_for_end()
        with RawPeer(server) as late:
            late.wait_for_end()
        assert all(client.step().state == RUNNING for client in known)
        found = metrics(server)
        assert found['octoarm_connections_turned_away_total{reason="evicted"}'] == 1
        assert found['octoarm_connections_turned_away_total{reason="address"}'] == 1


def test_who_watches_the_health_may_stay() -> None:
    options = ("--probation-timeout", "0.3", "--metrics-port", "0")
    environment = {"OCTOARM_TOKEN": attacks.TOKEN}
    with (
        ServerProcess(*options, environment=environment) as server,
        open_channel(server.address) as channel,
        RawPeer(server) as silent,
    ):
        watch = channel.unary_stream(WATCH)(b"")
        assert next(watch) == SERVING
        silent.wait_for_end()
        time.sleep(0.5)
        assert levels(server)["connections"] == 1
        server.process.send_signal(signal.SIGTERM)
        assert next(watch) == NOT_SERVING


def test_a_server_that_drains_lets_episodes_come_to_their_end() -> None:
    options = ("--drain-timeout", "60", "--metrics-port", "0")
    with (
        ServerProcess(*options) as server,
        Client(server.address) as client,
        Client(server.address) as other,
    ):
        health = server.metrics_url.replace("/metrics", "/healthz")
        client.enter(max_episode_steps=20)
        client.step()
        other.enter()
        assert fetch(health) == (200, "serving\n")
        server.process.send_signal(signal.SIGTERM)
        wait_until(lambda: fetch(health) == (503, "stopping\n"), "the server drains")
        for refused in (other.create, other.step):
            with pytest.raises(RefusedError, match="about to stop") as error:
                refused()
            assert error.value.code == UNAVAILABLE
        with Client(server.address) as late:
            late.send(step_request())
            assert status_of(late) is Code.UNAVAILABLE
        states = [client.step([0.1, 0.1]).state for _ in range(20)]
        assert states == [RUNNING] * 19 + [INTERRUPTED]
        # Nobody is in an episode any more.
        assert status_of(client) is Code.UNAVAILABLE
        assert server.process.wait(60) == 0


def test_an_old_connection_takes_no_new_streams() -> None:
    options = ("--max-connection-age", "0.3", "--metrics-port", "0")
    with (
        ServerProcess(*options) as server,
        nothing_left(server),
        open_channel(server.address) as channel,
        Client(channel=channel) as old,
    ):
        old.enter().step()
        time.sleep(0.6)
        with Client(channel=channel) as new:
            new.enter().step()
            wait_for_levels(server, connections=2, streams=2)
            assert old.step([0.1, 0.1]).state == RUNNING


def test_silent_readers_do_not_lock_the_metrics() -> None:
    with ServerProcess("--metrics-port", "0") as server, ExitStack() as stack:
        assert server.metrics_url is not None
        place = type("Place", (), {"address": urlsplit(server.metrics_url).netloc})
        readers = [stack.enter_context(RawPeer(place)) for _ in range(40)]
        for reader in readers:
            reader.send(b"GET /metrics HTTP/1.1\r\n")
        assert metrics(server)["octoarm_connections"] == 0


def test_open_files_are_raised_or_connections_are_fewer() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (200, hard))
    try:
        with ServerProcess("--max-connections", "300") as server:
            limits = Path(f"/proc/{server.process.pid}/limits").read_text(encoding="utf-8")
            line = next(line for line in limits.splitlines() if line.startswith("Max open files"))
            assert int(line.split()[3]) == 364
            assert "fewer connections" not in server.log
        with ServerProcess("--max-connections", str(hard + 1)) as server:
            wait_until(lambda: "fewer connections" in server.log, "the warning")
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_reading_states_takes_no_more_threads() -> None:
    with ServerProcess() as server, ExitStack() as stack:
        first = stack.enter_context(Client(server.address))
        clients = [stack.enter_context(Client(channel=first.channel)) for _ in range(24)]
        for client in clients:
            client.enter(num_envs=32)
        before, most = attacks.status(server, "Threads"), 0
        reads = [threading.Thread(target=client.property, args=("state",)) for client in clients]
        for read in reads:
            read.start()
        while any(read.is_alive() for read in reads):
            most = max(most, attacks.status(server, "Threads"))
        assert most <= before
