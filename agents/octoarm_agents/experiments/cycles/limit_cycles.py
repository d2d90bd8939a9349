"""Figures 6 to 8: the three limit cycles, held by the body alone for 1,000,000 steps (section 3.2).

First the paper's own training at its own R and ν, with several seeds of the noise and with other ν
beside it. Then, at the same R, a ridge weighted by what small disturbances of the base do to the
body (`octoarm_agents.reservoir.teaching`). Both are disturbed while they run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import takewhile
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from octoarm_agents.common.plotting import BLUE, GREEN, new_figure, shades, write_letters
from octoarm_agents.experiments.cycles.plots import draw_outputs, draw_portrait, explain_outputs
from octoarm_agents.experiments.cycles.taught import (
    FOLDER,
    TRIALS,
    TaughtCycle,
    disturb_cycles,
    fraction_recovered,
    list_repetitions,
    teach_all,
    teach_cycles,
)
from octoarm_agents.experiments.cycles.trials import BURST_BEGIN, BURST_END, BURST_RUN, hold_cycle
from octoarm_agents.experiments.plots import say_missing
from octoarm_agents.experiments.runner import Experiment, RefusedError, RunSettings
from octoarm_agents.experiments.tables import ResultTable, format_count
from octoarm_agents.reservoir.closed_loop import WINDOW_STEPS
from octoarm_agents.reservoir.cycles import (
    BURSTS,
    CYCLE_LABELS,
    CYCLES,
    NEIGHBOURS,
    PAPER_FINDINGS,
)

STEPS = 1_000_000
"""Steps of the closed loop (section 2.2.2)."""

LISTED = (
    *("amplitude_deg", "noise", "steps", "survived", "held"),
    *("failure", "distance", "largest_jump_deg"),
)
"""What is told of every repetition of a plain training."""

_NO_RUN: dict[str, Any] = {"steps": 0, "survived": False, "series": []} | dict.fromkeys(
    ("failure", "scores", "largest_jump_deg", "seconds")
)
"""The result of `hold_cycle` where the arm could not be taught."""


def run(settings: RunSettings) -> dict[str, Any]:
    """Hold every cycle by both trainings, try other ν, and disturb what is held."""
    steps = STEPS if settings.steps is None else settings.steps
    if steps < 2 * WINDOW_STEPS:
        raise RefusedError(f"steps = {steps}: expected at least {2 * WINDOW_STEPS}")
    taught = teach_cycles(settings)
    groups = [cycles for pair in taught.values() for cycles in pair.values()]
    beside = [
        (target, replace(trainings["plain"], noise=noise))
        for target, trainings in CYCLES.items()
        for noise in NEIGHBOURS
        if noise != trainings["plain"].noise
    ]
    neighbours = teach_all(settings, [list_repetitions(settings, each) for _, each in beside])
    held = iter(_hold(settings, [*groups, *neighbours], steps))
    plain: dict[str, Any] = {}
    weighted: dict[str, Any] = {}
    for target in taught:
        entries, (weighted[target],) = next(held), next(held)
        plain[target] = {name: [entry[name] for entry in entries] for name in LISTED} | {
            "teaching_failure": entries[0]["teaching_failure"],
            "series": entries[0]["series"],
            "paper": PAPER_FINDINGS[target],
            "neighbours": [],
        }
    for (target, teaching), entries in zip(beside, held, strict=True):
        listed = {name: [entry[name] for entry in entries] for name in ("held", "distance")}
        plain[target]["neighbours"].append({"noise": teaching.noise} | listed)
    recovery = map(_describe_recovery, disturb_cycles(settings, groups, BURSTS))
    return {
        "steps": steps,
        "window_steps": WINDOW_STEPS,
        "trials": settings.trials,
        "burst": {"steps": [BURST_BEGIN, BURST_END], "run_steps": BURST_RUN, "ladder": BURSTS},
        "plain": plain,
        "weighted": weighted,
        "recovery": {
            target: {training: next(recovery) for training in pair}
            for target, pair in taught.items()
        },
    }


def _hold(
    settings: RunSettings, groups: Sequence[Sequence[TaughtCycle]], steps: int
) -> list[list[dict[str, Any]]]:
    """Let the arms go; those that could not be taught have made no steps."""
    ready = [cycle for cycles in groups for cycle in cycles if cycle.failure is None]
    trials = [cycle.settings | {"steps": steps} for cycle in ready]
    results = iter(settings.run(FOLDER, hold_cycle, trials))
    return [
        [
            cycle.describe() | _describe_run(next(results) if cycle.failure is None else _NO_RUN)
            for cycle in cycles
        ]
        for cycles in groups
    ]


def _describe_run(result: Mapping[str, Any]) -> dict[str, Any]:
    """What `hold_cycle` gave under the names of the JSON file."""
    scores = result["scores"] or {}
    return {name: value for name, value in result.items() if name != "scores"} | {
        "held": scores.get("held", False),
        "distance": scores.get("mean_distance"),
        "distance_max": scores.get("max_distance"),
        "period_ratio": scores.get("period_ratio"),
        "amplitude_ratio": scores.get("amplitude_ratio"),
    }


def _describe_recovery(
    bursts: Sequence[tuple[float, Sequence[Mapping[str, Any]]]],
) -> dict[str, Any]:
    """The part of the trials that recovers, for every ε of the ladder."""
    fractions = [(burst, fraction_recovered(trials)) for burst, trials in bursts]
    return {
        "recovered_fraction": {f"{burst:g}": part for burst, part in fractions},
        "largest_recovered": largest_recovered(fractions),
    }


def largest_recovered(fractions: Sequence[tuple[float, float]]) -> float | None:
    """The largest ε up to which every trial recovers.

    Args:
        fractions: ε [degrees], increasing, and the part of the trials that recovered from it.

    Returns:
        The ε before the first from which not all recover; None if that is the smallest.
    """
    held = takewhile(lambda pair: pair[1] >= 1, fractions)
    return max((burst for burst, _ in held), default=None)


def tables(result: Mapping[str, Any]) -> list[ResultTable]:
    """The cycles held by both trainings, other ν, and what is recovered from."""
    rows, notes, beside, recovery = [], [], [], []
    for target, plain in result["plain"].items():
        weighted = result["weighted"][target]
        failure = plain["teaching_failure"] or weighted["failure"]
        if failure is not None:
            notes.append(f"{target}: {failure['message']}.")
        rows.append((target, "plain", *_outcomes(plain, plain["amplitude_deg"][0])))
        one = {name: [weighted[name]] for name in ("held", "distance", "steps")}
        rows.append((target, "weighted", *_outcomes(one, weighted["amplitude_deg"])))
        notes.append(f"The paper, {target}: {plain['paper']}")
        beside += [
            (target, f"{each['noise']:.0e}", format_count(each["held"]), _spread(each["distance"]))
            for each in plain["neighbours"]
        ]
        for training, entry in result["recovery"][target].items():
            fractions = entry["recovered_fraction"].items()
            lost = [f"{burst}°: {part:.0%}" for burst, part in fractions if part < 1]
            largest = entry["largest_recovered"]
            recovery.append(
                (
                    target,
                    training,
                    "none of the ladder" if largest is None else f"{largest:g}°",
                    ", ".join(lost) or "–",
                )
            )
    title = f"Limit cycles in closed loop, last {result['window_steps']} of {result['steps']} steps"
    columns = ("cycle", "training", "R (°)", "steps", "held", "distance, median (all)")
    return [
        ResultTable(title, columns, rows, notes),
        ResultTable("Plain, other ν", ("cycle", "ν (m)", "held", "distance, median (all)"), beside),
        ResultTable(
            f"Recovery from noise, {result['trials']} seeds",
            ("cycle", "training", "largest ε all recover from", "larger ε: part recovered"),
            recovery,
        ),
    ]


def _outcomes(entry: Mapping[str, Any], amplitude: float) -> tuple[str, ...]:
    steps = min(entry["steps"])
    return f"{amplitude:g}", str(steps), format_count(entry["held"]), _spread(entry["distance"])


def _spread(distances: Sequence[float | None]) -> str:
    """Median of the arms that are still there, smallest to largest, and how many were lost."""
    known = sorted(each for each in distances if each is not None)
    lost = len(distances) - len(known)
    told = f"{lost} lost" if lost else ""
    if known:
        middle = known[len(known) // 2]
        told = f"{middle:.1e} ({known[0]:.1e} … {known[-1]:.1e}){', ' if lost else ''}{told}"
    return told


_TITLES = (
    "plain training: after release",
    "at the end, target in phase",
    "at the end",
    "weighted ridge: at the end",
    "plain training: at the end",
)


def draw(result: Mapping[str, Any]) -> Figure:
    """A row a cycle: outputs after release and at the end, phase portraits, lengths."""
    timestep = result["body"]["timestep"]
    figure = new_figure(15.5, 10.5)
    grid = figure.add_gridspec(3, 5, width_ratios=(1.5, 1.5, 1.0, 1.0, 1.5))
    panels = []
    for row, (target, plain) in enumerate(result["plain"].items()):
        axes = [figure.add_subplot(grid[row, column]) for column in range(5)]
        panels += axes
        failure = plain["teaching_failure"] or plain["failure"][0]
        series = plain["series"]
        for index in range(2):
            if index < len(series):
                draw_outputs(axes[index], series[index], timestep)
            else:
                say_missing(axes[index], failure)
        if len(series) == 2:
            _draw_end(axes[2], series[1], plain["distance"][0], BLUE)
            _draw_lengths(axes[4], series[1], timestep)
        else:
            say_missing(axes[2], failure)
            say_missing(axes[4], failure)
        weighted = result["weighted"][target]
        if len(weighted["series"]) == 2:
            _draw_end(axes[3], weighted["series"][1], weighted["distance"], GREEN)
        else:
            say_missing(axes[3], weighted["teaching_failure"] or weighted["failure"])
        label = f"{CYCLE_LABELS[target]}\nR = {plain['amplitude_deg'][0]:g}°"
        axes[0].set_ylabel(f"{label}\noutput (degrees)")
    write_letters(panels)
    for panel, title in zip(panels, _TITLES, strict=False):
        panel.set_title(title, fontsize=9)
    explain_outputs(figure)
    return figure


def _draw_end(axes: Axes, series: Mapping[str, Any], distance: float | None, colour: str) -> None:
    """Portrait of the end of a run."""
    draw_portrait(axes, series["target_deg"], [(series["outputs_deg"], colour)])
    if distance is not None:
        axes.set_xlabel(f"output 1 (degrees)\nmean distance {distance:.5f} R")


def _draw_lengths(axes: Axes, series: Mapping[str, Any], timestep: float) -> None:
    """Spring 1 of some compartments."""
    time = [timestep * step for step in series["step"]]
    count = len(series["compartments"])
    named = zip(series["compartments"], shades(count), strict=True)
    for values, (name, colour) in zip(series["lengths_metres"], named, strict=True):
        axes.plot(time, [1e3 * v for v in values], color=colour, linewidth=1.0, label=f"{name}")
    axes.margins(x=0.0)
    axes.ticklabel_format(axis="x", useOffset=False)
    axes.set_xlabel("time in closed loop (s)")
    axes.set_ylabel("spring 1 (mm)")
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.22 * (high - low))
    axes.legend(
        title="compartment",
        title_fontsize=7,
        fontsize=7,
        frameon=False,
        ncols=count,
        columnspacing=0.8,
        handlelength=1.0,
        loc="upper center",
    )


LIMIT_CYCLES = Experiment("limit-cycles", TRIALS, run, tables, draw)
