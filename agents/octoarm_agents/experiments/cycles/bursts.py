"""Figures 9 and 10: noise on the outputs, and the way back to the cycle (section 3.2)."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from octoarm_agents.common.plotting import BLACK, ORANGE, new_figure, write_letters
from octoarm_agents.experiments.cycles.plots import draw_outputs, draw_portrait, explain_outputs
from octoarm_agents.experiments.cycles.taught import (
    TRIALS,
    count_outcomes,
    disturb_cycles,
    fraction_recovered,
    teach_cycles,
)
from octoarm_agents.experiments.cycles.trials import BURST_BEGIN, BURST_END, BURST_RUN
from octoarm_agents.experiments.plots import say_missing
from octoarm_agents.experiments.runner import Experiment, RunSettings
from octoarm_agents.experiments.tables import ResultTable, format_number
from octoarm_agents.reservoir.cycles import CYCLE_LABELS, PAPER_BURSTS

_END_STEPS = 6_000
"""Steps of the portrait's last part."""

PAPER = {
    "quadratic": "Recovers even from 10 degrees; the phase is often shifted.",
    "lissajous": "Less robust than the quadratic cycle: recovers below about 0.3 degrees, though"
    " not always; the phase is often shifted.",
}


def run(target: str, settings: RunSettings) -> dict[str, Any]:
    """Disturb a cycle, taught as in the paper and by the weighted ridge, with the paper's ε."""
    taught = teach_cycles(settings, [target])[target]
    disturbed = disturb_cycles(settings, taught.values(), PAPER_BURSTS[target])
    return {
        "target": target,
        "trials": settings.trials,
        "burst_steps": [BURST_BEGIN, BURST_END],
        "steps": BURST_RUN,
        "trainings": {
            training: cycles[0].describe()
            | {"bursts": [{"burst_deg": burst} | _summarise(trials) for burst, trials in bursts]}
            for (training, cycles), bursts in zip(taught.items(), disturbed, strict=True)
        },
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


def tables(result: Mapping[str, Any]) -> list[ResultTable]:
    """What was recovered from, by training and ε."""
    rows = []
    notes = [f"The paper: {result['paper']}"]
    for training, entry in result["trainings"].items():
        if entry["teaching_failure"] is not None:
            notes.append(f"{training}: {entry['teaching_failure']['message']}.")
        for burst in entry["bursts"]:
            rows.append(
                (
                    training,
                    f"{entry['amplitude_deg']:g}",
                    f"{burst['burst_deg']:.3g}",
                    f"{burst['recovered_fraction']:.0%}",
                    format_number(burst["median_recovery_seconds"], ".2f"),
                    format_number(burst["median_phase_shift_turns"], ".3f"),
                )
            )
    told = ("recovered", "time to recover (s)", "phase shift (turns)")
    title = f"The {CYCLE_LABELS[result['target']]} under noise, {result['trials']} seeds"
    return [ResultTable(title, ("training", "R (°)", "ε (°)", *told), rows, notes)]


def draw(result: Mapping[str, Any]) -> Figure:
    """A row an ε: outputs over time around the noise, and the portrait, for both trainings."""
    timestep = result["body"]["timestep"]
    figure = new_figure(13.0, 9.0)
    grid = figure.add_gridspec(3, 4, width_ratios=(2.0, 1.0, 2.0, 1.0))
    panels = []
    for side, (training, entry) in enumerate(result["trainings"].items()):
        for row in range(3):
            left, right = (figure.add_subplot(grid[row, 2 * side + k]) for k in range(2))
            panels += [left, right]
            burst = entry["bursts"][row] if entry["bursts"] else None
            failure = entry["teaching_failure"] if burst is None else burst["shown"]["failure"]
            title = f"{training} training"
            if burst is not None:
                title += (
                    f", ε = {burst['burst_deg']:.3g}°: {burst['recovered_fraction']:.0%} recovered"
                )
            left.set_title(title, fontsize=9)
            if burst is None or (failure is not None and failure["step"] < BURST_BEGIN):
                say_missing(left, failure)
                say_missing(right, failure)
                continue
            series = burst["shown"]["series"]
            draw_outputs(left, series, timestep, burst=True)
            left.set_ylabel("output (degrees)")
            left.set_xlim(timestep * (BURST_BEGIN - 1_500), timestep * (BURST_END + 4_000))
            steps, outputs = np.array(series["step"]), np.array(series["outputs_deg"])
            disturbed = (steps >= BURST_BEGIN) & (steps < BURST_RUN - _END_STEPS)
            curves = [(outputs[:, disturbed], ORANGE)]
            if failure is None:
                curves.append((outputs[:, steps >= BURST_RUN - _END_STEPS], BLACK))
            draw_portrait(right, np.array(series["target_deg"])[:, :200], curves)
    write_letters(panels)
    explain_outputs(
        figure, burst=True, more=[(ORANGE, "noise and way back"), (BLACK, "end of the run")]
    )
    return figure


FIGURE9 = Experiment("figure9", TRIALS, functools.partial(run, "quadratic"), tables, draw)
FIGURE10 = Experiment("figure10", TRIALS, functools.partial(run, "lissajous"), tables, draw)
