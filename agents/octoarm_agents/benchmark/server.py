"""How fast a server of the arm answers, and what its clients wait for.

``octoarm-load`` loads the server over loopback, on the same processor. Clients in Python step it
from this process, beside the environment without a server.
"""

from __future__ import annotations

import gc
import json
import math
import statistics
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import partial
from typing import Any

import grpc
import numpy as np
from dm_env_rpc.v1 import connection, tensor_utils
from dm_env_rpc.v1 import dm_env_rpc_pb2 as protocol
from numpy.typing import NDArray

from octoarm_agents.benchmark.turns import Advance, Comparison, Contender, Result, take_turns
from octoarm_agents.common.serving import ServerProcess, find_program
from octoarm_env import OctoArmEnv, OctoArmVectorEnv

SERVER = "octoarm-server"
SLEEPING = "octoarm-server --busy-poll 0"

LOCAL = "OctoArmEnv, no server"
DEEPMIND = "dm_env_rpc's Connection"
REMOTE = "RemoteOctoArm"
"""Clients in Python, each alone with the server; and the environment itself."""
BATCHES = ((64, 0.01), (64, 0.05), (256, 0.01))
"""Arms and control period [s] of the batches that are stepped here and on the server."""

CONNECTIONS = (1, 16, 128)
PERIODS = (0.01, 0.001)
"""Control periods [s]: the default, and for a single connection one physics step too."""
PERCENTILES = {"p50": 0.5, "p90": 0.9, "p99": 0.99, "p99.9": 0.999}

MEDIAN = "p50_us"
OVER_PHYSICS = "over_physics_us"

_PATIENCE = 120.0
"""Seconds beyond its measuring time after which octoarm-load is given up."""
_WARM_UP = 20
"""Steps of a client before anything is timed, as in octoarm-load."""
_TURN = 25
"""Steps of a client between two looks at the clock, as in octoarm-load."""

ACTION = 1
SPRING_LENGTHS, REWARD, TERMINATED = 1, 2, 9
"""Numbers on the wire."""

Step = Callable[[NDArray[np.float32]], Any]


class LoadError(RuntimeError):
    """A server could not be measured."""


def batch_name(arms: int, period: float, *, remote: bool) -> str:
    """Name of a batch of so many arms at a control period [s]."""
    kind = "RemoteOctoArmVectorEnv" if remote else "OctoArmVectorEnv, no server,"
    return f"{kind} of {arms}, {1000 * period:g} ms"


def load_name(contender: str, connections: int, period: float) -> str:
    """Name of a contender under so many connections at a control period [s]."""
    plural = "" if connections == 1 else "s"
    return f"{contender}, {connections} connection{plural}, {1000 * period:g} ms"


def measure_server(
    seconds: float = 60.0, rounds: int = 11, advance: Advance | None = None
) -> Result:
    """Load the server, and step it from Python.

    Args:
        seconds: time for all slices together; starting servers and making worlds comes on top.
        rounds: slices of each contender.
        advance: called with a contender's name and the number of slices in all, after each slice.

    Raises:
        ServerNotFoundError: a program of the server is not installed.
        LoadError: octoarm-load fails.
        RuntimeError: the server does not start.
    """
    program = str(find_program("octoarm-load"))
    alone = [(1, period) for period in PERIODS]
    with ExitStack() as stack:
        server = stack.enter_context(ServerProcess()).address
        sleeping = stack.enter_context(ServerProcess("--busy-poll", "0")).address
        many = [(connections, PERIODS[0]) for connections in CONNECTIONS if connections > 1]
        # Where there are many connections the server never polls anyway.
        cases = [(SERVER, server, case) for case in [*alone, *many]]
        cases += [(SLEEPING, sleeping, case) for case in alone]
        contenders = [
            Contender(load_name(name, *case), partial(_load, program, address, *case))
            for name, address, case in cases
        ]
        clients: dict[str, Callable[[], AbstractContextManager[Step]]] = {
            LOCAL: partial(_stepping, OctoArmEnv),
            DEEPMIND: partial(_deepmind, server),
        }
        left_out = {}
        try:
            from octoarm_env.remote import RemoteOctoArm, RemoteOctoArmVectorEnv

            clients[REMOTE] = partial(_stepping, partial(RemoteOctoArm, server))
            for arms, period in BATCHES:
                here = partial(OctoArmVectorEnv, arms, control_period=period)
                there = partial(RemoteOctoArmVectorEnv, arms, server, control_period=period)
                clients[batch_name(arms, period, remote=False)] = partial(_stepping_many, here)
                clients[batch_name(arms, period, remote=True)] = partial(_stepping_many, there)
        except ImportError as error:
            left_out[REMOTE] = str(error)
        contenders += [Contender(name, partial(_drive, each)) for name, each in clients.items()]
        result = take_turns(contenders, seconds, rounds, advance)
    result.comparisons = comparisons()
    result.left_out = left_out
    result.packages = ["grpcio", "protobuf", "dm-env-rpc"]
    return result


def comparisons() -> list[Comparison]:
    """What polling saves, and what clients wait for."""
    found = []
    for period in PERIODS:
        sleeping, polling = (load_name(each, 1, period) for each in (SLEEPING, SERVER))
        key, label = f"busy_poll_saves_{1000 * period:g}_ms", f"{sleeping} − polling: a round trip"
        found.append(Comparison(key, label, sleeping, polling, "µs", MEDIAN))
    for key, client in (("deepmind", DEEPMIND), ("remote", REMOTE)):
        for word, sign, unit in (("minus", "−", "µs"), ("over", "/", "×")):
            label = f"{client} {sign} {LOCAL}: a step"
            found.append(Comparison(f"{key}_{word}_local", label, client, LOCAL, unit, MEDIAN))
    for arms, period in BATCHES:
        remote, local = (batch_name(arms, period, remote=each) for each in (True, False))
        key = f"remote_batch_of_{arms}_over_local_{1000 * period:g}_ms"
        label = f"{remote} / {local}: steps a second"
        found.append(Comparison(key, label, remote, local))
    return found


def _load(
    program: str, address: str, connections: int, period: float, seconds: float
) -> dict[str, float]:
    """Let octoarm-load load a server."""
    command = [program, f"http://{address}", "--connections", str(connections)]
    command += ["--control-period", repr(period), "--seconds", f"{seconds:.6f}"]
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            encoding="utf-8",
            timeout=seconds + _PATIENCE,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise LoadError(
            f"octoarm-load is not ready {_PATIENCE:g} s after its time: {' '.join(command)}"
        ) from None
    if done.returncode != 0:
        raise LoadError(
            f"octoarm-load failed ({done.returncode}): {done.stderr.strip()}; {' '.join(command)}"
        )
    content = json.loads(done.stdout)
    figures = {"steps_per_second": content["steps_per_second"]}
    figures |= {f"{name}_us": content["round_trip_us"][name] for name in PERCENTILES}
    # Beyond the same steps in the load's own process; of a single connection alone.
    over = content["over_physics_us"]
    return figures if over is None else figures | {OVER_PHYSICS: over["p50"]}


@contextmanager
def _stepping(make: Callable[[], OctoArmEnv]) -> Iterator[Step]:
    env = make()
    try:
        env.reset(seed=0)
        yield env.step
    finally:
        env.close()


@contextmanager
def _stepping_many(make: Callable[[], OctoArmVectorEnv]) -> Iterator[Step]:
    """All arms under the action of one."""
    envs = make()
    try:
        envs.reset(seed=0)
        yield lambda action: envs.step(np.broadcast_to(action, (envs.num_envs, 2)))
    finally:
        envs.close()


@contextmanager
def _deepmind(address: str) -> Iterator[Step]:
    """The client of the package dm_env_rpc, with arrays on this side."""
    wanted = [SPRING_LENGTHS, REWARD, TERMINATED]
    # To this machine, whatever proxy there is to others.
    with grpc.insecure_channel(address, [("grpc.enable_http_proxy", 0)]) as channel:
        client = connection.Connection(channel)
        settings = {
            "max_episode_steps": tensor_utils.pack_tensor(-1),
            "seed": tensor_utils.pack_tensor(0),
        }
        world = client.send(protocol.CreateWorldRequest(settings=settings)).world_name
        client.send(protocol.JoinWorldRequest(world_name=world))
        client.send(protocol.StepRequest())

        def step(action: NDArray[np.float32]) -> list[Any]:
            packed = tensor_utils.pack_tensor(action, np.float64)
            request = protocol.StepRequest(actions={ACTION: packed}, requested_observations=wanted)
            observations = client.send(request).observations
            return [tensor_utils.unpack_tensor(observations[uid]) for uid in wanted]

        try:
            yield step
        finally:
            # The end of its requests, for which a thread of gRPC waits forever otherwise.
            client._stream.write(None)
            client.close()


def _drive(client: Callable[[], AbstractContextManager[Step]], seconds: float) -> dict[str, float]:
    """Time every step of a client in this process.

    It is made anew, since the server polls for a single stream only.
    """
    angles = 0.05 * np.arange(2 * _TURN * 126)  # about a hundred turns of the load's wave
    actions = 0.5 * np.column_stack([np.sin(angles), np.cos(angles)]).astype(np.float32)
    clock, times = time.perf_counter, []
    with client() as step:
        for action in actions[:_WARM_UP]:
            step(action)
        collecting = gc.isenabled()
        gc.disable()
        try:
            end = clock() + seconds
            first = _WARM_UP
            while clock() < end:
                for index in range(first, first + _TURN):
                    action = actions[index % len(actions)]
                    begun = clock()
                    step(action)
                    times.append(clock() - begun)
                first += _TURN
        finally:
            if collecting:
                gc.enable()
    times.sort()
    # The same percentiles as octoarm-load's.
    last = len(times) - 1
    return {"steps_per_second": 1.0 / statistics.fmean(times)} | {
        f"{name}_us": 1e6 * times[math.floor(share * last + 0.5)]
        for name, share in PERCENTILES.items()
    }
