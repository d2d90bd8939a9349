"""What the benchmark times: the arm alone and in batches, the environments, and their peers."""

from __future__ import annotations

import functools
import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv

from octoarm_agents.benchmark.mujoco_twin import MujocoTwin
from octoarm_agents.benchmark.programs import PRODUCT, matrix_product, node, web_module
from octoarm_agents.benchmark.turns import Contender, fitted, has_mujoco, timed
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
from octoarm_env.arrays import Float
from octoarm_env.reach import OctoArmReachVectorEnv

FIGURE = "microseconds_per_arm_step"
TIMESTEP = 0.001
CONTROL_PERIOD = 0.01
PHYSICS_STEPS = round(CONTROL_PERIOD / TIMESTEP)
EPISODE_STEPS = 500
RUN_STEPS = 20_000

BATCH = 64
"""Arms of the batch that is compared with others."""

BODIES = 16
VARIED: dict[str, Any] = {"vary": {"longitudinal_stiffness": (0.8, 1.2)}, "bodies": BODIES}
"""Bodies that resets choose from."""

BATCH_SIZES = (1, 8, BATCH, 1024)
SYNC_ENVS = BATCH
ASYNC_ENVS = 16

LANES = 8
"""Arms that share the lanes of vector instructions; more than these can share threads too."""

_AMPLITUDE = 20.0
"""Degrees."""

ARM = "one arm"
ARM_SERVO = "one arm, servo base"
ARM_DRY = "one arm, no water, no volume forces"
ARM_STEP = "one arm, Arm.step from Python"
TWIN = "MuJoCo twin of that dry arm"
ENV_BARE = "OctoArmEnv.step"
ENV_MADE = 'gym.make("OctoArm-v0").step'
RESETS = f"reset of {BATCH} environments onto one body, 1 thread"
RESETS_OWN = f"reset of {BATCH} environments of {BODIES} bodies, each onto its own, 1 thread"
RESETS_ANY = f"reset of {BATCH} environments onto any of {BODIES} bodies, 1 thread"
REACH = f"OctoArmReachVectorEnv of {BATCH}, 1 thread"
SYNC = f"gymnasium's SyncVectorEnv of {SYNC_ENVS}"
ASYNC = f"gymnasium's AsyncVectorEnv of {ASYNC_ENVS}"
WEB = "one arm, WebAssembly in Node.js"
HALVES = f"two OctoArmVectorEnv of {BATCH // 2} that know nothing of each other, a thread each"
LIMIT = "the multiplications of a step alone, as NumPy multiplies matrices"

MULTIPLICATIONS = 43_956
"""Of an arm's step in lanes, fused or not: rust/arm/benches/count_operations.py counts them."""


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


def other_instruction_sets() -> list[str]:
    """The vector instructions below the ones in use."""
    names = ["baseline", "avx2", "avx512"]
    return names[: names.index(instruction_set())][::-1]


def make_contenders() -> list[Contender]:
    """All of them; MuJoCo's twin only where it is installed."""
    signal, dry = _signal(), dry_body()
    counts = sorted({1, min(2, os.cpu_count() or 1)})
    contenders = [
        _arm_run(ARM, Arm(), signal),
        _arm_run(ARM_SERVO, Arm(actuator="servo"), signal),
        _arm_run(ARM_DRY, Arm(dry), signal),
        _arm_step(ARM_STEP, Arm(), signal),
        _batch(dry, BATCH, signal),
        *map(_elsewhere, other_instruction_sets()),
    ]
    sizes = [(size, n) for size in BATCH_SIZES for n in (counts if size > LANES else [1])]
    contenders += [_batch(ArmParameters(), arms, signal, threads) for arms, threads in sizes]
    settings: dict[str, Any] = {"control_period": CONTROL_PERIOD}
    contenders.append(_environment(ENV_BARE, OctoArmEnv(**settings)))
    contenders.append(_environment(ENV_MADE, gym.make("OctoArm-v0", **settings)))
    mode: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP}
    for envs, threads in sizes:
        native = OctoArmVectorEnv(envs, **settings, **mode, threads=threads)
        contenders.append(_vector_environment(vector_name(envs, threads), native))
    if len(counts) > 1:
        halves = [OctoArmVectorEnv(BATCH // 2, **settings, **mode, threads=1) for _ in counts]
        contenders.append(_side_by_side(halves))
    drawn = OctoArmVectorEnv(BATCH, **VARIED, threads=1)
    bodies = drawn.settings[0].drawn_bodies
    own = [bodies[index % BODIES] for index in range(BATCH)]
    contenders += [
        _resets(RESETS, OctoArmVectorEnv(BATCH, threads=1)),
        _resets(RESETS_OWN, OctoArmVectorEnv(BATCH, arm=own, threads=1)),
        _resets(RESETS_ANY, drawn),
    ]
    contenders.append(_reaching())
    # With its module, for processes that begin without what this one has imported.
    make = [lambda: gym.make("octoarm_env:OctoArm-v0", **settings)]
    contenders += [
        _vector_environment(SYNC, SyncVectorEnv(make * SYNC_ENVS, **mode)),
        _vector_environment(ASYNC, AsyncVectorEnv(make * ASYNC_ENVS, **mode)),
    ]
    contenders.append(_limit())
    if node() is not None:
        module = web_module()
        contenders.append(_contender(WEB, lambda: None, module.run, RUN_STEPS, close=module.close))
    if has_mujoco():
        twin, prepare = ringing_twin()
        contenders.append(_contender(TWIN, prepare, twin.step, RUN_STEPS))
    return contenders


def dry_body() -> ArmParameters:
    """The body that the base carries along, without water and volume forces: the twin's."""
    return ArmParameters.preset("inertial").replace(
        water_density=0.0,
        arm_density=0.0,
        longitudinal_volume_gain=0.0,
        transverse_volume_gain=0.0,
    )


def _contender(
    name: str,
    prepare: Callable[[], Any],
    run: Callable[[int], Any],
    limit: int,
    *,
    arms: int = 1,
    physics_steps: int = 1,
    close: Callable[[], Any] = lambda: None,
) -> Contender:
    """What makes so many steps of so many arms, each of so many physics steps."""
    measure = fitted(FIGURE, 1e6 / (arms * physics_steps), timed(prepare, run), limit)
    rates = {"times_real_time": 1e6 * TIMESTEP}
    if physics_steps > 1:
        rates["environment_steps_per_second"] = 1e6 / physics_steps
    return Contender(name, measure, rates, close)


def _limit() -> Contender:
    """The processor's own limit: how long the multiplications of an arm's step take at the least.

    A matrix product is nothing but fused multiply-adds, and libraries come close to the
    processor's most.
    """
    product = matrix_product()
    scale = 1e6 * MULTIPLICATIONS / PRODUCT**3
    measure = fitted(FIGURE, scale, timed(lambda: None, product.run), 100_000)
    return Contender(LIMIT, measure, {}, product.close)


def _signal() -> Float:
    return LIMIT_CYCLES["quadratic"].signal(RUN_STEPS, _AMPLITUDE)


def _arm_run(name: str, arm: Arm, signal: Float) -> Contender:
    return _contender(name, arm.reset, lambda steps: arm.run(signal[:steps]), RUN_STEPS)


def _arm_step(name: str, arm: Arm, signal: Float) -> Contender:
    angles = signal.tolist()

    def run(steps: int) -> None:
        for theta, phi in angles[:steps]:
            arm.step(theta, phi)

    return _contender(name, arm.reset, run, RUN_STEPS)


def _batch(parameters: ArmParameters, arms: int, signal: Float, threads: int = 1) -> Contender:
    """So many arms of one body, each a little ahead of the one before on the same signal."""
    made = ArmBatch([Arm(parameters)] * arms, threads=threads)
    states = made.states
    # As many lengths as an environment sees. A megabyte or two of them a call, if that are steps
    # enough: more is paid for in fresh pages of memory, not in physics.
    block = max(PHYSICS_STEPS, 32_000 // arms)

    def restore() -> None:
        made.states = states

    def run(steps: int) -> None:
        for begin in range(0, steps, block):
            made.run(signal[begin : min(begin + block, steps)], stride=PHYSICS_STEPS)

    name = batch_name(arms, threads, dry=parameters.water_density == 0.0)
    return _contender(name, restore, run, RUN_STEPS, arms=arms)


def ringing_twin() -> tuple[MujocoTwin, Callable[[], None]]:
    """The twin, and what lets its springs ring after a pull; its time does not depend on that."""
    twin = MujocoTwin(dry_body())
    coordinates, rates, base = twin.state
    coordinates[:, 1:3] += 0.02
    return twin, functools.partial(twin.set_state, coordinates, rates, base)


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
    return _contender(
        name,
        functools.partial(env.reset, options=options),
        walk(env.step, actions),
        EPISODE_STEPS,
        physics_steps=PHYSICS_STEPS,
    )


def walk(step: Callable[[Any], Any], actions: Any) -> Callable[[int], None]:
    """Give what makes so many steps, over and over with the same actions."""

    def run(steps: int) -> None:
        for index in range(steps):
            step(actions[index % len(actions)])

    return run


def _vector_environment(name: str, envs: VectorEnv[Any, Any, Any]) -> Contender:
    """A vector environment under random actions, with the ends of episodes as they come."""
    return _contender(
        name,
        lambda: None,
        _random_walk(envs),
        100_000,
        arms=envs.num_envs,
        physics_steps=PHYSICS_STEPS,
        close=envs.close,
    )


def _random_walk(envs: VectorEnv[Any, Any, Any]) -> Callable[[int], None]:
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (EPISODE_STEPS, envs.num_envs, 2)).astype(np.float32)
    envs.reset(seed=0)
    return walk(envs.step, actions)


def _side_by_side(envs: list[OctoArmVectorEnv]) -> Contender:
    """What two threads can do here at the most: batches that never wait for each other."""
    pool = ThreadPoolExecutor(len(envs))
    walks = [_random_walk(each) for each in envs]

    def run(steps: int) -> None:
        for done in [pool.submit(each, steps) for each in walks]:
            done.result()

    def close() -> None:
        pool.shutdown()
        for each in envs:
            each.close()

    return _contender(
        HALVES, lambda: None, run, 100_000, arms=BATCH, physics_steps=PHYSICS_STEPS, close=close
    )


def _resets(name: str, envs: OctoArmVectorEnv) -> Contender:
    """Resets of a batch; a step is a reset."""
    envs.reset(seed=0)

    def run(steps: int) -> None:
        for _ in range(steps):
            envs.reset()

    measure = fitted(FIGURE, 1e6 / BATCH, timed(lambda: None, run), 100_000)
    return Contender(name, measure, {}, envs.close)


def _reaching() -> Contender:
    """Arms under random activations of their muscles, with the ends of episodes as they come."""
    envs = OctoArmReachVectorEnv(BATCH, autoreset_mode=AutoresetMode.SAME_STEP, threads=1)
    rng = np.random.default_rng(0)
    actions = rng.random((EPISODE_STEPS, BATCH, 25), np.float32)
    envs.reset(seed=0)
    return _contender(
        REACH,
        lambda: None,
        walk(envs.step, actions),
        100_000,
        arms=BATCH,
        physics_steps=round(envs.settings.control_period / TIMESTEP),
        close=envs.close,
    )


def _elsewhere(instructions: str) -> Contender:
    """The dry batch in a process that uses other vector instructions: a process chooses once."""
    pool = ProcessPoolExecutor(
        1,
        multiprocessing.get_context("spawn"),
        initializer=os.putenv,
        initargs=("OCTOARM_INSTRUCTION_SET", instructions),
    )
    return Contender(
        elsewhere_name(instructions),
        lambda seconds: pool.submit(_measure_dry_batch, seconds).result(),
        {"times_real_time": 1e6 * TIMESTEP},
        pool.shutdown,
    )


def _measure_dry_batch(seconds: float) -> dict[str, float]:
    return _dry_batch().measure(seconds)


@functools.cache
def _dry_batch() -> Contender:
    return _batch(dry_body(), BATCH, _signal())
