"""Whatever breaks into a request, and whenever: no answer is taken for that to another request."""

from __future__ import annotations

import copy
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

import gymnasium as gym
import numpy as np
import pytest
from clients import assert_same, nothing_left, wait_until
from octoarm_agents.common.serving import ServerProcess

import octoarm_env.remote
from octoarm_env import OctoArmEnv
from octoarm_env.remote import RemoteOctoArm

CLIENT = str(Path(octoarm_env.remote.__file__).parent)
INTERRUPTED, NEXT = np.array([0.5, -0.25]), np.array([-0.125, 0.75])
"""The action that is broken into, and the one after it."""


T = TypeVar("T")


class Alarm(ValueError):  # noqa: N818
    """What a handler raises: of the kind that the server's refusals are too."""


def interrupted(seconds: float, error: type[BaseException], call: Callable[[], T]) -> T | None:
    """Call while an error is raised from a signal's handler, if that is before the call ends.

    The error may be raised at any moment in which the signal is awaited, before the call, too.

    Returns:
        What was returned, or None if the error came first.
    """

    def handler(number: int, frame: FrameType | None) -> None:
        raise error

    before = signal.signal(signal.SIGALRM, handler)
    try:
        try:
            signal.setitimer(signal.ITIMER_REAL, seconds)
            return call()
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
    except error:
        return None
    finally:
        signal.signal(signal.SIGALRM, before)


class Break:
    """Breaks into the `moment`-th line of the client that runs, in this thread.

    Attributes:
        late: whether there were fewer lines.
    """

    def __init__(self, moment: int, error: type[BaseException]) -> None:
        self._left = moment
        self._error = error
        self.late = True

    def _trace(self, frame: FrameType, event: str, argument: Any) -> Any:
        if not frame.f_code.co_filename.startswith(CLIENT):
            return None
        if event == "line":
            self._left -= 1
            if self._left < 0 and self.late:
                self.late = False
                raise self._error
        return self._trace

    def __enter__(self) -> Break:
        self._before = sys.gettrace()
        sys.settrace(self._trace)
        return self

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> bool:
        sys.settrace(self._before)
        return kind is self._error


def breaks(error: type[BaseException]) -> Iterator[Break]:
    """One for every line, up to the first that comes too late."""
    for moment in range(10_000):
        yield (found := Break(moment, error))
        if found.late:
            assert moment > 5
            return
    pytest.fail("no end")


@contextmanager
def nothing_of_this_process_left(server: ServerProcess) -> Iterator[None]:
    """Neither stream, world nor connection at the server, nor a thread here."""
    before = threading.active_count()
    with nothing_left(server):
        yield
    wait_until(lambda: threading.active_count() <= before, "the client's threads end")


def same(found: Any, expected: Any) -> bool:
    try:
        assert_same(found, expected)
    except AssertionError:
        return False
    return True


class Pair:
    """An environment on the server, the local one, and whether a request was broken into."""

    def __init__(self, address: str) -> None:
        self.remote, self.local = RemoteOctoArm(address), OctoArmEnv()
        self.seed = 0
        self.reconnected = 0
        self.begin()

    def begin(self) -> None:
        """Begin an episode in both, which must be the same."""
        self.seed += 1
        assert_same(self.remote.reset(seed=self.seed), self.local.reset(seed=self.seed))

    def compare(self, calls: list[Callable[[OctoArmEnv], Any]]) -> None:
        """Compare the step after the calls, of which any may have been the last, with the local."""
        twins = [self.local]
        for call in calls:
            twins.append(copy.deepcopy(twins[-1]))
            call(twins[-1])
        try:
            found = self.remote.step(NEXT)
        except ConnectionError:
            with pytest.raises(ConnectionError, match=r"interrupted.*reset\(\) connects anew"):
                self.remote.teacher_action()
            self.reconnected += 1
            self.begin()
            found = self.remote.step(NEXT)
            twins = [self.local]
        assert any(same(found, twin.step(NEXT)) for twin in twins)
        self.begin()


@pytest.fixture
def pair(quiet_server: ServerProcess) -> Iterator[Pair]:
    with nothing_of_this_process_left(quiet_server):
        pair = Pair(quiet_server.address)
        yield pair
        pair.remote.close()
        del pair


def step(env: OctoArmEnv) -> Any:
    return env.step(INTERRUPTED)


def reset(env: OctoArmEnv) -> Any:
    return env.reset(seed=1000)


@pytest.mark.parametrize(("call", "error"), [(step, Alarm), (reset, KeyboardInterrupt)])
def test_a_signal_at_any_time(
    pair: Pair, call: Callable[[OctoArmEnv], Any], error: type[BaseException]
) -> None:
    for microseconds in range(20, 2000, 45):
        interrupted(1e-6 * microseconds, error, lambda: call(pair.remote))
        calls = [call]
        if call is reset:
            # Seeded, and nothing else yet.
            calls = [lambda env: env._core.seed(1000), reset]
        pair.compare(calls)
    assert pair.reconnected > 0


@pytest.mark.parametrize(("call", "error"), [(step, Alarm), (reset, KeyboardInterrupt)])
def test_an_interrupt_at_every_line(
    pair: Pair, call: Callable[[OctoArmEnv], Any], error: type[BaseException]
) -> None:
    for moment in breaks(error):
        with moment:
            call(pair.remote)
        calls = [call] if call is step else [lambda env: env._core.seed(1000), reset]
        pair.compare(calls)
    assert pair.reconnected > 0


def test_an_interrupt_of_the_step_that_ends_an_episode(quiet_server: ServerProcess) -> None:
    # An arm that fails: a step that was answered, but not noted, would begin another episode.
    arguments: dict[str, Any] = {
        "arm": octoarm_env.ArmParameters.preset("inertial"),
        "actuator": "servo",
        "amplitude": 30.0,
        "action_range": 180.0,
    }
    remote, local = RemoteOctoArm(quiet_server.address, **arguments), OctoArmEnv(**arguments)
    remote.reset(seed=0)
    local.reset(seed=0)
    for index in range(2000):
        action = np.full(2, 1.0 if index // 10 % 2 else -1.0)
        before = local._core.save()
        if local.step(action)[2]:
            break
    outcomes = set()
    for moment in breaks(KeyboardInterrupt):
        remote._core.load(before)
        with moment:
            remote.step(action)
        try:
            # It was not made, and ends the episode now.
            assert remote.step(action)[2]
            outcomes.add("not made")
        except ConnectionError:
            outcomes.add("unknown")
            remote.reset()
        except ValueError:
            outcomes.add("made")
            with pytest.raises(ValueError, match="call reset first"):
                remote.step(action)
    assert outcomes == {"not made", "unknown", "made"}
    remote.close()


def test_an_interrupt_while_it_is_made(quiet_server: ServerProcess) -> None:
    address = quiet_server.address
    with nothing_of_this_process_left(quiet_server):
        for moment in breaks(KeyboardInterrupt):
            env = None
            with moment:
                env = RemoteOctoArm(address)
            if env is not None:
                env.close()
        for milliseconds in range(1, 40, 4):
            env = interrupted(
                1e-3 * milliseconds,
                KeyboardInterrupt,
                lambda: gym.make("OctoArmRemote-v0", address=address),
            )
            if env is not None:
                env.close()


def test_an_interrupt_that_takes_a_lock_with_it(quiet_server: ServerProcess) -> None:
    """A lock that is taken, but not yet in its block, stays locked: no thread may wait for it."""

    def trace(frame: FrameType, event: str, argument: Any) -> Any:
        code = frame.f_code
        if code.co_filename == threading.__file__ and code.co_name == "__enter__":
            if event == "return":
                raise KeyboardInterrupt
            return trace
        return trace if code.co_filename == threading.__file__ else None

    before = sys.gettrace()
    with nothing_of_this_process_left(quiet_server):
        sys.settrace(trace)
        try:
            env = RemoteOctoArm(quiet_server.address)
        except KeyboardInterrupt:
            env = None
        finally:
            sys.settrace(before)
        if env is not None:
            env.close()


def test_an_interrupt_while_it_is_closed(quiet_server: ServerProcess) -> None:
    with nothing_of_this_process_left(quiet_server):
        for moment in breaks(KeyboardInterrupt):
            env = RemoteOctoArm(quiet_server.address)
            with moment:
                env.close()
            del env
        for microseconds in range(20, 1000, 100):
            env = RemoteOctoArm(quiet_server.address)
            interrupted(1e-6 * microseconds, KeyboardInterrupt, env.close)
            del env


def test_a_closed_environment_stays_closed(pair: Pair) -> None:
    with Break(20, KeyboardInterrupt):
        pair.remote.step(INTERRUPTED)
    pair.remote.close()
    for call in (step, reset):
        with pytest.raises(ConnectionError, match="closed"):
            call(pair.remote)


def test_a_stream_that_broke_comes_back_with_reset() -> None:
    with ServerProcess() as server:
        _, _, port = server.address.rpartition(":")
        env = RemoteOctoArm(server.address)
        env.reset(seed=1)
        server.stop()
        with pytest.raises(ConnectionError, match="is broken"):
            env.step(NEXT)
        with pytest.raises(ConnectionError, match=r"is broken.*reset\(\) connects anew"):
            env.step(NEXT)
    with ServerProcess("--port", port):
        local = OctoArmEnv()
        assert_same(env.reset(seed=2), local.reset(seed=2))
        assert_same(env.step(NEXT), local.step(NEXT))
        env.close()


def test_without_a_seed_np_random_seeds_the_new_world(pair: Pair) -> None:
    phases = []
    for _ in range(2):
        pair.remote.reset(seed=3)
        with Break(20, KeyboardInterrupt):
            pair.remote.step(INTERRUPTED)
        phases.append(pair.remote.reset()[0].tobytes())
    assert phases[0] == phases[1]


def test_a_handler_that_steps_the_environment_itself(pair: Pair) -> None:
    class Handler(Break):
        def _trace(self, frame: FrameType, event: str, argument: Any) -> Any:
            try:
                return super()._trace(frame, event, argument)
            except KeyboardInterrupt:
                sys.settrace(None)
                try:
                    self.found = pair.remote.step(INTERRUPTED)
                except ConnectionError:
                    self.found = None
                return None

    moment, late = 0, False
    while not late:
        with Handler(moment, KeyboardInterrupt) as handler:
            try:
                found = pair.remote.step(NEXT)
            except ConnectionError:
                found = None
        late = handler.late
        if found is not None and not late:
            # The handler's step was refused, or made before this one, or after it.
            twins = [copy.deepcopy(pair.local) for _ in range(3)]
            first = (twins[0].step(INTERRUPTED), twins[0].step(NEXT))
            last = tuple(reversed((twins[1].step(NEXT), twins[1].step(INTERRUPTED))))
            refused = (None, twins[2].step(NEXT))
            assert any(same((handler.found, found), pair) for pair in (refused, first, last))
        pair.begin()
        moment += 1
    assert moment > 5


def test_threads_get_their_own_answers(pair: Pair) -> None:
    def work(sign: float) -> None:
        rng = np.random.default_rng(int(2 + sign))
        for _ in range(100):
            action = sign * rng.uniform(0.01, 1.0, 2)
            found.append((action, pair.remote.step(action)))

    found: list[tuple[np.ndarray, Any]] = []
    threads = [threading.Thread(target=work, args=(sign,)) for sign in (-1.0, 1.0)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 200
    # The target tells the time, and with it the order in which the steps were made.
    clock = copy.deepcopy(pair.local)
    ticks = {clock.step(np.zeros(2))[4]["target"].tobytes(): tick for tick in range(200)}
    found.sort(key=lambda pair: ticks[pair[1][4]["target"].tobytes()])
    for action, result in found:
        assert_same(result, pair.local.step(action))
