"""A client that lives: deadlines, another version, and episodes that outlive their server."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from clients import assert_same, wait_until
from octoarm_agents.common.serving import ServerProcess

from octoarm_env import OctoArmEnv, OctoArmVectorEnv
from octoarm_env.remote import RemoteError, RemoteOctoArm, RemoteOctoArmVectorEnv, connection, world


class Place:
    """An address at which one server follows another."""

    def __init__(self) -> None:
        self._stack = ExitStack()
        self.server = self._stack.enter_context(ServerProcess("--metrics-port", "0"))
        self.address = self.server.address

    def kill(self) -> None:
        self.server.process.kill()
        self.server.process.wait()

    def freeze(self) -> None:
        """It takes requests, and never answers."""
        self.server.process.send_signal(signal.SIGSTOP)
        stat = Path(f"/proc/{self.server.process.pid}/stat")
        wait_until(lambda: ") T " in stat.read_text(encoding="utf-8"), "it stands still")

    def thaw(self) -> None:
        self.server.process.send_signal(signal.SIGCONT)

    def start(self) -> None:
        port = self.address.rpartition(":")[2]
        self.server = self._stack.enter_context(
            ServerProcess("--port", port, "--metrics-port", "0")
        )

    def restart(self) -> None:
        self.kill()
        self.start()

    def close(self) -> None:
        self.thaw()
        self._stack.close()


@pytest.fixture
def place() -> Iterator[Place]:
    place = Place()
    yield place
    place.close()


def pair(kind: str, address: str, **arguments: Any) -> tuple[Any, Any, tuple[int, ...]]:
    """A remote environment, the local one like it, and the shape of an action."""
    if kind == "single":
        return RemoteOctoArm(address, **arguments), OctoArmEnv(), (2,)
    limit = {"max_episode_steps": 17}
    remote = RemoteOctoArmVectorEnv(3, address, **arguments, **limit)
    return remote, OctoArmVectorEnv(3, **limit), (3, 2)


KINDS = pytest.mark.parametrize("kind", ["single", "batch"])


@KINDS
def test_the_trajectory_goes_on_over_restarts(place: Place, kind: str) -> None:
    remote, local, shape = pair(kind, place.address, reconnect=True)
    random = np.random.default_rng(2)
    place.restart()
    assert_same(remote.reset(seed=5), local.reset(seed=5))
    # Before the state was asked for, just after it, and long after.
    for step in range(world._KEPT + 20):
        if step in (3, world._KEPT, world._KEPT + 1):
            place.restart()
        if step == 40:
            assert_same(remote.reset(), local.reset())
            place.restart()
        if step == 50:
            options = {"phase": 0.25}
            assert_same(remote.reset(options=options), local.reset(options=options))
        action = random.uniform(-1.0, 1.0, shape)
        assert_same(remote.step(action), local.step(action))
        assert len(remote._core._past) <= world._KEPT + 2
    place.restart()
    if kind == "single":
        assert_same(remote.teacher_action(), local.teacher_action())
    else:
        assert_same(remote.teacher_actions(), local.teacher_actions())
        snapshots = remote.snapshot(), local.snapshot()
        place.restart()
        remote.step(action)
        place.restart()
        remote.restore(snapshots[0])
        place.restart()
        assert_same(remote.step(action), local.step(action))
    remote.close()
    with pytest.raises(ConnectionError, match="is closed"):
        remote.step(action)


@KINDS
def test_a_restart_in_the_middle_of_a_step(place: Place, kind: str) -> None:
    remote, local, shape = pair(kind, place.address, reconnect=True)
    assert_same(remote.reset(seed=5), local.reset(seed=5))
    action = np.full(shape, 0.5)
    for _ in range(2):
        place.freeze()
        murder = threading.Timer(0.2, place.restart)
        murder.start()
        assert_same(remote.step(action), local.step(action))
        murder.join()
    remote.close()


def test_a_server_that_is_told_to_stop_is_followed_too(place: Place) -> None:
    remote, local, shape = pair("single", place.address, reconnect=True)
    assert_same(remote.reset(seed=5), local.reset(seed=5))
    assert place.server.stop() == 0
    late = threading.Timer(0.5, place.start)
    late.start()
    assert_same(remote.step(np.zeros(shape)), local.step(np.zeros(shape)))
    late.join()
    remote.close()


def test_a_server_that_stays_away_is_given_up_and_found_again_later(place: Place) -> None:
    remote, local, shape = pair("single", place.address, reconnect=True)
    assert_same(remote.reset(seed=5), local.reset(seed=5))
    place.kill()
    patient = remote._core._access
    remote._core._access = replace(patient, timeout=0.5)
    for _ in range(2):
        with pytest.raises(ConnectionError, match=r"no server answers at .* within 0.5 s"):
            remote.step(np.zeros(shape))
    place.start()
    remote._core._access = patient
    # A refused action is no reason to go on elsewhere.
    with pytest.raises(ValueError, match=r"action\[0\] = 1.5"):
        remote.step([1.5, 0.0])
    assert_same(remote.step(np.zeros(shape)), local.step(np.zeros(shape)))
    remote.close()


@KINDS
@pytest.mark.parametrize("reconnect", [False, True])
def test_an_answer_has_its_time(place: Place, kind: str, reconnect: bool) -> None:
    remote, local, shape = pair(kind, place.address, reconnect=reconnect)
    assert_same(remote.reset(seed=5), local.reset(seed=5))
    place.freeze()
    # To make a world may take longer where others work.
    remote._core.connection._timeout = 0.5
    with pytest.raises(TimeoutError, match=rf"timeout = 0\.5 s: the server at {place.address} has"):
        remote.step(np.zeros(shape))
    place.thaw()
    if not reconnect:
        with pytest.raises(ConnectionError, match=r"timeout = 0\.5 s.*; reset\(\) connects anew"):
            remote.step(np.zeros(shape))
        assert_same(remote.reset(seed=5), local.reset(seed=5))
    assert_same(remote.step(np.zeros(shape)), local.step(np.zeros(shape)))
    remote.close()


@pytest.mark.parametrize("reconnect", [False, True])
def test_after_an_interrupt(place: Place, reconnect: bool) -> None:
    remote, local, shape = pair("batch", place.address, reconnect=reconnect)
    assert_same(remote.reset(seed=5), local.reset(seed=5))
    still = np.zeros(shape)
    place.freeze()

    def stop(*_: Any) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, stop)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.2)
        with pytest.raises(KeyboardInterrupt):
            remote.step(np.full(shape, 0.75))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        place.thaw()
    if not reconnect:
        calls: list[Callable[[], Any]] = [
            lambda: remote.step(still),
            remote.snapshot,
            remote.teacher_actions,
        ]
        messages = set()
        for call in calls:
            with pytest.raises(ConnectionError, match="was interrupted before its") as caught:
                call()
            messages.add(str(caught.value))
        assert len(messages) == 1
        assert_same(remote.reset(seed=5), local.reset(seed=5))
    # What was broken into was not asked for.
    assert_same(remote.step(still), local.step(still))
    remote.close()


def test_nothing_of_the_old_world_is_left(place: Place) -> None:
    from clients import levels

    remote, _, shape = pair("batch", place.address, reconnect=True)
    remote.reset(seed=5)
    for _ in range(3):
        remote._core.connection._end("lost")
        remote.step(np.zeros(shape))
    wait_until(lambda: levels(place.server)["worlds"] == 1, "old worlds go")
    remote.close()
    wait_until(lambda: levels(place.server)["streams"] == 0, "the last stream ends")


@pytest.mark.parametrize("other", ["9.9.9", "0.0.1"])
def test_another_version_is_told(
    server: ServerProcess, monkeypatch: pytest.MonkeyPatch, other: str
) -> None:
    monkeypatch.setattr(connection, "_VERSION", other)
    for make in (RemoteOctoArm, lambda address: RemoteOctoArmVectorEnv(2, address)):
        with pytest.raises(RemoteError, match=r"octoarm-server \d.*, this is octoarm") as caught:
            make(server.address)
        assert other in str(caught.value)
        assert caught.value.code == 9
    major, minor, _ = octoarm_version().split(".", 2)
    monkeypatch.setattr(connection, "_VERSION", f"{major}.{minor}.99")
    RemoteOctoArm(server.address).close()


def octoarm_version() -> str:
    import octoarm_env

    return octoarm_env.__version__


def test_reconnect_is_a_flag(server: ServerProcess) -> None:
    with pytest.raises(TypeError, match="reconnect = 3: expected True or False"):
        RemoteOctoArm(server.address, reconnect=3)
