"""Worlds and threads that several streams share."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from clients import (
    PATIENCE,
    Client,
    RefusedError,
    nothing_left,
    step_request,
    tensor,
    wait_for_levels,
)
from dm_env_rpc.v1 import dm_env_rpc_pb2 as pb
from octoarm_agents.common.serving import ServerProcess

from octoarm_env import OctoArmEnv

INVALID_ARGUMENT, NOT_FOUND, FAILED_PRECONDITION, INTERNAL = 3, 5, 9, 13
RUNNING, INTERRUPTED = 1, 3
SLOWER = {"control_period": 0.05, "num_envs": 4096}
"""A world with steps of a second; the server must be told to allow it."""
ALLOW = ("--max-num-envs", "65536", "--max-physics-steps", "100000000")


@pytest.fixture
def server(watched_server: ServerProcess) -> ServerProcess:
    return watched_server


def test_a_world_that_takes_ages_to_make_keeps_no_one_waiting() -> None:
    options = ("--metrics-port", "0", "--max-threads", "1", "--shutdown-timeout", "0.2")
    endless = {"arm.timestep": tensor(1e-7), "control_period": tensor(1e-7)}
    with (
        ServerProcess(*options) as server,
        Client(server.address) as client,
        Client(server.address, timeout=PATIENCE) as other,
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
        wait_for_levels(server, worlds=1)


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
