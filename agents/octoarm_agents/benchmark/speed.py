"""How long a step takes: arm, batch, environments, and their peers, in one run.

On a shared machine absolute times drift by tens of per cent within seconds. So the contenders take
turns, a short slice each, round after round; every ratio is formed within a round, and medians over
the rounds are reported with their extremes.
"""

from __future__ import annotations

import gc
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from octoarm_agents.benchmark.contenders import (
    ARM,
    ARM_DRY,
    ARM_SERVO,
    ASYNC,
    BATCH,
    ENV_BARE,
    ENV_MADE,
    PHYSICS_STEPS,
    SYNC,
    TWIN,
    Contender,
    batch_name,
    elsewhere_name,
    make_contenders,
    other_instruction_sets,
    vector_name,
)
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.whole import whole_number
from octoarm_env import OctoArmVectorEnv, instruction_set

__all__ = ["Ratio", "SpeedResult", "Spread", "measure_speed", "take_turns", "time_slice"]

MEMORY_ENVS = 4096


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
class Ratio:
    """One contender compared with another, round by round.

    Attributes:
        key: its name in a file.
        label: its row in the table.
        spread: of the values.
        unit: of the values, "×", "%", "µs" or "a second".
    """

    key: str
    label: str
    spread: Spread
    unit: str = "×"


@dataclass
class SpeedResult:
    """Microseconds of an arm's physics step for every contender, by round.

    Attributes:
        rounds: number of rounds.
        contenders: what was timed, by name.
        steps: steps in one slice, by name.
        microseconds: time of a step over all arms and physics steps in it, in each round, by name.
        memory: bytes a sub-environment of a native vector environment of 4096 takes; None where the
            system does not tell.
    """

    rounds: int
    contenders: dict[str, Contender]
    steps: dict[str, int]
    microseconds: dict[str, list[float]] = field(default_factory=dict)
    memory: float | None = None

    @property
    def spreads(self) -> dict[str, Spread]:
        """Spread of every contender's microseconds an arm's step."""
        return {name: Spread.of(values) for name, values in self.microseconds.items()}

    def real_time(self, name: str) -> float:
        """Simulated seconds, of all arms together, in a second of computing; the median."""
        return 1e6 * self.contenders[name].timestep / self.spreads[name].median

    def ratios(self) -> list[Ratio]:
        """All comparisons of which both sides were measured."""
        threads = 2 if batch_name(BATCH, 2) in self.microseconds else 1
        batch, vector = batch_name(BATCH, threads), vector_name(BATCH, threads)
        alone = vector_name(BATCH, 1)
        dry = batch_name(BATCH, 1, dry=True)
        wanted = [
            ("twin_over_arm", "MuJoCo twin / one arm, same physics", TWIN, ARM_DRY),
            ("twin_over_wet_arm", "MuJoCo twin / one arm in water", TWIN, ARM),
            (
                f"twin_over_batch_{instruction_set()}",
                f"MuJoCo twin / batch of {BATCH}, {instruction_set()}",
                TWIN,
                dry,
            ),
        ]
        wanted += [
            (f"twin_over_batch_{name}", f"MuJoCo twin / batch of {BATCH}, {name}", TWIN, other)
            for name in other_instruction_sets()
            for other in [elsewhere_name(name)]
        ]
        wanted += [
            ("arm_over_batch", f"one arm / batch of {BATCH}", ARM_DRY, dry),
            ("batch_threads", f"ArmBatch of {BATCH}: 1 / 2 threads", batch_name(BATCH, 1), batch),
            ("vector_threads", f"OctoArmVectorEnv of {BATCH}: 1 / 2 threads", alone, vector),
            ("sync_over_vector", f"SyncVectorEnv / {vector}", SYNC, vector),
            (
                "sync_over_vector_1",
                "SyncVectorEnv / the same, 1 thread",
                SYNC,
                vector_name(BATCH, 1),
            ),
            ("async_over_vector", f"AsyncVectorEnv / {vector}", ASYNC, vector),
        ]
        ratios = [
            Ratio(key, label, self._divided(slow, fast))
            for key, label, slow, fast in wanted
            if slow in self.microseconds and fast in self.microseconds and slow != fast
        ]
        for count in sorted({1, threads}):
            name, own = vector_name(BATCH, count), batch_name(BATCH, count)
            if not {name, own} <= set(self.microseconds):
                continue
            rate = Spread.of([1e6 / PHYSICS_STEPS / each for each in self.microseconds[name]])
            label = f"{name}: steps of an environment"
            ratios.append(Ratio(f"env_steps_{count}_threads", label, rate, "a second"))
            share = Spread(*(100 * each for each in self._divided(own, name).to_dict().values()))
            label = f"{name}: speed over the bare batch's"
            ratios.append(Ratio(f"vector_share_{count}_threads", label, share, "%"))
        for key, name in (("bare", ENV_BARE), ("made", ENV_MADE)):
            if {name, ARM_SERVO} <= set(self.microseconds):
                label = f"{name} beyond its {PHYSICS_STEPS} physics steps"
                ratios.append(Ratio(f"overhead_{key}", label, self.overhead(name), "µs"))
        return ratios

    def overhead(self, name: str) -> Spread:
        """Microseconds of an environment's step beyond its physics steps with a servo base."""
        pairs = zip(self.microseconds[name], self.microseconds[ARM_SERVO], strict=True)
        return Spread.of([PHYSICS_STEPS * (step - inner) for step, inner in pairs])

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain numbers for a JSON file; units in the keys."""
        return {
            "rounds": self.rounds,
            "microseconds_per_arm_step": {
                name: spread.to_dict()
                | {
                    "arms": self.contenders[name].arms,
                    "physics_steps": self.contenders[name].physics_steps,
                    "timestep_seconds": self.contenders[name].timestep,
                    "steps_per_round": self.steps[name],
                    "simulated_seconds_per_second": self.real_time(name),
                }
                for name, spread in self.spreads.items()
            },
            "ratios": {
                ratio.key: ratio.spread.to_dict() | {"label": ratio.label, "unit": ratio.unit}
                for ratio in self.ratios()
            },
            "bytes_per_vector_sub_environment": self.memory,
            "microseconds_by_round": self.microseconds,
            "machine": describe_machine(),
            "versions": package_versions(
                "octoarm-env", "octoarm-agents", "numpy", "gymnasium", "mujoco"
            ),
        }

    def _divided(self, above: str, below: str) -> Spread:
        pairs = zip(self.microseconds[above], self.microseconds[below], strict=True)
        return Spread.of([one / other for one, other in pairs])


def measure_speed(
    seconds: float = 30.0, rounds: int = 11, advance: Callable[[str, int], Any] | None = None
) -> SpeedResult:
    """Time all contenders; peers only where they are installed.

    Args:
        seconds: time for all slices together; making the contenders comes on top.
        rounds: slices of each contender.
        advance: called with a contender's name and the number of slices in all, after each slice.
    """
    memory = _memory_per_environment()
    contenders = {contender.name: contender for contender in make_contenders()}
    try:
        slices = {name: partial(time_slice, each) for name, each in contenders.items()}
        limits = {name: each.limit for name, each in contenders.items()}
        steps, times = take_turns(slices, limits, seconds, rounds, advance)
    finally:
        for contender in contenders.values():
            contender.close()
    microseconds = {
        name: [1e6 * each / contenders[name].arm_steps for each in values]
        for name, values in times.items()
    }
    return SpeedResult(rounds, contenders, steps, microseconds, memory)


def take_turns(
    slices: Mapping[str, Callable[[int], float]],
    limits: Mapping[str, int],
    seconds: float,
    rounds: int,
    advance: Callable[[str, int], Any] | None = None,
) -> tuple[dict[str, int], dict[str, list[float]]]:
    """Time contenders in turns, a slice of each in every round.

    Args:
        slices: by name, what makes so many steps and gives the seconds that they took.
        limits: by name, most steps in a slice.
        seconds: time for all slices together.
        rounds: slices of each contender.
        advance: called with a contender's name and the number of slices in all, after each slice.

    Returns:
        Steps in a slice, and seconds of a step in every round, both by name.
    """
    rounds = whole_number("rounds", rounds, 1)
    names = list(slices)
    budget = seconds / (rounds * len(names))
    steps = {name: _fitting_steps(slices[name], limits[name], budget) for name in names}
    times: dict[str, list[float]] = {name: [] for name in names}
    for turn in range(rounds):
        # Every round begins with another contender, so that none always follows the same one.
        for index in range(len(names)):
            name = names[(turn + index) % len(names)]
            times[name].append(slices[name](steps[name]) / steps[name])
            if advance is not None:
                advance(name, rounds * len(names))
    return steps, times


def _fitting_steps(measure: Callable[[int], float], limit: int, budget: float) -> int:
    """Steps that take about `budget` seconds."""
    count = 1
    measure(count)  # the first slice also pays for what is made only once
    while True:
        taken = measure(count)
        wanted = int(count * budget / max(taken, 1e-9))
        if wanted <= 2 * count or count == limit:
            return max(1, min(wanted, limit))
        count = min(8 * count, wanted, limit)


def time_slice(contender: Contender, steps: int) -> float:
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


def _memory_per_environment() -> float | None:
    """Resident bytes that an environment of a large native batch adds.

    Measured in a process of its own, which has no memory left over from anything else.
    """
    if _resident_bytes() is None:
        return None
    code = f"from {__name__} import measure_memory; print(measure_memory())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return float(done.stdout)


def measure_memory() -> float:
    """Make a large native batch in this process, and give the resident bytes of an environment."""
    # The swing's snapshots, which all share, are there before.
    first = OctoArmVectorEnv(1)
    before = _resident_bytes() or 0
    envs = OctoArmVectorEnv(MEMORY_ENVS)
    envs.reset(seed=0)
    after = _resident_bytes() or 0
    first.close()
    envs.close()
    return (after - before) / MEMORY_ENVS


def _resident_bytes() -> int | None:
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")


# What the table is for: a peer is left out of it where it is not installed.
PEERS = {TWIN: "MuJoCo"}
