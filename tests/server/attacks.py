"""Attacks on a server of the arm: what they cost it, and those beside them.

``python tests/server/attacks.py --help`` lists them. Each starts a server of its own (the program
that `OCTOARM_SERVER_FOLDER` names, or the newest that cargo has built), attacks it on loopback for
a while, prints what was measured as JSON, and ends. ``test_attacks.py`` asserts what does not
depend on how busy the machine is.
"""

from __future__ import annotations

import argparse
import functools
import itertools
import json
import subprocess
import sys
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import grpc
import numpy as np
from clients import (
    END_HEADERS,
    HEADERS,
    Client,
    RawPeer,
    RefusedError,
    call_headers,
    frame,
    grpc_message,
    metrics,
    read_request,
    step_request,
    tensor,
    wait_for_levels,
)
from dm_env_rpc.v1 import dm_env_rpc_pb2 as pb
from octoarm_agents.common.serving import ServerProcess

TOKEN = "a-token.of_the/tests+0123456789="
HEALTH = "/grpc.health.v1.Health/Check"
DATA, WINDOW_UPDATE, PING, SETTINGS, GOAWAY = 0, 8, 6, 4, 7
ACK = 1
PIECE = 16384
LONG_STEP = {"num_envs": 1024, "control_period": 0.5}
"""A world with steps of half a second and more."""


def status(server: ServerProcess, key: str) -> int:
    """A number of the process: kB for ``VmRSS``, threads for ``Threads``."""
    text = Path(f"/proc/{server.process.pid}/status").read_text(encoding="utf-8")
    line = next(line for line in text.splitlines() if line.startswith(key + ":"))
    return int(line.split()[1])


def memory(server: ServerProcess) -> int:
    """Resident memory [bytes]."""
    return status(server, "VmRSS") * 1024


class Flood(RawPeer):
    """A connection whose streams each send the begin of a large message, as fast as they may."""

    def __init__(self, server: ServerProcess, streams: int, size: int, path: str = HEALTH) -> None:
        super().__init__(server)
        self.greet()
        self.sent: dict[int, int] = {}
        self._connection_window = 65535
        self._initial_window = 65535
        self._windows: dict[int, int] = defaultdict(int)
        self._size = size
        self.gone: set[int] = set()
        for stream in range(1, 2 * streams, 2):
            self.send(frame(HEADERS, END_HEADERS, stream, call_headers(path)))
            self.sent[stream] = 0

    def _receive(self) -> bool:
        """Take one frame; whether there is more to be had of the connection."""
        try:
            kind, flags, stream, payload = next(self.frames())
        except (ConnectionError, TimeoutError, OSError):
            return False
        if kind == WINDOW_UPDATE:
            more = int.from_bytes(payload, "big")
            if stream == 0:
                self._connection_window += more
            else:
                self._windows[stream] += more
        elif kind == SETTINGS and not flags & ACK:
            for start in range(0, len(payload), 6):
                if int.from_bytes(payload[start : start + 2], "big") == 4:
                    self._initial_window = int.from_bytes(payload[start + 2 : start + 6], "big")
            self.send(frame(SETTINGS, ACK, 0))
        elif kind == PING and not flags & ACK:
            self.send(frame(PING, ACK, 0, payload))
        elif kind == GOAWAY:
            return False
        elif (kind == HEADERS and flags & 1) or kind == 3:
            self.gone.add(stream)
        return True

    def run(self, seconds: float) -> int:
        """Send until nothing more is taken, for at most so long; the bytes that were sent."""
        self.socket.settimeout(1.0)
        end = time.monotonic() + seconds
        message = grpc_message(b"\0" * PIECE, length=self._size)
        alive = True
        while alive and time.monotonic() < end:
            progress = False
            for stream, sent in self.sent.items():
                window = self._initial_window + self._windows[stream] - sent
                room = min(window, self._connection_window)
                if stream in self.gone or sent >= self._size - PIECE or room < len(message):
                    continue
                piece = message if sent == 0 else message[5:]
                try:
                    self.send(frame(DATA, 0, stream, piece[:PIECE]))
                except OSError:
                    alive = False
                    break
                self.sent[stream] += PIECE
                self._connection_window -= PIECE
                progress = True
            if not progress:
                alive = alive and self._receive()
        return sum(self.sent.values())


def attack_memory(connections: int, streams: int, seconds: float = 20.0) -> dict[str, Any]:
    """Half-sent health checks of 4 MiB, without the token."""
    with (
        ServerProcess(environment={"OCTOARM_TOKEN": TOKEN}) as server,
        ExitStack() as stack,
    ):
        before = memory(server)
        floods = [stack.enter_context(Flood(server, streams, 4 << 20)) for _ in range(connections)]
        threads = [threading.Thread(target=flood.run, args=(seconds,)) for flood in floods]
        for thread in threads:
            thread.start()
        most = before
        while any(thread.is_alive() for thread in threads):
            most = max(most, memory(server))
            time.sleep(0.02)
        most = max(most, memory(server))
        sent = sum(sum(flood.sent.values()) for flood in floods)
        assert server.process.poll() is None, server.log
    return {"sent_MB": sent / 1e6, "memory_grown_MB": (most - before) / 1e6}


def attack_slots(connections: int) -> dict[str, Any]:
    """Connections that say nothing, all that the server takes, and one client."""
    with ServerProcess("--max-connections", str(connections)) as server, ExitStack() as stack:
        for _ in range(connections):
            stack.enter_context(RawPeer(server))
        begin = time.monotonic()
        with Client(server.address, timeout=20.0) as client:
            try:
                client.enter().step()
                served = True
            except grpc.RpcError:
                served = False
        return {"served": served, "seconds": time.monotonic() - begin}


def attack_threads(worlds: int, threads: int) -> dict[str, Any]:
    """Batch worlds that each ask for many threads."""
    with (
        ServerProcess("--max-threads", str(threads)) as server,
        Client(server.address) as maker,
    ):
        before = status(server, "Threads")
        with ExitStack() as stack:
            names = [maker.create(num_envs=64, threads=threads) for _ in range(worlds)]
            for name in names:
                client = stack.enter_context(Client(channel=maker.channel))
                client.join(name)
                client.step()
                client.step()
            return {"before": before, "threads": status(server, "Threads")}


def attack_worlds(count: int, options: tuple[str, ...] = ()) -> dict[str, Any]:
    """The largest worlds there are, as many as the server makes, up to so many."""
    time_ = np.arange(65536) * 2.0 * np.pi / 65536.0
    made, refusal = 0, None
    with ServerProcess("--max-physics-steps", "1000000000", *options) as server:
        before = memory(server)
        with Client(server.address) as client:
            for index in range(count):
                orbit = (5.0 + 0.01 * index) * np.column_stack([np.cos(time_), np.sin(time_)])
                settings = {"target": tensor(orbit), "control_period": tensor(0.01)}
                settings["arm.compartments"] = tensor(60)
                request = pb.CreateWorldRequest(settings=settings)
                answer = client.ask(pb.EnvironmentRequest(create_world=request))
                if answer.WhichOneof("payload") == "error":
                    refusal = answer.error.message
                    break
                made += 1
            grown = memory(server) - before
    return {"worlds": made, "memory_grown_MB": grown / 1e6, "refusal": refusal}


def _send_forever(
    client: Client,
    request: Callable[[], pb.EnvironmentRequest],
    stop: threading.Event,
    answers: list[None],
) -> None:
    try:
        while not stop.is_set():
            answer = client.ask(request())
            answers.append(None)
            if answer.WhichOneof("payload") == "create_world":
                client.destroy(answer.create_world.world_name)
    except (grpc.RpcError, StopIteration):
        pass


_NUMBERS = itertools.count()


def _unlike() -> pb.EnvironmentRequest:
    """A world that no other is like: its swing takes a second and more."""
    amplitude = tensor(60.0 + 0.001 * next(_NUMBERS))
    request = pb.CreateWorldRequest(settings={"amplitude": amplitude})
    request.settings["arm.timestep"].CopyFrom(tensor(0.0001))
    return pb.EnvironmentRequest(create_world=request)


def _refused() -> pb.EnvironmentRequest:
    """A world of a megabyte of settings that is refused for the last of its numbers."""
    rows = np.full((65536, 2), 10.0)
    rows[-1, -1] = 1e9
    return pb.EnvironmentRequest(
        create_world=pb.CreateWorldRequest(settings={"target": tensor(rows)})
    )


@contextmanager
def load(
    server: ServerProcess, kind: str, streams: int, answers: list[None] | None = None
) -> Iterator[None]:
    """One connection whose streams ask for something heavy again and again.

    Args:
        server: the server.
        kind: ``steps``, long ones of large batches; ``creates`` of worlds that are like no other;
            ``refused``, requests of a megabyte; or ``states`` of batches that are read.
        streams: how many ask at a time.
        answers: gets an entry for each answer.
    """
    counted = [] if answers is None else answers
    stop = threading.Event()
    with ExitStack() as stack:
        first = stack.enter_context(Client(server.address))
        clients = [
            stack.enter_context(Client(channel=first.channel, timeout=None)) for _ in range(streams)
        ]
        threads = []
        for client in clients:
            if kind == "steps":
                client.enter(**LONG_STEP)
                client.step(observations=[2])
                request = functools.partial(step_request, observations=[2])
            elif kind == "creates":
                request = _unlike
            elif kind == "refused":
                megabyte = _refused()
                request = functools.partial(lambda message: message, megabyte)
            else:
                client.enter(num_envs=128)
                client.step(observations=[2])
                request = functools.partial(read_request, "state")
            threads.append(
                threading.Thread(
                    target=_send_forever, args=(client, request, stop, counted), daemon=True
                )
            )
        for thread in threads:
            thread.start()
        try:
            yield
        finally:
            stop.set()


def _bystander(address: str, seconds: float) -> dict[str, Any]:
    """What a decent client waits for its answers [ms]."""
    times: dict[str, list[float]] = {"step": [], "create_world": []}
    with Client(address, timeout=None) as client:
        client.enter(max_episode_steps=-1)
        client.step()
        end = time.monotonic() + seconds
        count = 0
        last = end + 60.0
        while time.monotonic() < end or min(map(len, times.values())) < 5:
            if time.monotonic() > last:
                break
            begin = time.perf_counter()
            client.step([0.1, 0.1])
            times["step"].append(time.perf_counter() - begin)
            count += 1
            if count % 5 == 0:
                begin = time.perf_counter()
                name = client.create()
                times["create_world"].append(time.perf_counter() - begin)
                client.destroy(name)
            # The processor is not its alone.
            time.sleep(0.002)
    return {
        name: {
            "count": len(values),
            "p50_ms": 1e3 * float(np.percentile(values or [np.inf], 50)),
            "p99_ms": 1e3 * float(np.percentile(values or [np.inf], 99)),
        }
        for name, values in times.items()
    }


def attack_fairness(kind: str, streams: int, seconds: float) -> dict[str, Any]:
    """A decent client alone, and beside one connection with many heavy streams."""

    def measured(server: ServerProcess) -> dict[str, Any]:
        command = [sys.executable, __file__, "bystander", server.address, str(seconds)]
        return json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)

    with ServerProcess() as server:
        quiet = measured(server)
        with load(server, kind, streams):
            time.sleep(1.0)
            loaded = measured(server)
            threads = status(server, "Threads")
        server.process.kill()
    ratios = {name: loaded[name]["p99_ms"] / quiet[name]["p99_ms"] for name in quiet}
    return {"quiet": quiet, "loaded": loaded, "p99_ratio": ratios, "threads": threads}


def _decent(server: ServerProcess, rng: np.random.Generator) -> int:
    """Come, step a world of one arm or of many, read its state, and take leave; the steps."""
    num_envs = int(rng.choice([0, 0, 8, 64]))
    batch = {"num_envs": num_envs} if num_envs else {}
    steps = int(rng.integers(1, 200))
    with Client(server.address) as client:
        client.enter(
            seed=int(rng.integers(1000)), amplitude=float(rng.choice([30.0, 60.0, 90.0])), **batch
        )
        for _ in range(steps):
            client.step(rng.uniform(-1.0, 1.0, (num_envs, 2) if num_envs else 2))
        client.property("state")
        world = client.world
        client.leave()
        client.destroy(world)
    return steps


def _vanishing(server: ServerProcess, rng: np.random.Generator) -> int:
    """Make worlds, have one stepped for long, and be gone before the answer comes."""
    with Client(server.address) as client:
        for _ in range(int(rng.integers(1, 8))):
            client.create()
        client.enter(num_envs=256, control_period=0.1)
        client.step()
        client.send(step_request())
        time.sleep(0.05)
    return 1


def _mistaken(server: ServerProcess, rng: np.random.Generator) -> int:
    """Ask for what there is not, many times over one connection."""
    refused = 0
    with Client(server.address) as first:
        for _ in range(int(rng.integers(1, 20))):
            with Client(channel=first.channel) as client:
                try:
                    client.create(num_envs=-1)
                except RefusedError:
                    refused += 1
                client.ask(_refused())
    assert refused > 0
    return 0


def _mute(server: ServerProcess, rng: np.random.Generator) -> int:
    """Connect, send the begin of a request and of a health check, and hang up."""
    for length in (int(rng.integers(100, 1000)), 4 << 20):
        with RawPeer(server) as peer:
            peer.greet().call(grpc_message(b"\0" * 100, length=length))
        with Flood(server, 8, 4 << 20) as flood:
            flood.run(0.05)
    return 0


def attack_soak(seconds: float) -> dict[str, Any]:
    """Clients of all kinds that come and go; what the server holds when nobody is there."""
    kinds = [_decent, _decent, _vanishing, _mistaken, _mute]

    def live(server: ServerProcess, seconds: float, seed: int) -> Counter[str]:
        end = time.monotonic() + seconds
        counts: Counter[str] = Counter()
        errors: list[BaseException] = []

        def repeat(index: int) -> None:
            rng = np.random.default_rng([seed, index])
            try:
                while time.monotonic() < end and not errors:
                    steps = kinds[index](server, rng)
                    with lock:
                        counts[kinds[index].__name__[1:]] += 1
                        counts["steps"] += steps
            except BaseException as error:
                errors.append(error)

        lock = threading.Lock()
        threads = [threading.Thread(target=repeat, args=(index,)) for index in range(len(kinds))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        if errors:
            raise errors[0]
        return counts

    def held(server: ServerProcess) -> dict[str, float]:
        wait_for_levels(server, timeout=60.0, connections=0, streams=0, worlds=0)
        text = metrics(server)
        return {
            "threads": status(server, "Threads"),
            "open_files": len(list(Path(f"/proc/{server.process.pid}/fd").iterdir())),
            "resident_MB": memory(server) / 1e6,
            "bytes_in_flight": text["octoarm_in_flight_bytes"],
            "worlds": text["octoarm_worlds"],
            "world_bytes": text["octoarm_worlds_memory_bytes"],
            "streams": text["octoarm_streams"],
            "connections": text["octoarm_connections"],
        }

    first = min(60.0, seconds / 2.0)
    totals: Counter[str] = Counter()
    with ServerProcess("--metrics-port", "0", "--log-level", "warn") as server:
        found = [{"seconds": 0.0, **held(server)}]
        # The first minute fills what the server keeps on purpose, and its allocator's arenas.
        for seed, end in enumerate([first, *np.linspace(first, seconds, 6)[1:].tolist()]):
            totals.update(live(server, end - found[-1]["seconds"], seed))
            found.append({"seconds": end, **held(server)})
        return {"clients_and_steps": dict(totals), "held": found}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    commands = parser.add_subparsers(dest="command", required=True)

    def command(name: str, run: Callable[..., dict[str, Any]], **arguments: Any) -> None:
        sub = commands.add_parser(name, help=(run.__doc__ or "").strip())
        for argument, default in arguments.items():
            sub.add_argument(f"--{argument}", type=type(default), default=default)
        sub.set_defaults(run=run)

    command("memory", attack_memory, connections=2, streams=256, seconds=20.0)
    command("slots", attack_slots, connections=1024)
    command("threads", attack_threads, worlds=60, threads=64)
    command("worlds", attack_worlds, count=20)
    command("fairness", attack_fairness, kind="steps", streams=6, seconds=8.0)
    command("soak", attack_soak, seconds=600.0)
    bystander = commands.add_parser("bystander", help="the decent client of the others")
    bystander.add_argument("address")
    bystander.add_argument("seconds", type=float)
    bystander.set_defaults(run=_bystander)
    arguments = vars(parser.parse_args())
    run = arguments.pop("run")
    arguments.pop("command")
    print(json.dumps(run(**arguments), indent=2))


if __name__ == "__main__":
    main()
