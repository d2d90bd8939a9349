"""Contenders that take turns, what they come to, and how they compare.

On a shared machine absolute times drift by tens of per cent within seconds. So the contenders take
turns, a short slice each, round after round; every ratio is formed within a round, and medians over
the rounds are reported with their extremes.
"""

from __future__ import annotations

import gc
import importlib.util
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.whole import whole_number

NOT_INSTALLED = 'not installed: pip install "octoarm-agents[benchmark]"'

_SHORTEST = 0.001
"""Shortest slice [s]."""

Advance = Callable[[str, int], Any]
"""Called after each slice with a contender's name and the number of slices in all."""


@dataclass(frozen=True)
class Spread:
    """Minimum, median and maximum over rounds."""

    min: float
    median: float
    max: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """The spread of at least one value."""
        return cls(min(values), statistics.median(values), max(values))


@dataclass(frozen=True)
class Contender:
    """Something that is measured.

    Attributes:
        name: its row in the table.
        measure: measures for about so many seconds; gives figures by name, always the same ones.
        rates: what is told besides: by name, a number that is divided by the median of the first
            figure.
        close: called when it is not needed any more.
    """

    name: str
    measure: Callable[[float], dict[str, float]]
    rates: Mapping[str, float] = field(default_factory=dict)
    close: Callable[[], Any] = lambda: None


@dataclass(frozen=True)
class Comparison:
    """One contender beside another, round by round.

    Attributes:
        key: its name in a file.
        label: its row in the table.
        above: a contender.
        below: another.
        unit: "×" for the ratio of a figure, "%" for a hundred times that, and any other, the
            figure's own, for `factor` times the difference.
        figure: name of the figure; empty: the first.
        factor: see there.
    """

    key: str
    label: str
    above: str
    below: str
    unit: str = "×"
    figure: str = ""
    factor: float = 1.0

    def spread(self, figures: Mapping[str, Mapping[str, Sequence[float]]]) -> Spread | None:
        """Over the rounds; None where one of the two was not measured."""
        if self.above == self.below or not {self.above, self.below} <= set(figures):
            return None
        name = self.figure or next(iter(figures[self.above]))
        pairs = list(zip(figures[self.above][name], figures[self.below][name], strict=True))
        if self.unit in ("×", "%"):
            scale = 100.0 if self.unit == "%" else 1.0
            return Spread.of([scale * one / two for one, two in pairs])
        return Spread.of([self.factor * (one - two) for one, two in pairs])


@dataclass
class Result:
    """What a benchmark has found.

    Attributes:
        rounds: number of rounds.
        figures: by contender and name, of every round.
        rates: by contender and name, see `Contender`.
        comparisons: what is to be compared.
        left_out: what could not be measured, and why.
        more: further facts, by name.
        packages: whose versions matter.
    """

    rounds: int
    figures: dict[str, dict[str, list[float]]]
    rates: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    comparisons: list[Comparison] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)
    more: dict[str, Any] = field(default_factory=dict)
    packages: Sequence[str] = ()

    @property
    def ratios(self) -> dict[str, dict[str, Any]]:
        """All comparisons of which both sides were measured, by key."""
        spreads = {each: each.spread(self.figures) for each in self.comparisons}
        return {
            each.key: asdict(spread) | {"label": each.label, "unit": each.unit}
            for each, spread in spreads.items()
            if spread is not None
        }

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain numbers for a JSON file; units in the keys."""
        contenders: dict[str, dict[str, Any]] = {}
        for name, figures in self.figures.items():
            spreads = {key: Spread.of(values) for key, values in figures.items()}
            first = next(iter(spreads.values())).median
            contenders[name] = {
                key: asdict(spread) | {"by_round": figures[key]} for key, spread in spreads.items()
            } | {key: number / first for key, number in self.rates.get(name, {}).items()}
        return {
            "rounds": self.rounds,
            "contenders": contenders,
            "ratios": self.ratios,
            "left_out": self.left_out,
            **self.more,
            "machine": describe_machine(),
            "versions": package_versions(
                "octoarm-env", "octoarm-agents", "numpy", "gymnasium", *self.packages
            ),
        }


def take_turns(
    contenders: Sequence[Contender], seconds: float, rounds: int, advance: Advance | None = None
) -> Result:
    """Measure contenders in turns, a slice of each in every round, and close them.

    Args:
        contenders: with names of their own.
        seconds: time for all slices together.
        rounds: slices of each contender.
        advance: called with a contender's name and the number of slices in all, after each slice.
    """
    figures: dict[str, dict[str, list[float]]] = {each.name: {} for each in contenders}
    try:
        slices = whole_number("rounds", rounds, 1) * len(contenders)
        for turn in range(rounds):
            # Every round begins with another contender, so that none always follows the same one.
            first = turn % len(contenders)
            for each in [*contenders[first:], *contenders[:first]]:
                for name, value in each.measure(max(seconds / slices, _SHORTEST)).items():
                    figures[each.name].setdefault(name, []).append(value)
                if advance is not None:
                    advance(each.name, slices)
    finally:
        for each in contenders:
            each.close()
    return Result(rounds, figures, {each.name: each.rates for each in contenders})


def fitted(
    figure: str, factor: float, take: Callable[[int], float], limit: int
) -> Callable[[float], dict[str, float]]:
    """Measure what takes its time in steps, always so many as fit into the first slice.

    Args:
        figure: its name.
        factor: of the seconds of a step.
        take: makes so many steps, and gives the seconds that they took.
        limit: most steps in a slice.
    """
    steps = 0

    def measure(seconds: float) -> dict[str, float]:
        nonlocal steps
        if not steps:
            steps = _fitting_steps(take, limit, seconds)
        return {figure: factor * take(steps) / steps}

    return measure


def _fitting_steps(take: Callable[[int], float], limit: int, seconds: float) -> int:
    count = 1
    take(count)  # the first slice also pays for what is made only once
    while True:
        wanted = int(count * seconds / max(take(count), 1e-9))
        if wanted <= 2 * count or count == limit:
            return max(1, min(wanted, limit))
        count = min(8 * count, wanted, limit)


def timed(prepare: Callable[[], Any], run: Callable[[int], Any]) -> Callable[[int], float]:
    """Give the seconds of so many steps from a fresh start, without the garbage collector's."""

    def take(steps: int) -> float:
        prepare()
        collecting = gc.isenabled()
        gc.disable()
        try:
            started = time.perf_counter()
            run(steps)
            return time.perf_counter() - started
        finally:
            if collecting:
                gc.enable()

    return take


def has_mujoco() -> bool:
    """Whether MuJoCo is installed."""
    return importlib.util.find_spec("mujoco") is not None
