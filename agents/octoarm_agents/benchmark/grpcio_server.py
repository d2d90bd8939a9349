"""The environment behind grpcio, a server in Python: what the server in Rust is compared with.

It speaks the part of dm_env_rpc that a client needs to step an arm, and gives the very numbers that
``octoarm-server`` gives. It is written as one would write it in Python, in the two ways that grpcio
has: a thread for every stream, or, with ``--asyncio``, one loop for all. Messages are filled in
place, with the observations that are asked for.
"""

from __future__ import annotations

import argparse
import asyncio
import signal
import uuid
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import grpc
import grpc.aio
import numpy as np
from dm_env_rpc.v1 import dm_env_rpc_pb2 as protocol
from dm_env_rpc.v1 import dm_env_rpc_pb2_grpc, tensor_utils
from gymnasium import spaces

from octoarm_env import OctoArmEnv

__all__: list[str] = []

ACTION = 1
SPRING_LENGTHS, REWARD, TERMINATED = 1, 2, 9
"""Numbers on the wire, those of ``octoarm-server``."""

THREADS = 256
"""Streams at a time, each of which keeps a thread; threads are made when they are needed."""
MAX_EPISODE_STEPS = 500
GRACE = 1.0
"""Seconds that streams have for their end."""

_ENDS = (signal.SIGTERM, signal.SIGINT)
_OPTIONS = (("grpc.so_reuseport", 0),)
_SETTINGS = ("control_period", "max_episode_steps", "seed")


class _RefusalError(Exception):
    """A request that cannot be answered."""

    def __init__(self, code: grpc.StatusCode, message: str) -> None:
        super().__init__(message)
        self.code: int = code.value[0]


def _invalid(message: str) -> _RefusalError:
    return _RefusalError(grpc.StatusCode.INVALID_ARGUMENT, message)


class _World:
    """An arm and its episodes."""

    def __init__(self, tensors: Any) -> None:
        settings = {name: tensor_utils.unpack_tensor(tensor) for name, tensor in tensors.items()}
        unknown = sorted(set(settings) - set(_SETTINGS))
        if unknown:
            raise _invalid(f"unknown settings {unknown}; known are {', '.join(_SETTINGS)}")
        self._seed = int(settings["seed"]) if "seed" in settings else None
        if self._seed is not None and self._seed < 0:
            raise _invalid(f"seed = {self._seed}: expected none below 0")
        limit = int(settings.get("max_episode_steps", MAX_EPISODE_STEPS))
        if limit != -1 and limit < 1:
            raise _invalid(f"max_episode_steps = {limit}: expected a positive number, or -1")
        self.env = OctoArmEnv(control_period=float(settings.get("control_period", 0.01)))
        self._limit = None if limit == -1 else limit
        self._running = False
        self._steps = 0

    def leave(self) -> None:
        """End the episode."""
        self._running = False

    def step(self, request: Any, answer: Any) -> None:
        """Begin an episode, or go on by a control period."""
        wanted = request.requested_observations
        for uid in wanted:
            if uid not in (SPRING_LENGTHS, REWARD, TERMINATED):
                raise _invalid(f"observation {uid} is unknown")
        reward, terminated, state = 0.0, False, protocol.RUNNING
        if self._running:
            actions = request.actions
            if list(actions) != [ACTION]:
                raise _invalid(f"expected action {ACTION} alone")
            action = np.array(actions[ACTION].doubles.array)
            lengths, earned, terminated, _, _ = self.env.step(action)
            reward = float(earned)
            self._steps += 1
            if terminated:
                state = protocol.TERMINATED
            elif self._steps == self._limit:
                state = protocol.INTERRUPTED
            self._running = state == protocol.RUNNING
        else:
            lengths, _ = self.env.reset(seed=self._seed)
            self._seed, self._steps, self._running = None, 0, True
        answer.state = state
        observations = answer.observations
        if SPRING_LENGTHS in wanted:
            tensor = observations[SPRING_LENGTHS]
            tensor.doubles.array.extend(lengths.tolist())
            tensor.shape.append(len(lengths))
        if REWARD in wanted:
            observations[REWARD].doubles.array.append(reward)
        if TERMINATED in wanted:
            observations[TERMINATED].bools.array.append(terminated)

    def describe(self, specs: Any) -> None:
        """Tell what can be done and seen."""
        space = self.env.observation_space
        assert isinstance(space, spaces.Box)
        action = specs.actions[ACTION]
        action.name, action.dtype = "action", protocol.DOUBLE
        action.shape.append(2)
        action.min.doubles.array.append(-1.0)
        action.max.doubles.array.append(1.0)
        lengths = specs.observations[SPRING_LENGTHS]
        lengths.name, lengths.dtype = "spring_lengths", protocol.DOUBLE
        lengths.shape.append(len(space.low))
        lengths.min.doubles.array.append(space.low[0])
        lengths.max.doubles.array.append(space.high[0])
        reward = specs.observations[REWARD]
        reward.name, reward.dtype = "reward", protocol.DOUBLE
        terminated = specs.observations[TERMINATED]
        terminated.name, terminated.dtype = "terminated", protocol.BOOL


class _Stream:
    """The worlds that a stream has made, and the one that it has joined."""

    def __init__(self) -> None:
        self._worlds: dict[str, _World] = {}
        self._joined: _World | None = None

    def answer(self, request: Any) -> Any:
        """Answer a request, be it by an error."""
        kind = request.WhichOneof("payload")
        response = protocol.EnvironmentResponse()
        try:
            if kind == "step":
                if self._joined is None:
                    raise _RefusalError(
                        grpc.StatusCode.FAILED_PRECONDITION, "no world is joined: join one first"
                    )
                self._joined.step(request.step, response.step)
            elif kind in ("create_world", "join_world", "leave_world", "destroy_world"):
                answer = getattr(response, kind)
                answer.SetInParent()
                getattr(self, f"_{kind}")(getattr(request, kind), answer)
            else:
                raise _RefusalError(
                    grpc.StatusCode.UNIMPLEMENTED, f"this server does not know {kind}"
                )
        except _RefusalError as error:
            response.error.code, response.error.message = error.code, str(error)
        except (TypeError, ValueError) as error:  # of the environment, naming the argument
            code: int = grpc.StatusCode.INVALID_ARGUMENT.value[0]
            response.error.code, response.error.message = code, str(error)
        return response

    def _create_world(self, request: Any, answer: Any) -> None:
        world = _World(request.settings)
        answer.world_name = uuid.uuid4().hex
        self._worlds[answer.world_name] = world

    def _join_world(self, request: Any, answer: Any) -> None:
        if self._joined is not None:
            raise _RefusalError(
                grpc.StatusCode.FAILED_PRECONDITION, "a world is joined: leave it first"
            )
        self._joined = self._find(request.world_name)
        self._joined.describe(answer.specs)

    def _leave_world(self, request: Any, answer: Any) -> None:
        if self._joined is not None:
            self._joined.leave()
            self._joined = None

    def _destroy_world(self, request: Any, answer: Any) -> None:
        if self._find(request.world_name) is self._joined:
            raise _RefusalError(
                grpc.StatusCode.FAILED_PRECONDITION, "the world is joined: leave it first"
            )
        del self._worlds[request.world_name]

    def _find(self, name: str) -> _World:
        if name not in self._worlds:
            raise _RefusalError(grpc.StatusCode.NOT_FOUND, f"there is no world {name!r}")
        return self._worlds[name]


class _Servicer:
    """The service, a thread for every stream."""

    def Process(self, requests: Iterator[Any], context: Any) -> Iterator[Any]:  # noqa: N802, so named by the protocol
        # Some clients send nothing before they have the headers.
        context.send_initial_metadata(())
        stream = _Stream()
        for request in requests:
            yield stream.answer(request)


class _AsyncServicer:
    """The service, one thread for all streams."""

    async def Process(self, _requests: Any, context: Any) -> None:  # noqa: N802, so named by the protocol
        await context.send_initial_metadata(())
        stream = _Stream()
        while (request := await context.read()) is not grpc.aio.EOF:
            await context.write(stream.answer(request))


def _listen(server: Any, servicer: Any, port: int) -> int:
    dm_env_rpc_pb2_grpc.add_EnvironmentServicer_to_server(servicer, server)
    taken: int = server.add_insecure_port(f"127.0.0.1:{port}")
    return taken


def _announce(port: int) -> None:
    print(f"listening on http://127.0.0.1:{port}", flush=True)


def _serve(port: int) -> None:
    """Serve with threads until the process is asked to end."""
    # Before there are threads, so that none of them takes the signal.
    signal.pthread_sigmask(signal.SIG_BLOCK, _ENDS)
    server = grpc.server(ThreadPoolExecutor(THREADS), options=_OPTIONS)
    port = _listen(server, _Servicer(), port)
    server.start()
    _announce(port)
    signal.sigwait(_ENDS)
    server.stop(GRACE).wait()


async def _serve_asyncio(port: int) -> None:
    """Serve in one loop until the process is asked to end."""
    end = asyncio.Event()
    for each in _ENDS:
        asyncio.get_running_loop().add_signal_handler(each, end.set)
    server = grpc.aio.server(options=_OPTIONS)
    port = _listen(server, _AsyncServicer(), port)
    await server.start()
    _announce(port)
    await end.wait()
    await server.stop(GRACE)


def main() -> None:
    """Serve on loopback, and say where in the first line of standard output."""
    parser = argparse.ArgumentParser(description="The octopus arm behind grpcio.")
    parser.add_argument("--port", type=int, default=0, help="0 takes a free one")
    parser.add_argument("--asyncio", action="store_true", help="one loop instead of threads")
    options = parser.parse_args()
    if options.asyncio:
        asyncio.run(_serve_asyncio(options.port))
    else:
        _serve(options.port)


if __name__ == "__main__":
    main()
