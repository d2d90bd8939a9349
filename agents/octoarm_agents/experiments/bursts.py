"""What Figures 9 and 10 share: noise on the outputs, and the way back to the cycle (section 3.2).

The paper's ε go through the servo. Noise that is renewed every millisecond on a base that follows
at once is an inertia load of thousands of g: the direct base gets what it can take.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from octoarm_agents.experiments.cycle_settings import CYCLE_LABELS, DIRECT_BURSTS, PAPER_BURSTS
from octoarm_agents.experiments.runner import Context, ResultTable
from octoarm_agents.experiments.task2 import (
    TaughtCycle,
    disturb_all,
    fraction_recovered,
    largest_recovered,
    teach_cycles,
)
from octoarm_agents.experiments.task2_trials import BURST_BEGIN, BURST_END, BURST_RUN

__all__ = ["burst_tables", "count_outcomes", "draw_bursts", "run_bursts"]

_END_STEPS = 6_000
"""Steps of the portrait's last part."""

PAPER = {
    "quadratic": "Recovers even from 10 degrees; the phase is often shifted.",
    "lissajous": "Less robust than the quadratic cycle: recovers below about 0.3 degrees, though"
    " not always; the phase is often shifted.",
}


def run_bursts(context: Context, target: str) -> dict[str, Any]:
    """Disturb a cycle with the paper's ε through the servo, and with smaller ones directly.

    Args:
        context: of the experiment; its trials are seeds of the noise.
        target: name of the limit cycle, one that the paper disturbs.
    """
    cycles = teach_cycles(context, [target])[target]
    sizes = {"servo": PAPER_BURSTS[target], "direct": _direct_bursts(context, cycles["direct"])}
    bases: dict[str, Any] = {}
    for actuator, cycle in reversed(cycles.items()):
        entry = cycle.describe() | {"bursts": []}
        if cycle.failure is None:
            bursts = [(cycle, burst) for burst in sizes[actuator]]
            for (_, burst), trials in zip(
                bursts, disturb_all(context, bursts, series=True), strict=True
            ):
                entry["bursts"].append({"burst_deg": burst} | _summarise(trials))
        bases[actuator] = entry
    return {
        "target": target,
        "trials": context.trials,
        "burst_steps": [BURST_BEGIN, BURST_END],
        "steps": BURST_RUN,
        "bases": bases,
        "paper": PAPER[target],
    }


def _direct_bursts(context: Context, cycle: TaughtCycle) -> tuple[float, ...]:
    """What the direct base recovers from for sure, and less in the paper's proportions."""
    paper = PAPER_BURSTS[cycle.teaching.target]
    if cycle.failure is not None:
        return ()
    results = disturb_all(context, [(cycle, burst) for burst in DIRECT_BURSTS])
    fractions = [fraction_recovered(trials) for trials in results]
    largest = largest_recovered(list(zip(DIRECT_BURSTS, fractions, strict=True)))
    top = DIRECT_BURSTS[0] if largest is None else largest
    return tuple(top * burst / paper[0] for burst in paper)


def _summarise(trials: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What the seeds of one ε gave, and the outputs of the first."""
    seconds = [trial["recovery_seconds"] for trial in trials if trial["recovered"]]
    shifts = [abs(trial["phase_shift"]) for trial in trials if trial["phase_shift"] is not None]
    return {
        "recovered": all(trial["recovered"] for trial in trials),
        "recovered_fraction": fraction_recovered(trials),
        "outcomes": count_outcomes(trials),
        "median_recovery_seconds": float(np.median(seconds)) if seconds else None,
        "median_phase_shift_turns": float(np.median(shifts)) if shifts else None,
        "shown": {name: trials[0][name] for name in ("recovered", "failure", "series")},
    }


def count_outcomes(trials: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """How many disturbed runs ended how: ``recovered``, the failures' reasons, ``off_cycle``."""
    outcomes: dict[str, int] = {}
    for trial in trials:
        if trial["recovered"]:
            name = "recovered"
        elif trial["failure"] is not None:
            name = trial["failure"]["reason"]
        else:
            name = "off_cycle"
        outcomes[name] = outcomes.get(name, 0) + 1
    return outcomes


def burst_tables(result: Mapping[str, Any]) -> list[ResultTable]:
    """What was recovered from, by base and ε."""
    rows = []
    notes = [f"The paper: {result['paper']}"]
    for actuator, entry in result["bases"].items():
        if entry["teaching_failure"] is not None:
            notes.append(f"{actuator}: {entry['teaching_failure']['message']}.")
        for burst in entry["bursts"]:
            seconds, shift = burst["median_recovery_seconds"], burst["median_phase_shift_turns"]
            rows.append(
                (
                    actuator,
                    f"{entry['amplitude_deg']:g}",
                    f"{burst['burst_deg']:.3g}",
                    f"{burst['recovered_fraction']:.0%}",
                    "–" if seconds is None else f"{seconds:.2f}",
                    "–" if shift is None else f"{shift:.3f}",
                )
            )
    columns = ("base", "R (°)", "ε (°)", "recovered", "time to recover (s)", "phase shift (turns)")
    title = f"The {CYCLE_LABELS[result['target']]} under noise, {result['trials']} seeds"
    return [ResultTable(title, columns, rows, notes)]


def draw_bursts(result: Mapping[str, Any], path: Path) -> None:
    """A row an ε: outputs over time around the noise, and the portrait, for both bases."""
    from octoarm_agents.experiments.cycle_figures import (
        draw_outputs,
        draw_portrait,
        explain_outputs,
        say_missing,
    )
    from octoarm_agents.experiments.figures import (
        BLACK,
        ORANGE,
        new_figure,
        save_figure,
        write_letters,
    )

    timestep = result["body"]["timestep"]
    figure = new_figure(13.0, 9.0)
    grid = figure.add_gridspec(3, 4, width_ratios=(2.0, 1.0, 2.0, 1.0))
    panels = []
    for side, (actuator, entry) in enumerate(result["bases"].items()):
        for row in range(3):
            left = figure.add_subplot(grid[row, 2 * side])
            right = figure.add_subplot(grid[row, 2 * side + 1])
            panels += [left, right]
            burst = entry["bursts"][row] if entry["bursts"] else None
            failure = entry["teaching_failure"] if burst is None else burst["shown"]["failure"]
            left.set_title(_title(actuator, burst), fontsize=9)
            if burst is None or (failure is not None and failure["step"] < BURST_BEGIN):
                say_missing(left, failure)
                say_missing(right, failure)
                continue
            series = burst["shown"]["series"]
            draw_outputs(left, series, timestep, burst=True)
            left.set_xlim(timestep * (BURST_BEGIN - 1_500), timestep * (BURST_END + 4_000))
            left.set_xlabel("time in closed loop (s)")
            left.set_ylabel("output (degrees)")
            steps = np.array(series["step"])
            outputs = np.array(series["outputs_deg"])
            disturbed = (steps >= BURST_BEGIN) & (steps < BURST_RUN - _END_STEPS)
            turn = np.array(series["target_deg"])[:, :200]
            curves = [(outputs[:, disturbed], ORANGE)]
            if failure is None:
                curves.append((outputs[:, steps >= BURST_RUN - _END_STEPS], BLACK))
            draw_portrait(right, turn, curves)
    write_letters(panels)
    explain_outputs(
        figure, burst=True, more=[(ORANGE, "noise and way back"), (BLACK, "end of the run")]
    )
    save_figure(figure, path)


def _title(actuator: str, burst: Mapping[str, Any] | None) -> str:
    if burst is None:
        return f"{actuator} base"
    fraction = burst["recovered_fraction"]
    return f"{actuator} base, ε = {burst['burst_deg']:.3g}°: {fraction:.0%} recovered"
