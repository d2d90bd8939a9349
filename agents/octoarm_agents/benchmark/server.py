"""How fast a server of the arm answers, and what its clients wait for.

As in :mod:`octoarm_agents.benchmark.speed`, contenders take turns and ratios are formed within a
round. ``octoarm-load`` loads the server over loopback, on the same processor. Clients in Python
step it from this process, beside the environment without a server.
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
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any

import grpc
import numpy as np
from dm_env_rpc.v1 import connection, tensor_utils
from dm_env_rpc.v1 import dm_env_rpc_pb2 as protocol
from numpy.typing import NDArray

from octoarm_agents.benchmark.speed import Ratio, Spread
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.serving import ServerProcess, find_program
from octoarm_env import OctoArmEnv

__all__ = [
    "CONNECTIONS",
    "DEEPMIND",
    "LOCAL",
    "PERCENTILES",
    "PERIODS",
    "REMOTE",
    "RUST",
    "RUST_SLEEPING",
    "TARGET",
    "Load",
    "LoadError",
    "Sample",
    "ServerResult",
    "load_name",
    "measure_server",
]

RUST = "octoarm-server"
RUST_SLEEPING = "octoarm-server --busy-poll 0"

LOCAL = "OctoArmEnv, no server"
DEEPMIND = "dm_env_rpc's Connection"
REMOTE = "RemoteOctoArm"
"""Clients in Python, each alone with the server in Rust; and the environment itself."""

CONNECTIONS = (1, 16, 128)
PERIODS = (0.01, 0.001)
"""Control periods [s]: the default, and for a single connection one physics step too."""
PERCENTILES = {"p50": 0.5, "p90": 0.9, "p99": 0.99, "p99.9": 0.999}

TARGET = 150.0
"""Wanted median of what a round trip of a single connection takes beyond the physics [µs]."""

_KEYS = {RUST: "rust", RUST_SLEEPING: "rust_sleeping"}
_CLIENT_KEYS = {DEEPMIND: "deepmind", REMOTE: "remote"}

_PATIENCE = 120.0
"""Seconds beyond its measuring time after which octoarm-load is given up."""
_SHORTEST = 0.001
"""Shortest slice [s]; octoarm-load makes a number of steps at least anyway."""
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


def load_name(contender: str, connections: int, period: float) -> str:
    """Name of a contender under so many connections at a control period [s]."""
    plural = "" if connections == 1 else "s"
    return f"{contender}, {connections} connection{plural}, {1000 * period:g} ms"


@dataclass(frozen=True)
class Sample:
    """A contender in one round.

    Attributes:
        steps: made by all connections together.
        steps_per_second: of the time in which answers were waited for.
        round_trip: microseconds of a step, by percentile.
        over_physics: median of what the steps took beyond the same steps in the process of the
            load [µs]; None for more than one connection, and for clients in Python.
    """

    steps: int
    steps_per_second: float
    round_trip: dict[str, float]
    over_physics: float | None = None


@dataclass(frozen=True)
class Load:
    """What is measured in every round.

    Attributes:
        contender: a server, or a client in Python.
        connections: at a time; 0 without a server.
        period: from one action to the next [s].
        take: measure for so many seconds.
    """

    contender: str
    connections: int
    period: float
    take: Callable[[float], Sample]


@dataclass
class ServerResult:
    """Samples of servers and clients, by round.

    Attributes:
        rounds: number of rounds.
        seconds: of a slice.
        loads: what was measured, by name: servers by `load_name`, clients by their own.
        samples: in each round, by name.
        left_out: clients that could not be timed, and why.
    """

    rounds: int
    seconds: float
    loads: dict[str, Load]
    samples: dict[str, list[Sample]] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)

    def rates(self, name: str) -> Spread:
        """Steps a second."""
        return Spread.of([sample.steps_per_second for sample in self.samples[name]])

    def round_trips(self, name: str) -> dict[str, Spread]:
        """Microseconds of a step, by percentile."""
        return {
            percentile: Spread.of([sample.round_trip[percentile] for sample in self.samples[name]])
            for percentile in PERCENTILES
        }

    def over_physics(self, name: str) -> Spread | None:
        """Microseconds of a round trip beyond the physics, the rounds' medians."""
        found = [sample.over_physics for sample in self.samples[name]]
        values = [value for value in found if value is not None]
        return Spread.of(values) if values else None

    def ratios(self) -> list[Ratio]:
        """All comparisons of which both sides were measured."""
        return [*self._of_servers(), *self._of_clients()]

    def _of_servers(self) -> Iterator[Ratio]:
        for period in PERIODS:
            own, other = (load_name(each, 1, period) for each in (RUST, RUST_SLEEPING))
            if {own, other} <= set(self.samples):
                spread = self._compared(other, own, lambda one, two: one - two, _median)
                key = f"busy_poll_saves_{1000 * period:g}_ms"
                label = f"{other} − polling: a round trip"
                yield Ratio(key, label, spread, "µs")
        for name, load in self.loads.items():
            over = self.over_physics(name) if name in self.samples else None
            if over is not None:
                key = f"over_physics_{_KEYS[load.contender]}_{1000 * load.period:g}_ms"
                yield Ratio(key, f"{name}: beyond the physics", over, "µs")

    def _of_clients(self) -> Iterator[Ratio]:
        for client, key in _CLIENT_KEYS.items():
            if {client, LOCAL} <= set(self.samples):
                more = self._compared(client, LOCAL, lambda one, two: one - two, _median)
                yield Ratio(f"{key}_minus_local", f"{client} − {LOCAL}: a step", more, "µs")
                times = self._compared(client, LOCAL, lambda one, two: one / two, _median)
                yield Ratio(f"{key}_over_local", f"{client} / {LOCAL}: a step", times)

    def _compared(
        self,
        name: str,
        other: str,
        compare: Callable[[float, float], float],
        figure: Callable[[Sample], float],
    ) -> Spread:
        pairs = zip(self.samples[name], self.samples[other], strict=True)
        return Spread.of([compare(figure(one), figure(two)) for one, two in pairs])

    def target(self) -> dict[str, Any]:
        """Whether a round trip of a single connection costs as little as is wanted."""
        medians = {}
        for period in PERIODS:
            spread = self.over_physics(load_name(RUST, 1, period))
            assert spread is not None
            medians[f"{1000 * period:g}_ms"] = spread.median
        return {
            "over_physics_us": TARGET,
            "median_us": medians,
            "reached": max(medians.values()) <= TARGET,
        }

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain numbers for a JSON file; units in the keys."""
        loads = {}
        for name, load in self.loads.items():
            over = self.over_physics(name)
            loads[name] = {
                "contender": load.contender,
                "connections": load.connections,
                "control_period_seconds": load.period,
                "steps": sum(sample.steps for sample in self.samples[name]),
                "steps_per_second": self.rates(name).to_dict(),
                "round_trip_us": {
                    percentile: spread.to_dict()
                    for percentile, spread in self.round_trips(name).items()
                },
                "over_physics_us_p50": None if over is None else over.to_dict(),
            }
        return {
            "rounds": self.rounds,
            "seconds_per_slice": self.seconds,
            "target": self.target(),
            "loads": loads,
            "ratios": {
                ratio.key: ratio.spread.to_dict() | {"label": ratio.label, "unit": ratio.unit}
                for ratio in self.ratios()
            },
            "left_out": self.left_out,
            "samples_by_round": {
                name: [asdict(sample) for sample in samples]
                for name, samples in self.samples.items()
            },
            "machine": describe_machine(),
            "versions": package_versions(
                "octoarm-env",
                "octoarm-agents",
                "numpy",
                "gymnasium",
                "grpcio",
                "protobuf",
                "dm-env-rpc",
            ),
        }


def measure_server(
    seconds: float = 60.0, rounds: int = 11, advance: Callable[[str, int], Any] | None = None
) -> ServerResult:
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
    with ExitStack() as stack:
        addresses = {
            RUST: stack.enter_context(ServerProcess()).address,
            RUST_SLEEPING: stack.enter_context(ServerProcess("--busy-poll", "0")).address,
        }
        loads = {}
        for contender, address in addresses.items():
            for period, connections in _cases():
                # The others never poll where there are many connections.
                if contender == RUST_SLEEPING and connections > 1:
                    continue
                take = partial(_load, program, address, connections, period)
                name = load_name(contender, connections, period)
                loads[name] = Load(contender, connections, period, take)
        clients, left_out = _clients(addresses[RUST])
        for name, client in clients.items():
            connections = 0 if name == LOCAL else 1
            loads[name] = Load(name, connections, PERIODS[0], partial(_drive, client))
        slices = rounds * len(loads)
        result = ServerResult(rounds, max(seconds / slices, _SHORTEST), loads, left_out=left_out)
        names = list(loads)
        result.samples = {name: [] for name in names}
        for turn in range(rounds):
            # Every round begins with another contender, so that none always follows the same one.
            for index in range(len(names)):
                name = names[(turn + index) % len(names)]
                result.samples[name].append(loads[name].take(result.seconds))
                if advance is not None:
                    advance(name, slices)
    return result


def _cases() -> list[tuple[float, int]]:
    """Control periods and connections of a server."""
    return [(PERIODS[0], connections) for connections in CONNECTIONS] + [
        (period, 1) for period in PERIODS[1:]
    ]


def _median(sample: Sample) -> float:
    return sample.round_trip["p50"]


def _load(program: str, address: str, connections: int, period: float, seconds: float) -> Sample:
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
    over = content["over_physics_us"]
    return Sample(
        content["steps"],
        content["steps_per_second"],
        {percentile: content["round_trip_us"][percentile] for percentile in PERCENTILES},
        None if over is None else over["p50"],
    )


def _clients(
    address: str,
) -> tuple[dict[str, Callable[[], AbstractContextManager[Step]]], dict[str, str]]:
    """What steps from this process, by name; what had to be left out, and why."""
    clients: dict[str, Callable[[], AbstractContextManager[Step]]] = {
        LOCAL: partial(_stepping, OctoArmEnv),
        DEEPMIND: partial(_deepmind, address),
    }
    try:
        from octoarm_env.remote import RemoteOctoArm
    except ImportError as error:
        return clients, {REMOTE: str(error)}
    clients[REMOTE] = partial(_stepping, partial(RemoteOctoArm, address))
    return clients, {}


@contextmanager
def _stepping(make: Callable[[], OctoArmEnv]) -> Iterator[Step]:
    env = make()
    try:
        env.reset(seed=0)
        yield env.step
    finally:
        env.close()


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


def _drive(client: Callable[[], AbstractContextManager[Step]], seconds: float) -> Sample:
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
    trips = {
        name: 1e6 * times[math.floor(share * last + 0.5)] for name, share in PERCENTILES.items()
    }
    return Sample(len(times), 1.0 / statistics.fmean(times), trips)
