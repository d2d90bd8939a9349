"""What the experiments on limit cycles share: taught cycles, and their trials under noise.

All of them keep their trials in one folder, so that a cycle is taught once for every figure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from octoarm_agents.experiments.cycles.trials import disturb_cycle, teach_cycle
from octoarm_agents.experiments.runner import RunSettings
from octoarm_agents.reservoir.cycles import CYCLES, TRAININGS
from octoarm_agents.reservoir.teaching import Teaching

FOLDER = "task2"
"""Name under which the trials are kept."""

TRIALS = 10
"""Seeds of the noise on the outputs; the paper shows one run."""

NOISE_SEEDS = 5
"""Repetitions of a plain training, each with its own noise on the lengths."""


_TAUGHT = ("exponents", "training_error_deg", "teaching_seconds")
"""What is told of a teaching."""


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
    def failure(self) -> Any:
        """Why the arm could not follow the teacher, None if it could."""
        return self.result["failure"]

    @property
    def settings(self) -> dict[str, Any]:
        """The keyword argument that tells a trial which loop to close."""
        loop = {name: getattr(self.teaching, name) for name in ("target", "amplitude", "actuator")}
        return {"loop": loop | {"weights": self.result["weights"]}}

    def describe(self) -> dict[str, Any]:
        """The teaching and what it gave, without the weights."""
        return {
            "amplitude_deg": self.teaching.amplitude,
            "noise": self.teaching.noise,
            "disturbances": list(self.teaching.disturbances),
            "teaching_failure": self.failure,
            **{name: self.result.get(name) for name in _TAUGHT},
        }


def list_repetitions(settings: RunSettings, teaching: Teaching) -> list[Teaching]:
    """A teaching with the seeds, and where one is given the R, of an experiment.

    There are `NOISE_SEEDS` of a teaching whose noise is drawn, and one of any other.
    """
    amplitude = teaching.amplitude if settings.amplitude is None else settings.amplitude
    return [
        replace(teaching, amplitude=amplitude, seed=settings.seed + seed)
        for seed in range(NOISE_SEEDS if teaching.sampled else 1)
    ]


def teach_all(
    settings: RunSettings, groups: Sequence[Sequence[Teaching]]
) -> list[list[TaughtCycle]]:
    """Carry out groups of teachings, in order."""
    trials = [{"teaching": asdict(teaching)} for group in groups for teaching in group]
    results = iter(settings.run(FOLDER, teach_cycle, trials))
    return [[TaughtCycle(teaching, next(results)) for teaching in group] for group in groups]


def teach_cycles(
    settings: RunSettings,
    targets: Iterable[str] | None = None,
    trainings: Sequence[str] = TRAININGS,
) -> dict[str, dict[str, list[TaughtCycle]]]:
    """Teach limit cycles as `CYCLES` says; ``--amplitude`` replaces R.

    Args:
        settings: of the experiment; its seed shifts those of the teachings.
        targets: names; None: all.
        trainings: of `TRAININGS`.

    Returns:
        The taught cycles by target and training, one for each of `list_repetitions`.
    """
    names = list(CYCLES if targets is None else targets)
    groups = [
        list_repetitions(settings, CYCLES[target][training])
        for target in names
        for training in trainings
    ]
    taught = iter(teach_all(settings, groups))
    return {target: {training: next(taught) for training in trainings} for target in names}


def disturb_cycles(
    settings: RunSettings, groups: Iterable[Sequence[TaughtCycle]], bursts: Sequence[float]
) -> list[list[tuple[float, list[dict[str, Any]]]]]:
    """Disturb taught cycles with as many seeds of the noise as there are trials.

    Args:
        settings: of the experiment.
        groups: the repetitions of a teaching, which take turns over the trials.
        bursts: ε [degrees].

    Returns:
        For each of `groups` each ε with the results of `disturb_cycle`, in the order of the trials;
        nothing where the arm could not follow the teacher.
    """
    groups = list(groups)
    pairs = [(cycles, burst) for cycles in groups if cycles[0].failure is None for burst in bursts]
    points = [[cycle.settings | {"burst": burst} for cycle in cycles] for cycles, burst in pairs]
    results = iter(settings.repeat(FOLDER, disturb_cycle, points))
    return [
        [(burst, next(results)) for burst in bursts] if cycles[0].failure is None else []
        for cycles in groups
    ]


def fraction_recovered(trials: Sequence[Mapping[str, Any]]) -> float:
    """Part of some trials of `disturb_cycle` that came back to the cycle."""
    return sum(bool(trial["recovered"]) for trial in trials) / len(trials)


def count_outcomes(trials: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """How many disturbed runs ended how: ``recovered``, the failures' reasons, ``off_cycle``."""
    return Counter(
        "recovered"
        if trial["recovered"]
        else "off_cycle"
        if trial["failure"] is None
        else trial["failure"]["reason"]
        for trial in trials
    )
