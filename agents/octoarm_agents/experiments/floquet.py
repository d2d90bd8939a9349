"""What decides whether a limit cycle is held: the stability of the loop, beyond the paper.

Section 3.2 finds success "extremely sensitive" to R and ν. Here readouts are fitted over ν and R,
as in the paper and with the ridge weighted by disturbances (`octoarm_agents.reservoir.teaching`).
Three numbers of each loop are set against what it did when the arm was let go:

- the leading Floquet exponents on the teacher's orbit: if more than the phase's is above zero, the
  loop leaves it;
- the response to white noise: a loop with negative exponents can still be lost, if deviations grow
  before they die out and leave the small basin in which they do;
- the training error: a loop that is stable about a wrong orbit is none that holds the cycle.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from octoarm_agents.experiments.cycle_settings import CYCLE_LABELS, CYCLES
from octoarm_agents.experiments.floquet_trials import (
    PHASE_ERROR,
    RESPONSE_NOISES,
    RESPONSE_TURNS,
    is_stable,
    is_thrown_far,
    probe_loops,
)
from octoarm_agents.experiments.runner import Context, Experiment, ResultTable
from octoarm_agents.experiments.task2 import FOLDER
from octoarm_agents.reservoir.closed_loop import HELD_DISTANCE

__all__ = ["EXPERIMENT"]

STEPS = 20_000
AMPLITUDES = (0.5, 1.0, 1.5)
"""R tried, in units of the cycle's own."""

NOISES = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5)
FACTORS = (0.0, 0.1, 1.0, 10.0)
"""ν [m], and factors of the cycle's own κ; 0 is the paper's training."""


def run(context: Context) -> dict[str, Any]:
    """Numbers and fate of every loop of the grid."""
    steps = STEPS if context.steps is None else context.steps
    teachings = [
        replace(
            trainings["weighted"],
            amplitude=amplitude,
            seed=trainings["weighted"].seed + context.seed,
        )
        for trainings in CYCLES.values()
        for amplitude in _amplitudes(trainings["weighted"].amplitude, context)
    ]
    results = context.run(
        FOLDER,
        probe_loops,
        [
            {"teaching": asdict(each), "noises": NOISES, "factors": FACTORS, "steps": steps}
            for each in teachings
        ],
    )
    cycles: dict[str, list[dict[str, Any]]] = {target: [] for target in CYCLES}
    for teaching, result in zip(teachings, results, strict=True):
        cycles[teaching.target].append(
            {
                "amplitude_deg": teaching.amplitude,
                "disturbances": list(teaching.disturbances),
                "failure": result["failure"],
                "loops": result["loops"],
            }
        )
    return {
        "trials": 1,
        "steps": steps,
        "exponent_turns": RESPONSE_TURNS,
        "phase_error": PHASE_ERROR,
        "response_noises": list(RESPONSE_NOISES),
        "cycles": cycles,
        "verdict": _judge([loop for _, _, loop in _all_loops(cycles)]),
    }


def _amplitudes(own: float, context: Context) -> tuple[float, ...]:
    if context.amplitude is not None:
        return (context.amplitude,)
    return tuple(round(part * own, 6) for part in AMPLITUDES)


def _all_loops(
    cycles: Mapping[str, Sequence[Mapping[str, Any]]],
) -> Iterable[tuple[str, Mapping[str, Any], Mapping[str, Any]]]:
    """Target, entry of its R, and loop."""
    for target, entries in cycles.items():
        for entry in entries:
            for loop in entry["loops"]:
                yield target, entry, loop


def _judge(loops: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """How well the numbers of the loops tell which are held."""
    held = [loop for loop in loops if loop["held"]]
    stable = [loop for loop in loops if is_stable(loop)]
    lost = [loop for loop in stable if not loop["held"]]
    largest = max((loop["training_error"] for loop in held), default=None)
    wrong = [loop for loop in lost if largest is not None and loop["training_error"] > largest]
    far = [loop for loop in lost if is_thrown_far(loop)]
    return {
        "loops": len(loops),
        "held": len(held),
        "stable": len(stable),
        "held_and_stable": sum(is_stable(loop) for loop in held),
        "stable_but_lost": len(lost),
        "of_them_thrown_far": len(far),
        "of_them_error_above_all_held": len(wrong),
        "of_them_neither": sum(not (loop in far or loop in wrong) for loop in lost),
        "largest_error_held": largest,
    }


def tables(result: Mapping[str, Any]) -> list[ResultTable]:
    """Exponents by R, κ and ν, a table a cycle; then the loops that were lost though stable."""
    found = []
    for target, entries in result["cycles"].items():
        rows, notes = [], []
        noises = sorted({loop["noise"] for entry in entries for loop in entry["loops"]})
        for entry in entries:
            if entry["failure"] is not None:
                notes.append(f"R = {entry['amplitude_deg']:g}°: {entry['failure']['message']}.")
            by_factor: dict[float, dict[float, str]] = {}
            for loop in entry["loops"]:
                by_factor.setdefault(loop["factor"], {})[loop["noise"]] = _exponents(loop)
            for factor, cells in by_factor.items():
                rows.append((_weighting(entry, factor), *(cells[noise] for noise in noises)))
        columns = ("R, weighting", *(f"ν = {noise:.0e}" for noise in noises))
        title = (
            f"{CYCLE_LABELS[target]}: leading two exponents (1/s) by ν (m),"
            f" * held for {result['steps']} steps"
        )
        found.append(ResultTable(title, columns, rows, notes))
    return [*found, _lost_though_stable(result)]


def _weighting(entry: Mapping[str, Any], factor: float) -> str:
    return f"{entry['amplitude_deg']:g}°, {factor:g} κ"


def _exponents(loop: Mapping[str, Any]) -> str:
    exponents = loop["exponents"][:2]
    numbers = "/".join(f"{value:.{1 if abs(value) < 10 else 0}f}" for value in exponents)
    return (numbers or "huge") + ("*" if loop["held"] else "")


def _lost_though_stable(result: Mapping[str, Any]) -> ResultTable:
    rows = [
        (
            target,
            _weighting(entry, loop["factor"]),
            f"{loop['noise']:.0e}",
            f"{loop['leading_exponent']:+.2f}",
            f"{loop['training_error']:.1e}",
            *("lost" if value is None else f"{value:.0f}" for value in loop["responses"]),
        )
        for target, entry, loop in _all_loops(result["cycles"])
        if is_stable(loop) and not loop["held"]
    ]
    responses = [f"noise {size:.0e}" for size in result["response_noises"]]
    columns = ("cycle", "R, weighting", "ν (m)", "exponent", "error / R", *responses)
    verdict = result["verdict"]
    notes = [
        f"Of {verdict['loops']} loops {verdict['held']} were held, {verdict['held_and_stable']} of"
        f" them among the {verdict['stable']} that are stable by their exponents.",
        f"Of the {verdict['stable_but_lost']} stable ones that were lost,"
        f" {verdict['of_them_thrown_far']} are thrown farther than {HELD_DISTANCE:g} R by noise of"
        f" {result['response_noises'][-1]:g} R: their deviations leave the small basin before they"
        f" die out. {verdict['of_them_error_above_all_held']} have a larger training error than any"
        f" loop that was held; {verdict['of_them_neither']} neither.",
        "Noise: deviation of the outputs across the orbit, over the noise on them of so many R.",
    ]
    return ResultTable("Lost though stable by their exponents", columns, rows, notes)


def draw(result: Mapping[str, Any], path: Path) -> None:
    """Exponents over ν, a row an R and a column a cycle; below, what became of all loops."""
    from octoarm_agents.experiments.floquet_figure import draw_floquet

    draw_floquet(result, path)


EXPERIMENT = Experiment("floquet", 1, run, draw, tables)
