"""Too much memory is an error, and an interrupt is heard; neither leaves half a run."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator

import gymnasium as gym
import numpy as np
import pytest

import octoarm_env  # noqa: F401, registers the environments
from octoarm_env import LIMIT_CYCLES, Arm, ArmBatch, ArmParameters

# What each call asks for does not fit beside what the interpreter holds; its arguments do.
TOO_MUCH = [
    "Arm().run(np.zeros((1_000_000, 2)))",
    "Arm().run(np.broadcast_to(np.zeros(2), (10**12, 2)))",
    "Arm().run_closed_loop(np.zeros((80, 2)), 1_000_000)",
    "ArmBatch([Arm()] * 2).run(np.zeros((500_000, 2)))",
    "ArmBatch([Arm()] * 2).run_closed_loop(np.zeros((80, 2)), 20_000_000, stride=10_000)",
    "ArmBatch([Arm()] * 20_000)",
    "LIMIT_CYCLES['quadratic'].signal(10**8, 90.0)",
    "gym.make_vec('OctoArm-v0', num_envs=30_000)",
    "gym.make_vec('OctoArm-v0', num_envs=10**12)",
]
PROGRAM = """
import resource
import gymnasium as gym, numpy as np
from octoarm_env import LIMIT_CYCLES, Arm, ArmBatch
gym.make_vec("OctoArm-v0", num_envs=2, threads=2).reset()
pages = int(open("/proc/self/statm").read().split()[0])
limit = pages * resource.getpagesize() + 300_000_000
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
for call in CALLS:
    try:
        eval(call)
    except MemoryError as error:
        print("MemoryError:", error)
    else:
        print("it fitted:", call)
print(Arm().run(np.zeros((5, 2))).shape)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are set as on Linux")
def test_too_much_memory_is_a_memory_error() -> None:
    program = PROGRAM.replace("CALLS", repr(TOO_MUCH))
    # One arena, so that threads do not reserve address space of their own.
    env = os.environ | {"MALLOC_ARENA_MAX": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-c", program]
    run = subprocess.run(command, capture_output=True, text=True, env=env, check=False)
    assert run.returncode == 0, run.stderr
    lines = run.stdout.splitlines()
    assert len(lines) == len(TOO_MUCH) + 1
    for call, line in zip(TOO_MUCH, lines, strict=False):
        assert line.startswith("MemoryError:"), f"{call}: {line}"
    assert lines[-1] == "(5, 80)"


class Alarm(BaseException):
    pass


@pytest.fixture
def alarm() -> Iterator[Callable[[], None]]:
    """Sets off what stands for Ctrl-C, a moment from now; the alarm clock is that of the tests."""

    def ring(number: int, frame: object) -> None:
        raise Alarm

    before = signal.signal(signal.SIGUSR1, ring)
    timers = []

    def start() -> None:
        timers.append(threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGUSR1)))
        timers[-1].start()

    yield start
    for timer in timers:
        timer.cancel()
        timer.join()
    signal.signal(signal.SIGUSR1, before)


# Each of these would take far longer than the limit of time below if it were deaf.
LONG = ArmParameters(compartments=200, timestep=1e-4)
DEAF = pytest.mark.timeout(20)


@DEAF
@pytest.mark.parametrize(
    "work",
    [
        lambda: gym.make("OctoArm-v0", arm=LONG, control_period=1.0),
        lambda: gym.make_vec("OctoArm-v0", num_envs=2, arm=LONG, control_period=1.0),
        lambda: LIMIT_CYCLES["van_der_pol"].signal(10**9, 1.0),
    ],
    ids=["environment", "batch", "signal"],
)
def test_an_interrupt_is_heard_while_something_is_made(work, alarm) -> None:
    alarm()
    with pytest.raises(Alarm):
        work()


@DEAF
def test_an_interrupted_run_leaves_the_arms_as_they_were(alarm) -> None:
    body = ArmParameters(compartments=200)
    arm = Arm(body, undeformed=True)
    arm.muscles = (np.full((200, 4), 0.01), np.zeros((200, 4)))
    batch = ArmBatch([arm] * 3, threads=1)
    runs = [
        (arm, lambda: arm.run(np.zeros((400_000, 2)))),
        (arm, lambda: arm.run_closed_loop(np.zeros((800, 2)), 400_000)),
        (batch, lambda: batch.run(np.zeros((10**6, 2)), stride=10**7)),
        (batch, lambda: batch.run_closed_loop(np.zeros((800, 2)), 10**6, stride=10**7)),
    ]
    for body, run in runs:
        state = body.state if body is arm else body.states
        alarm()
        with pytest.raises(Alarm):
            run()
        assert (body.state if body is arm else body.states) == state
