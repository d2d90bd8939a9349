"""Figures 6 to 8: the three limit cycles, held by the body alone for 1,000,000 steps (section 3.2).

First the paper's own training at its own R and ν, with several seeds of the noise and with other ν
beside it. Then, at the same R, a ridge weighted by what small disturbances of the base do to the
body (`octoarm_agents.reservoir.teaching`). Both are disturbed while they run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from octoarm_agents.experiments.cycle_settings import (
    BURSTS,
    CYCLES,
    NEIGHBOURS,
    PAPER_FINDINGS,
    TRAININGS,
)
from octoarm_agents.experiments.refusal import RefusedError
from octoarm_agents.experiments.runner import Context, Experiment, ResultTable
from octoarm_agents.experiments.task2 import (
    FOLDER,
    STEPS,
    TRIALS,
    TaughtCycle,
    disturb_all,
    fraction_recovered,
    largest_recovered,
    seeds_of,
    teach_all,
    teach_cycles,
)
from octoarm_agents.experiments.task2_trials import BURST_BEGIN, BURST_END, BURST_RUN, hold_cycle
from octoarm_agents.reservoir.closed_loop import WINDOW_STEPS

__all__ = ["EXPERIMENT"]

LISTED = (
    "amplitude_deg",
    "noise",
    "steps",
    "survived",
    "held",
    "failure",
    "distance",
    "largest_jump_deg",
)
"""What is told of every repetition of a plain training."""


def run(context: Context) -> dict[str, Any]:
    """Hold every cycle by both trainings, try other ν, and disturb what is held."""
    steps = STEPS if context.steps is None else context.steps
    if steps < 2 * WINDOW_STEPS:
        raise RefusedError(f"steps = {steps}: expected at least {2 * WINDOW_STEPS}")
    taught = teach_cycles(context)
    beside = _teach_neighbours(context)
    every = [cycle for pair in taught.values() for cycles in pair.values() for cycle in cycles]
    held = iter(_hold(context, [*every, *(cycle for _, cycle in beside)], steps))
    plain: dict[str, Any] = {}
    weighted: dict[str, Any] = {}
    for target, pair in taught.items():
        entries = [next(held) for _ in pair["plain"]]
        plain[target] = _list(entries) | {
            "series": entries[0]["series"],
            "paper": PAPER_FINDINGS[target],
            "neighbours": [],
        }
        weighted[target] = next(held)
    for target, cycle in beside:
        entry, neighbours = next(held), plain[target]["neighbours"]
        if cycle.teaching.seed == context.seed:
            neighbours.append({"noise": cycle.teaching.noise, "held": [], "distance": []})
        neighbours[-1]["held"].append(entry["held"])
        neighbours[-1]["distance"].append(entry["distance"])
    return {
        "steps": steps,
        "window_steps": WINDOW_STEPS,
        "trials": context.trials,
        "burst": {"steps": [BURST_BEGIN, BURST_END], "run_steps": BURST_RUN, "ladder": BURSTS},
        "plain": plain,
        "weighted": weighted,
        "recovery": _disturb(context, taught),
    }


def _teach_neighbours(context: Context) -> list[tuple[str, TaughtCycle]]:
    """The plain training with other ν, and the target of each."""
    teachings = []
    for target, trainings in CYCLES.items():
        teaching = trainings["plain"]
        if context.amplitude is not None:
            teaching = replace(teaching, amplitude=context.amplitude)
        teachings += [
            (target, replace(teaching, noise=noise, seed=seed))
            for noise in NEIGHBOURS
            if noise != teaching.noise
            for seed in seeds_of(teaching)
        ]
    cycles = teach_all(context, [teaching for _, teaching in teachings])
    return [(target, cycle) for (target, _), cycle in zip(teachings, cycles, strict=True)]


def _hold(context: Context, taught: Sequence[TaughtCycle], steps: int) -> list[dict[str, Any]]:
    """Let the arms go; those that could not be taught have made no steps."""
    ready = [each for each in taught if each.failure is None]
    results = iter(
        context.run(FOLDER, hold_cycle, [each.settings | {"steps": steps} for each in ready])
    )
    return [
        each.describe() | _flatten(next(results) if each.failure is None else None)
        for each in taught
    ]


def _flatten(result: Mapping[str, Any] | None) -> dict[str, Any]:
    """What `hold_cycle` gave under the names of the JSON file."""
    scores = None if result is None else result["scores"]
    values = scores or {}
    return {
        "steps": 0 if result is None else result["steps"],
        "survived": result is not None and result["survived"],
        "held": scores is not None and scores["held"],
        "failure": None if result is None else result["failure"],
        "distance": values.get("mean_distance"),
        "distance_max": values.get("max_distance"),
        "period_ratio": values.get("period_ratio"),
        "amplitude_ratio": values.get("amplitude_ratio"),
        "largest_jump_deg": None if result is None else result["largest_jump_deg"],
        "seconds": None if result is None else result["seconds"],
        "series": [] if result is None else result["series"],
    }


def _list(entries: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The repetitions of a training, a list for each of `LISTED`."""
    listed: dict[str, Any] = {name: [entry[name] for entry in entries] for name in LISTED}
    listed["teaching_failure"] = entries[0]["teaching_failure"]
    return listed


def _disturb(
    context: Context, taught: Mapping[str, Mapping[str, Sequence[TaughtCycle]]]
) -> dict[str, dict[str, Any]]:
    """The part of the trials that recovers, for every ε of the ladder."""
    bursts = [
        (target, training, burst)
        for target, pair in taught.items()
        for training, cycles in pair.items()
        if cycles[0].failure is None
        for burst in BURSTS
    ]
    trials = disturb_all(context, [(taught[t][name], burst) for t, name, burst in bursts])
    fractions: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for (target, training, burst), results in zip(bursts, trials, strict=True):
        entry = fractions.setdefault((target, training), [])
        entry.append((burst, fraction_recovered(results)))
    return {
        target: {
            training: {
                "recovered_fraction": {
                    f"{burst:g}": part for burst, part in fractions.get((target, training), [])
                },
                "largest_recovered": largest_recovered(fractions.get((target, training), [])),
            }
            for training in TRAININGS
        }
        for target in taught
    }


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
            (target, f"{each['noise']:.0e}", _count(each["held"]), _spread(each["distance"]))
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
    return f"{amplitude:g}", str(steps), _count(entry["held"]), _spread(entry["distance"])


def _count(held: Sequence[bool]) -> str:
    return f"{sum(held)} of {len(held)}"


def _spread(distances: Sequence[float | None]) -> str:
    """Median of the arms that are still there, smallest to largest, and how many were lost."""
    known = sorted(each for each in distances if each is not None)
    lost = len(distances) - len(known)
    told = f"{lost} lost" if lost else ""
    if known:
        middle = known[len(known) // 2]
        told = f"{middle:.1e} ({known[0]:.1e} … {known[-1]:.1e}){', ' if lost else ''}{told}"
    return told


def draw(result: Mapping[str, Any], path: Path) -> None:
    """A row a cycle: outputs after release and at the end, phase portraits, lengths."""
    from octoarm_agents.experiments.limit_cycles_figure import draw_limit_cycles

    draw_limit_cycles(result, path)


EXPERIMENT = Experiment("limit-cycles", TRIALS, run, draw, tables)
