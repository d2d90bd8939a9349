"""What the experiments on limit cycles share: taught cycles, and their trials under noise.

All of them keep their trials in one folder, so that a cycle is taught once for every figure.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from octoarm_agents.experiments.cycle_settings import CYCLES, TRAININGS
from octoarm_agents.experiments.runner import Context
from octoarm_agents.experiments.task2_trials import disturb_cycle, teach_cycle
from octoarm_agents.reservoir.teaching import Teaching

__all__ = [
    "FOLDER",
    "NOISE_SEEDS",
    "STEPS",
    "TRIALS",
    "TaughtCycle",
    "disturb_all",
    "fraction_recovered",
    "largest_recovered",
    "seeds_of",
    "teach_all",
    "teach_cycles",
]

FOLDER = "task2"
"""Name under which the trials are kept."""

STEPS = 1_000_000
TRIALS = 10
"""Steps of the closed loop (section 2.2.2), and seeds of the noise on the outputs; the paper shows
one run."""

NOISE_SEEDS = 5
"""Repetitions of a plain training, each with its own noise on the lengths."""


@dataclass(frozen=True)
class TaughtCycle:
    """A limit cycle, and what teaching it gave.

    Attributes:
        teaching: how it was taught.
        result: of `teach_cycle`.
    """

    teaching: Teaching
    result: Mapping[str, Any]

    @property
    def failure(self) -> dict[str, Any] | None:
        """Why the arm could not follow the teacher, None if it could."""
        failure: dict[str, Any] | None = self.result["failure"]
        return failure

    @property
    def settings(self) -> dict[str, Any]:
        """Keyword arguments that tell a trial which loop to close."""
        return {
            "target": self.teaching.target,
            "amplitude": self.teaching.amplitude,
            "actuator": self.teaching.actuator,
            "weights": self.result["weights"],
        }

    def describe(self) -> dict[str, Any]:
        """The teaching and what it gave, without the weights."""
        described = {
            "amplitude_deg": self.teaching.amplitude,
            "noise": self.teaching.noise,
            "disturbances": list(self.teaching.disturbances),
            "teaching_failure": self.failure,
        }
        for name in ("exponents", "training_error_deg", "teaching_seconds"):
            described[name] = self.result.get(name)
        return described


def teach_cycles(
    context: Context,
    targets: Iterable[str] | None = None,
    trainings: Sequence[str] = TRAININGS,
) -> dict[str, dict[str, list[TaughtCycle]]]:
    """Teach limit cycles as `CYCLES` says; ``--amplitude`` replaces R.

    Args:
        context: of the experiment; its seed shifts those of the teachings.
        targets: names; None: all.
        trainings: of `TRAININGS`.

    Returns:
        The taught cycles by target and training: `NOISE_SEEDS` of a plain one, whose noise is
        drawn, and one that is weighted.
    """
    names = list(CYCLES) if targets is None else list(targets)
    teachings = []
    for target in names:
        for training in trainings:
            teaching = CYCLES[target][training]
            if context.amplitude is not None:
                teaching = replace(teaching, amplitude=context.amplitude)
            teachings += [
                (target, training, replace(teaching, seed=seed)) for seed in seeds_of(teaching)
            ]
    taught: dict[str, dict[str, list[TaughtCycle]]] = {
        target: {training: [] for training in trainings} for target in names
    }
    cycles = teach_all(context, [teaching for _, _, teaching in teachings])
    for (target, training, _), cycle in zip(teachings, cycles, strict=True):
        taught[target][training].append(cycle)
    return taught


def seeds_of(teaching: Teaching) -> range:
    """Seeds with which a teaching is repeated: several where its noise is drawn."""
    return range(NOISE_SEEDS if teaching.sampled else 1)


def teach_all(context: Context, teachings: Sequence[Teaching]) -> list[TaughtCycle]:
    """Carry out some teachings, in order."""
    seeded = [replace(each, seed=each.seed + context.seed) for each in teachings]
    results = context.run(FOLDER, teach_cycle, [{"teaching": asdict(each)} for each in seeded])
    return [TaughtCycle(*pair) for pair in zip(seeded, results, strict=True)]


def disturb_all(
    context: Context,
    bursts: Sequence[tuple[Sequence[TaughtCycle], float]],
    *,
    series: bool = False,
) -> list[list[dict[str, Any]]]:
    """Disturb taught cycles with as many seeds of the noise as the context has trials.

    Args:
        context: of the experiment.
        bursts: the repetitions of a teaching, none of which failed, which take turns over the
            trials; and ε [degrees].
        series: trial 0 of each is to give its outputs.

    Returns:
        For each of `bursts` the results of `disturb_cycle`, in the order of the trials.
    """
    assert context.trials is not None
    results = context.run(
        FOLDER,
        disturb_cycle,
        [
            cycles[trial % len(cycles)].settings
            | {
                "burst": burst,
                "seed": context.seed,
                "trial": trial,
                "series": series and trial == 0,
            }
            for cycles, burst in bursts
            for trial in range(context.trials)
        ],
    )
    count = context.trials
    return [results[count * k : count * (k + 1)] for k in range(len(bursts))]


def fraction_recovered(trials: Sequence[Mapping[str, Any]]) -> float:
    """Part of some trials of `disturb_cycle` that came back to the cycle."""
    return sum(bool(trial["recovered"]) for trial in trials) / len(trials)


def largest_recovered(fractions: Sequence[tuple[float, float]]) -> float | None:
    """The largest ε up to which every trial recovers.

    Args:
        fractions: ε [degrees], increasing, and the part of the trials that recovered from it.

    Returns:
        The ε before the first from which not all recover; None if that is the smallest.
    """
    largest = None
    for burst, fraction in fractions:
        if fraction < 1:
            break
        largest = burst
    return largest
