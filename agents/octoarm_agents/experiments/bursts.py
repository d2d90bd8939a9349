"""What Figures 9 and 10 share: noise on the outputs, and the way back to the cycle (3.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from octoarm_agents.experiments.cycle_settings import CYCLE_LABELS, PAPER_BURSTS
from octoarm_agents.experiments.runner import Context, ResultTable
from octoarm_agents.experiments.task2 import disturb_all, fraction_recovered, teach_cycles
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
    """Disturb a cycle, taught as in the paper and by the weighted ridge, with the paper's ε.

    Args:
        context: of the experiment; its trials are seeds of the noise.
        target: name of the limit cycle, one that the paper disturbs.
    """
    trainings: dict[str, Any] = {}
    for training, cycles in teach_cycles(context, [target])[target].items():
        entry = cycles[0].describe() | {"bursts": []}
        if cycles[0].failure is None:
            bursts = [(cycles, burst) for burst in PAPER_BURSTS[target]]
            for (_, burst), trials in zip(
                bursts, disturb_all(context, bursts, series=True), strict=True
            ):
                entry["bursts"].append({"burst_deg": burst} | _summarise(trials))
        trainings[training] = entry
    return {
        "target": target,
        "trials": context.trials,
        "burst_steps": [BURST_BEGIN, BURST_END],
        "steps": BURST_RUN,
        "trainings": trainings,
        "paper": PAPER[target],
    }


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
    for training, entry in result["trainings"].items():
        if entry["teaching_failure"] is not None:
            notes.append(f"{training}: {entry['teaching_failure']['message']}.")
        for burst in entry["bursts"]:
            seconds, shift = burst["median_recovery_seconds"], burst["median_phase_shift_turns"]
            rows.append(
                (
                    training,
                    f"{entry['amplitude_deg']:g}",
                    f"{burst['burst_deg']:.3g}",
                    f"{burst['recovered_fraction']:.0%}",
                    "–" if seconds is None else f"{seconds:.2f}",
                    "–" if shift is None else f"{shift:.3f}",
                )
            )
    columns = (
        "training",
        "R (°)",
        "ε (°)",
        "recovered",
        "time to recover (s)",
        "phase shift (turns)",
    )
    title = f"The {CYCLE_LABELS[result['target']]} under noise, {result['trials']} seeds"
    return [ResultTable(title, columns, rows, notes)]


def draw_bursts(result: Mapping[str, Any], path: Path) -> None:
    """A row an ε: outputs over time around the noise, and the portrait, for both trainings."""
    from octoarm_agents.common.plotting import (
        BLACK,
        ORANGE,
        new_figure,
        save_figure,
        write_letters,
    )
    from octoarm_agents.experiments.cycle_figures import (
        draw_outputs,
        draw_portrait,
        explain_outputs,
        say_missing,
    )

    timestep = result["body"]["timestep"]
    figure = new_figure(13.0, 9.0)
    grid = figure.add_gridspec(3, 4, width_ratios=(2.0, 1.0, 2.0, 1.0))
    panels = []
    for side, (training, entry) in enumerate(result["trainings"].items()):
        for row in range(3):
            left = figure.add_subplot(grid[row, 2 * side])
            right = figure.add_subplot(grid[row, 2 * side + 1])
            panels += [left, right]
            burst = entry["bursts"][row] if entry["bursts"] else None
            failure = entry["teaching_failure"] if burst is None else burst["shown"]["failure"]
            left.set_title(_title(training, burst), fontsize=9)
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


def _title(training: str, burst: Mapping[str, Any] | None) -> str:
    if burst is None:
        return f"{training} training"
    fraction = burst["recovered_fraction"]
    return f"{training} training, ε = {burst['burst_deg']:.3g}°: {fraction:.0%} recovered"
