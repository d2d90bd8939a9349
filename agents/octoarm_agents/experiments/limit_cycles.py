"""Figures 6 to 8: the three limit cycles, held by the body alone for 1,000,000 steps (section 3.2).

Beside the paper's protocol stands what it takes to hold all three: a ridge weighted by what small
disturbances of the base do to the body (`octoarm_agents.reservoir.teaching`). The same readouts
taught without it are reported too, and so are the paper's own amplitudes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from octoarm_agents.experiments import EXPERIMENTS
from octoarm_agents.experiments.cycle_settings import (
    ACTUATORS,
    CYCLES,
    DIRECT_BURSTS,
    PAPER_AMPLITUDES,
    PAPER_FINDINGS,
    PAPER_NOISES,
    PLAIN_NOISES,
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
    paper_bursts,
    teach_all,
    teach_cycles,
)
from octoarm_agents.experiments.task2_trials import BURST_BEGIN, BURST_END, BURST_RUN, hold_cycle
from octoarm_agents.reservoir.closed_loop import WINDOW_STEPS
from octoarm_agents.reservoir.teaching import UNDISTURBED

__all__ = ["EXPERIMENT"]

SERIES = "series"

PAPER_BURST_RULE = (
    "White noise of half width ε on both outputs, anew each step. Quadratic and Lissajous: the"
    " paper's ε. Van der Pol: the quadratic cycle's in proportion to the amplitudes."
)


def run(context: Context) -> dict[str, Any]:
    """Hold every cycle, disturb it, and try what the paper did."""
    steps = STEPS if context.steps is None else context.steps
    if steps < 2 * WINDOW_STEPS:
        raise RefusedError(f"steps = {steps}: expected at least {2 * WINDOW_STEPS}")
    taught = teach_cycles(context)
    held = _hold(context, [each for pair in taught.values() for each in pair.values()], steps)
    cycles: dict[str, Any] = {}
    for index, (target, pair) in enumerate(taught.items()):
        direct, servo = held[len(ACTUATORS) * index : len(ACTUATORS) * (index + 1)]
        cycles[target] = pair["direct"].describe() | direct
        cycles[target]["servo"] = pair["servo"].describe() | servo
        cycles[target]["paper"] = PAPER_FINDINGS[target]
    for target, results in _disturb(context, taught).items():
        cycles[target] |= results
    for target, results in _plain_trainings(context, steps).items():
        cycles[target]["paper_training"] = results
    return {
        "steps": steps,
        "window_steps": WINDOW_STEPS,
        "trials": context.trials,
        "burst": {
            "steps": [BURST_BEGIN, BURST_END],
            "run_steps": BURST_RUN,
            "rule": PAPER_BURST_RULE,
            "direct_ladder_deg": list(DIRECT_BURSTS),
        },
        "cycles": cycles,
        "paper_amplitudes": _paper_amplitudes(context, steps),
    }


def _hold(context: Context, taught: Sequence[TaughtCycle], steps: int) -> list[dict[str, Any]]:
    """Let the arms go; those that could not be taught have made no steps."""
    ready = [each for each in taught if each.failure is None]
    results = iter(
        context.run(FOLDER, hold_cycle, [each.settings | {"steps": steps} for each in ready])
    )
    return [_flatten(next(results) if each.failure is None else None) for each in taught]


def _flatten(result: Mapping[str, Any] | None) -> dict[str, Any]:
    """What `hold_cycle` gave under the names of the JSON file."""
    scores = None if result is None else result["scores"]
    values = scores or {}
    return {
        "steps": 0 if result is None else result["steps"],
        "survived": result is not None and result["survived"],
        "held": scores is not None and scores["held"],
        "failure": None if result is None else result["failure"],
        "orbit_distance_mean": values.get("mean_distance"),
        "orbit_distance_max": values.get("max_distance"),
        "period_ratio": values.get("period_ratio"),
        "amplitude_ratio": values.get("amplitude_ratio"),
        "seconds": None if result is None else result["seconds"],
        SERIES: [] if result is None else result["series"],
    }


def _disturb(
    context: Context, taught: Mapping[str, Mapping[str, TaughtCycle]]
) -> dict[str, dict[str, Any]]:
    """The paper's noise through the servo, and the ladder on the direct base."""
    pairs = [
        (cycle, burst)
        for by_actuator in taught.values()
        for cycle in by_actuator.values()
        if cycle.failure is None
        for burst in _bursts(context, cycle)
    ]
    fractions: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for (cycle, burst), trials in zip(pairs, disturb_all(context, pairs), strict=True):
        key = (cycle.teaching.target, cycle.teaching.actuator)
        fractions.setdefault(key, []).append((burst, fraction_recovered(trials)))
    results: dict[str, dict[str, Any]] = {}
    for target in taught:
        servo = fractions.get((target, "servo"), [])
        direct = fractions.get((target, "direct"), [])
        results[target] = {
            "recovered": {f"{burst:g}": fraction == 1 for burst, fraction in servo},
            "recovered_fraction": {f"{burst:g}": fraction for burst, fraction in servo},
            "largest_recovered_direct": largest_recovered(direct),
            "direct_recovered_fraction": {f"{burst:g}": fraction for burst, fraction in direct},
        }
    return results


def _bursts(context: Context, cycle: TaughtCycle) -> Sequence[float]:
    servo = cycle.teaching.actuator == "servo"
    return paper_bursts(context, cycle) if servo else DIRECT_BURSTS


def _plain_trainings(context: Context, steps: int) -> dict[str, dict[str, Any]]:
    """The direct base taught without disturbances, at the same R, for each ν of a grid."""
    teachings = []
    for target, by_actuator in CYCLES.items():
        teaching = replace(by_actuator["direct"], disturbances=UNDISTURBED)
        if context.amplitude is not None:
            teaching = replace(teaching, amplitude=context.amplitude)
        noises = sorted({*PLAIN_NOISES, PAPER_NOISES[target]})
        teachings += [replace(teaching, noise=noise) for noise in noises]
    taught = teach_all(context, teachings)
    tried: dict[str, list[dict[str, Any]]] = {target: [] for target in CYCLES}
    for cycle, held in zip(taught, _hold(context, taught, steps), strict=True):
        entry = cycle.describe() | held
        del entry[SERIES]
        tried[cycle.teaching.target].append(entry)
    return {target: _best(entries) | {"tried": entries} for target, entries in tried.items()}


def _best(entries: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The one that held the cycle most closely; if none did, that which went on longest."""

    def merit(entry: dict[str, Any]) -> tuple[bool, int, float]:
        distance = entry["orbit_distance_mean"]
        return entry["held"], entry["steps"], 0.0 if distance is None else -distance

    return max(entries, key=merit)


def _paper_amplitudes(context: Context, steps: int) -> dict[str, dict[str, Any]]:
    """The paper's R: with its own ν, and with the weighting used here."""
    teachings = []
    for target, by_actuator in CYCLES.items():
        for actuator in ACTUATORS:
            weighted = replace(by_actuator[actuator], amplitude=PAPER_AMPLITUDES[target])
            plain = replace(weighted, noise=PAPER_NOISES[target], disturbances=UNDISTURBED)
            teachings += [plain, weighted]
    taught = teach_all(context, teachings)
    entries = [
        {name: value for name, value in (cycle.describe() | held).items() if name != SERIES}
        for cycle, held in zip(taught, _hold(context, taught, steps), strict=True)
    ]
    results: dict[str, dict[str, Any]] = {target: {} for target in CYCLES}
    for index in range(0, len(entries), 2):
        teaching = taught[index].teaching
        results[teaching.target][teaching.actuator] = {
            "amplitude_deg": teaching.amplitude,
            "follows_teacher": taught[index].failure is None,
            "failure": taught[index].failure,
            "paper_training": entries[index],
            "weighted_training": entries[index + 1],
        }
    return results


def tables(result: Mapping[str, Any]) -> list[ResultTable]:
    """The cycles held, what they recover from, and what the paper's settings give."""
    columns = ("cycle", "base", "R (°)", "steps", "distance", "largest", "period")
    rows, recovery = [], []
    notes = [
        "Distance of the outputs to the target's orbit, mean and largest, in units of R; period"
        " over the target's. Plain: trained as in the paper, the best of the ν tried."
    ]
    for target, entry in result["cycles"].items():
        plain = entry["paper_training"]
        for base, each in (
            ("direct", entry),
            ("servo", entry["servo"]),
            ("direct, plain", plain),
        ):
            rows.append((target, base, *_row(each)))
            failure = each["teaching_failure"] or each["failure"]
            if failure is not None:
                notes.append(f"{target}, {base}: {failure['message']}.")
        servo = ", ".join(
            f"{burst}°: {fraction:.0%}" for burst, fraction in entry["recovered_fraction"].items()
        )
        largest = entry["largest_recovered_direct"]
        direct = "none of the ladder" if largest is None else f"{largest:g}°"
        recovery.append((target, servo or "–", direct))
    paper = []
    for target, by_actuator in result["paper_amplitudes"].items():
        for actuator, entry in by_actuator.items():
            if entry["failure"] is not None:
                outcome = (entry["failure"]["message"],) * 2
            else:
                outcome = (_outcome(entry["paper_training"]), _outcome(entry["weighted_training"]))
            paper.append((target, actuator, f"{entry['amplitude_deg']:g}", *outcome))
    window = f"last {result['window_steps']} of {result['steps']} steps"
    return [
        ResultTable(f"Limit cycles in closed loop (* held), {window}", columns, rows, notes),
        ResultTable(
            f"Recovery from noise, {result['trials']} seeds",
            ("cycle", "servo: part recovered", "direct: largest ε all recover from"),
            recovery,
        ),
        ResultTable(
            "At the paper's R",
            ("cycle", "base", "R (°)", "the paper's training", "weighted ridge"),
            paper,
        ),
    ]


def _row(entry: Mapping[str, Any]) -> tuple[str, ...]:
    numbers = (
        _number(entry[name], digits)
        for name, digits in (
            ("orbit_distance_mean", ".1e"),
            ("orbit_distance_max", ".1e"),
            ("period_ratio", ".4f"),
        )
    )
    return (
        f"{entry['amplitude_deg']:g}",
        f"{entry['steps']}{'*' if entry['held'] else ''}",
        *numbers,
    )


def _number(value: float | None, digits: str) -> str:
    return "–" if value is None else format(value, digits)


def _outcome(entry: Mapping[str, Any]) -> str:
    """A run at the paper's amplitude in a few words."""
    if entry["failure"] is not None:
        return f"{entry['failure']['message']} (step {entry['failure']['step']})"
    distance = entry["orbit_distance_mean"]
    return f"{'held' if entry['held'] else 'not held'}, distance {distance:.5f}"


def draw(result: Mapping[str, Any], path: Path) -> None:
    """A row a cycle: outputs after release and at the end, phase portrait, lengths."""
    from octoarm_agents.experiments.limit_cycles_figure import draw_limit_cycles

    draw_limit_cycles(result, path)


EXPERIMENT = Experiment("limit-cycles", EXPERIMENTS["limit-cycles"], TRIALS, run, draw, tables)
