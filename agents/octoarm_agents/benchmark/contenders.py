"""What the benchmark times: the arm alone and in batches, the environments, and their peers."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv
from numpy.typing import NDArray

from octoarm_agents.benchmark.mujoco_twin import MujocoTwin
from octoarm_env import (
    LIMIT_CYCLES,
    Arm,
    ArmBatch,
    ArmParameters,
    OctoArmEnv,
    OctoArmVectorEnv,
    TeacherPolicy,
    instruction_set,
)

__all__ = [
    "ARM",
    "ARM_DRY",
    "ARM_SERVO",
    "ARM_STEP",
    "ASYNC",
    "ENV_BARE",
    "ENV_MADE",
    "SYNC",
    "TWIN",
    "Contender",
    "batch",
    "batch_name",
    "dry_body",
    "elsewhere_name",
    "has_mujoco",
    "make_contenders",
    "other_instruction_sets",
    "vector_name",
]

Float = NDArray[np.float64]

TIMESTEP = 0.001
CONTROL_PERIOD = 0.01
PHYSICS_STEPS = round(CONTROL_PERIOD / TIMESTEP)
EPISODE_STEPS = 500

BATCH = 64
"""Arms of the batch that is compared with others."""

BATCH_SIZES = (1, 8, BATCH, 1024)
SYNC_ENVS = BATCH
ASYNC_ENVS = 16

_AMPLITUDE = 20.0
"""Degrees; the environment's own default target."""

ARM = "one arm"
ARM_SERVO = "one arm, servo base"
ARM_DRY = "one arm, no water, no volume forces"
ARM_STEP = "one arm, Arm.step from Python"
TWIN = "MuJoCo twin of that dry arm"
ENV_BARE = "OctoArmEnv.step"
ENV_MADE = 'gym.make("OctoArm-v0").step'
SYNC = f"gymnasium's SyncVectorEnv of {SYNC_ENVS}"
ASYNC = f"gymnasium's AsyncVectorEnv of {ASYNC_ENVS}"


def batch_name(arms: int, threads: int, *, dry: bool = False) -> str:
    """Name of a batch of arms."""
    return f"ArmBatch of {arms}{_on(threads)}{', no water' if dry else ''}"


def vector_name(envs: int, threads: int) -> str:
    """Name of a native vector environment."""
    return f"OctoArmVectorEnv of {envs}{_on(threads)}"


def elsewhere_name(instructions: str) -> str:
    """Name of the dry batch of `BATCH` arms on other vector instructions."""
    return f"{batch_name(BATCH, 1, dry=True)}, {instructions}"


def _on(threads: int) -> str:
    return ", 1 thread" if threads == 1 else f", {threads} threads"


@dataclass(frozen=True)
class Contender:
    """Something to be timed.

    Attributes:
        name: its row in the table.
        prepare: called before every slice, not timed.
        run: make this many steps.
        limit: most steps in a slice without a new `prepare`.
        arms: arms that a step moves.
        physics_steps: time steps of each that a step makes.
        timestep: of the physics [s].
        close: called when it is not needed any more.
    """

    name: str
    prepare: Callable[[], Any]
    run: Callable[[int], Any]
    limit: int
    arms: int = 1
    physics_steps: int = 1
    timestep: float = TIMESTEP
    close: Callable[[], Any] = lambda: None

    @property
    def arm_steps(self) -> int:
        """Physics steps of an arm in one step."""
        return self.arms * self.physics_steps


def has_mujoco() -> bool:
    """Whether MuJoCo is installed."""
    return importlib.util.find_spec("mujoco") is not None


def other_instruction_sets() -> list[str]:
    """The vector instructions below the ones in use."""
    names = ["baseline", "avx2", "avx512"]
    return names[: names.index(instruction_set())][::-1]


def make_contenders() -> list[Contender]:
    """All of them; MuJoCo's twin only where it is installed."""
    limit = 20_000
    signal = LIMIT_CYCLES["quadratic"].signal(limit, _AMPLITUDE)
    dry = dry_body()
    threads = sorted({1, min(2, os.cpu_count() or 1)})
    contenders = [
        _arm_run(ARM, Arm(), signal),
        _arm_run(ARM_SERVO, Arm(actuator="servo"), signal),
        _arm_run(ARM_DRY, Arm(dry), signal),
        _arm_step(ARM_STEP, Arm(), signal),
        batch(dry, BATCH, signal),
    ]
    contenders += [_elsewhere(name) for name in other_instruction_sets()]
    for arms in BATCH_SIZES:
        for count in threads if arms > LANES else [1]:
            contenders.append(batch(ArmParameters(), arms, signal, count))
    contenders.append(_environment(ENV_BARE, OctoArmEnv(control_period=CONTROL_PERIOD)))
    made = gym.make("OctoArm-v0", control_period=CONTROL_PERIOD)
    contenders.append(_environment(ENV_MADE, made))
    for envs in BATCH_SIZES:
        for count in threads if envs > LANES else [1]:
            native = OctoArmVectorEnv(
                envs,
                control_period=CONTROL_PERIOD,
                autoreset_mode=AutoresetMode.SAME_STEP,
                threads=count,
            )
            contenders.append(_vector_environment(vector_name(envs, count), native))
    for name, kind, count in (
        (SYNC, SyncVectorEnv, SYNC_ENVS),
        (ASYNC, AsyncVectorEnv, ASYNC_ENVS),
    ):
        # With its module, for processes that begin without what this one has imported.
        make = [lambda: gym.make("octoarm_env:OctoArm-v0", control_period=CONTROL_PERIOD)] * count
        loop = kind(make, autoreset_mode=AutoresetMode.SAME_STEP)
        contenders.append(_vector_environment(name, loop))
    if has_mujoco():
        contenders.append(_twin(dry))
    return contenders


LANES = 8
"""Arms that share the lanes of vector instructions; more than these can share threads too."""


def dry_body() -> ArmParameters:
    """The body that the base carries along, without water and volume forces: the twin's."""
    return ArmParameters.preset("inertial").replace(
        water_density=0.0,
        arm_density=0.0,
        longitudinal_volume_gain=0.0,
        transverse_volume_gain=0.0,
    )


def _arm_run(name: str, arm: Arm, signal: Float) -> Contender:
    return Contender(name, arm.reset, lambda steps: arm.run(signal[:steps]), len(signal))


def _arm_step(name: str, arm: Arm, signal: Float) -> Contender:
    angles = signal.tolist()

    def run(steps: int) -> None:
        for theta, phi in angles[:steps]:
            arm.step(theta, phi)

    return Contender(name, arm.reset, run, len(angles))


def batch(parameters: ArmParameters, arms: int, signal: Float, threads: int = 1) -> Contender:
    """So many arms of one body, each a little ahead of the one before on the same signal."""
    made = ArmBatch([Arm(parameters)] * arms, threads=threads)
    states = made.states
    dry = parameters.water_density == 0.0
    # As many lengths as an environment sees. A megabyte or two of them a call, if that are steps
    # enough: more is paid for in fresh pages of memory, not in physics.
    block = max(PHYSICS_STEPS, 32_000 // arms)

    def restore() -> None:
        made.states = states

    def run(steps: int) -> None:
        for begin in range(0, steps, block):
            made.run(signal[begin : min(begin + block, steps)], stride=PHYSICS_STEPS)

    name = batch_name(arms, threads, dry=dry)
    return Contender(name, restore, run, len(signal), arms=arms)


def _twin(parameters: ArmParameters) -> Contender:
    """The twin, its springs ringing after a pull; what it does has no influence on its time."""
    twin = MujocoTwin(parameters)
    coordinates, rates, base = twin.state
    coordinates[:, 1:3] += 0.02

    def prepare() -> None:
        twin.set_state(coordinates, rates, base)

    return Contender(TWIN, prepare, twin.step, 20_000)


def _environment(name: str, env: gym.Env[Any, Any]) -> Contender:
    """An environment under the actions of its teacher, which are computed beforehand."""
    options = {"phase": 0.0}
    teacher = TeacherPolicy(env)
    observation, _ = env.reset(seed=0, options=options)
    actions = []
    for _ in range(EPISODE_STEPS):
        action, _ = teacher.predict(observation)
        actions.append(action)
        observation, _, terminated, _, _ = env.step(action)
        if terminated:
            raise RuntimeError(f"the teacher's episode of {name} ended after {len(actions)} steps")

    def run(steps: int) -> None:
        step = env.step
        for action in actions[:steps]:
            step(action)

    def prepare() -> None:
        env.reset(options=options)

    return Contender(name, prepare, run, EPISODE_STEPS, physics_steps=PHYSICS_STEPS)


def _vector_environment(name: str, envs: VectorEnv[Any, Any, Any]) -> Contender:
    """A vector environment under random actions, with the ends of episodes as they come."""
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (EPISODE_STEPS, envs.num_envs, 2)).astype(np.float32)
    envs.reset(seed=0)

    def run(steps: int) -> None:
        step = envs.step
        for index in range(steps):
            step(actions[index % EPISODE_STEPS])

    return Contender(
        name,
        lambda: None,
        run,
        100_000,
        arms=envs.num_envs,
        physics_steps=PHYSICS_STEPS,
        close=envs.close,
    )


def _elsewhere(instructions: str) -> Contender:
    """The dry batch in a process that uses other vector instructions."""
    process = subprocess.Popen(
        [sys.executable, "-m", "octoarm_agents.benchmark.elsewhere"],
        env=os.environ | {"OCTOARM_INSTRUCTION_SET": instructions},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        bufsize=1,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    ask, answers = process.stdin, process.stdout

    def tell(word: str) -> None:
        ask.write(word + "\n")
        if answers.readline().strip() != "done":
            raise RuntimeError(f"the process that computes with {instructions} has failed")

    def close() -> None:
        # Not the end of its input: processes forked meanwhile hold that open.
        tell("end")
        process.communicate()

    return Contender(
        elsewhere_name(instructions),
        lambda: tell("prepare"),
        lambda steps: tell(str(steps)),
        20_000,
        arms=BATCH,
        close=close,
    )
