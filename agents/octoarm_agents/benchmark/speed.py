"""How long a step takes: the arm, its MuJoCo twin, the environment.

On a shared machine absolute times drift by tens of per cent within seconds. So the contenders take
turns, a short slice each, round after round; every ratio is formed within a round, and medians over
the rounds are reported with their extremes.
"""

from __future__ import annotations

import gc
import importlib.util
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from octoarm_agents.benchmark.mujoco_twin import MujocoTwin
from octoarm_agents.machine import describe_machine, package_versions
from octoarm_env import LIMIT_CYCLES, Arm, ArmParameters, OctoArmEnv, TeacherPolicy

__all__ = ["SpeedResult", "Spread", "has_mujoco", "measure_speed"]

Float = NDArray[np.float64]

CONTROL_PERIOD = 0.01
EPISODE_STEPS = 500
OVERHEAD_TARGET = 10.0
"""Microseconds of an `OctoArmEnv.step` that may go to anything but the physics."""

_AMPLITUDE = 20.0
"""Degrees; the environment's own default target."""

ARM_RUN = "Arm.run, default body in water"
ARM_RUN_SERVO = "Arm.run, the same with servo base"
ARM_RUN_DRY = "Arm.run, no water, no volume forces"
ARM_STEP = "Arm.step from Python, default body"
TWIN = "MuJoCo twin, no water, no volume forces"
ENV_BARE = "OctoArmEnv.step (10 physics steps)"
ENV_MADE = 'gym.make("OctoArm-v0").step (10 physics steps)'


@dataclass(frozen=True)
class Spread:
    """Minimum, median and maximum over rounds."""

    minimum: float
    median: float
    maximum: float

    @classmethod
    def of(cls, values: list[float]) -> Spread:
        """The spread of at least one value."""
        return cls(min(values), statistics.median(values), max(values))

    def to_dict(self) -> dict[str, float]:
        """As plain numbers."""
        return {"min": self.minimum, "median": self.median, "max": self.maximum}


@dataclass(frozen=True)
class Contender:
    """Something to be timed.

    Attributes:
        name: its row in the table.
        prepare: called before every slice, not timed.
        run: make this many steps.
        limit: most steps in a slice without a new `prepare`.
    """

    name: str
    prepare: Callable[[], Any]
    run: Callable[[int], Any]
    limit: int


@dataclass
class SpeedResult:
    """Microseconds a step of every contender, by round.

    Attributes:
        rounds: number of rounds.
        steps: steps in one slice, by contender.
        microseconds: a step's time in each round, by contender.
        physics_steps: physics steps in a step of the environment.
    """

    rounds: int
    steps: dict[str, int]
    microseconds: dict[str, list[float]] = field(default_factory=dict)
    physics_steps: int = round(CONTROL_PERIOD / 0.001)

    @property
    def spreads(self) -> dict[str, Spread]:
        """Spread of every contender's microseconds a step."""
        return {name: Spread.of(values) for name, values in self.microseconds.items()}

    @property
    def twin_over_arm(self) -> Spread | None:
        """Time of the twin's step over the arm's with the same physics; None without MuJoCo."""
        return self._ratio(TWIN, ARM_RUN_DRY)

    @property
    def twin_over_wet_arm(self) -> Spread | None:
        """Time of the twin's step over the arm's that computes water and volume forces too."""
        return self._ratio(TWIN, ARM_RUN)

    def overhead(self, name: str) -> Spread:
        """Microseconds of an environment's step beyond its physics steps with a servo base."""
        physics = self.microseconds[ARM_RUN_SERVO]
        pairs = zip(self.microseconds[name], physics, strict=True)
        return Spread.of([step - self.physics_steps * inner for step, inner in pairs])

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain numbers for a JSON file; units in the keys."""
        ratios = {
            "mujoco_twin_over_arm_same_physics": self.twin_over_arm,
            "mujoco_twin_over_arm_default_body": self.twin_over_wet_arm,
        }
        return {
            "rounds": self.rounds,
            "microseconds_per_step": {
                name: spread.to_dict() | {"steps_per_round": self.steps[name]}
                for name, spread in self.spreads.items()
            },
            "ratios": {
                name: None if ratio is None else ratio.to_dict() for name, ratio in ratios.items()
            },
            "overhead_microseconds_per_env_step": {
                name: self.overhead(name).to_dict() for name in (ENV_BARE, ENV_MADE)
            },
            "microseconds_by_round": self.microseconds,
            "machine": describe_machine(),
            "versions": package_versions(
                "octoarm-env", "octoarm-agents", "numpy", "gymnasium", "mujoco"
            ),
        }

    def _ratio(self, slower: str, faster: str) -> Spread | None:
        if slower not in self.microseconds:
            return None
        pairs = zip(self.microseconds[slower], self.microseconds[faster], strict=True)
        return Spread.of([above / below for above, below in pairs])


def measure_speed(
    seconds: float = 10.0, rounds: int = 11, advance: Callable[[str], Any] | None = None
) -> SpeedResult:
    """Time all contenders; MuJoCo's twin only where MuJoCo is installed.

    Args:
        seconds: time for all slices together.
        rounds: slices of each contender.
        advance: called with a contender's name after each of its slices.
    """
    contenders = _contenders()
    budget = seconds / (rounds * len(contenders))
    steps = {contender.name: _fitting_steps(contender, budget) for contender in contenders}
    result = SpeedResult(rounds, steps, {contender.name: [] for contender in contenders})
    for turn in range(rounds):
        # Every round begins with another contender, so that none always follows the same one.
        for index in range(len(contenders)):
            contender = contenders[(turn + index) % len(contenders)]
            taken = _time_slice(contender, steps[contender.name])
            result.microseconds[contender.name].append(1e6 * taken / steps[contender.name])
            if advance is not None:
                advance(contender.name)
    return result


def has_mujoco() -> bool:
    """Whether MuJoCo is installed."""
    return importlib.util.find_spec("mujoco") is not None


def _fitting_steps(contender: Contender, budget: float) -> int:
    """Steps that take about `budget` seconds."""
    count = min(16, contender.limit)
    _time_slice(contender, count)  # the first slice also pays for what is made only once
    while True:
        taken = _time_slice(contender, count)
        wanted = int(count * budget / max(taken, 1e-9))
        if wanted <= 2 * count or count == contender.limit:
            return max(1, min(wanted, contender.limit))
        count = min(8 * count, wanted, contender.limit)


def _time_slice(contender: Contender, steps: int) -> float:
    """Seconds for `steps` steps from a fresh start."""
    contender.prepare()
    collecting = gc.isenabled()
    gc.disable()
    try:
        started = time.perf_counter()
        contender.run(steps)
        return time.perf_counter() - started
    finally:
        if collecting:
            gc.enable()


def _contenders() -> list[Contender]:
    limit = 20_000
    signal = LIMIT_CYCLES["quadratic"].signal(limit, _AMPLITUDE)
    # Without water nothing brakes heavy planes: they would swing themselves out of the domain.
    dry = ArmParameters(
        plane_mass=0.0,
        water_density=0.0,
        arm_density=0.0,
        longitudinal_volume_gain=0.0,
        transverse_volume_gain=0.0,
    )
    contenders = [
        _arm_run(ARM_RUN, Arm(), signal),
        _arm_run(ARM_RUN_SERVO, Arm(actuator="servo"), signal),
        _arm_run(ARM_RUN_DRY, Arm(dry), signal),
        _arm_step(ARM_STEP, Arm(), signal),
    ]
    if has_mujoco():
        contenders.append(_twin(dry))
    bare = OctoArmEnv(control_period=CONTROL_PERIOD)
    made = gym.make("OctoArm-v0", control_period=CONTROL_PERIOD)
    contenders.append(_environment(ENV_BARE, bare))
    contenders.append(_environment(ENV_MADE, made))
    return contenders


def _arm_run(name: str, arm: Arm, signal: Float) -> Contender:
    return Contender(name, arm.reset, lambda steps: arm.run(signal[:steps]), len(signal))


def _arm_step(name: str, arm: Arm, signal: Float) -> Contender:
    angles = signal.tolist()

    def run(steps: int) -> None:
        for theta, phi in angles[:steps]:
            arm.step(theta, phi)

    return Contender(name, arm.reset, run, len(angles))


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

    return Contender(name, lambda: env.reset(options=options), run, EPISODE_STEPS)
