"""Figure 11: noise from which the Lissajous curve does not come back (section 3.2).

The paper shows one such trajectory. Here the lost trials are counted, over many seeds and larger ε.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from octoarm_agents.common.plotting import (
    BLACK,
    GREEN,
    ORANGE,
    PURPLE,
    new_figure,
    write_letters,
)
from octoarm_agents.experiments.cycles.plots import draw_outputs, draw_portrait, explain_outputs
from octoarm_agents.experiments.cycles.taught import (
    FOLDER,
    count_outcomes,
    disturb_cycles,
    fraction_recovered,
    teach_cycles,
)
from octoarm_agents.experiments.cycles.trials import BURST_BEGIN, BURST_END, disturb_cycle
from octoarm_agents.experiments.plots import say_missing
from octoarm_agents.experiments.runner import Experiment, RunSettings
from octoarm_agents.experiments.tables import ResultTable
from octoarm_agents.reservoir.cycles import BURSTS

TARGET = "lissajous"
OUTCOMES = {
    "recovered": "recovered",
    "off_cycle": "not back at the end",
    "domain": "left the domain",
    "jump": "jumped",
    "rest": "came to rest",
}

PAPER = (
    "Above ε of about 0.3 degrees the trajectory often leaves the limit cycle and never comes back;"
    " below, sometimes."
)


def run(settings: RunSettings) -> dict[str, Any]:
    """Count the trials that are lost, and show one."""
    taught = teach_cycles(settings, [TARGET])[TARGET]
    disturbed = disturb_cycles(settings, taught.values(), BURSTS)
    trainings: dict[str, Any] = {}
    example = None
    for (training, cycles), bursts in zip(taught.items(), disturbed, strict=True):
        entry = trainings[training] = cycles[0].describe() | {"bursts": []}
        for burst, trials in bursts:
            lost = [trial["trial"] for trial in trials if not trial["recovered"]]
            entry["bursts"].append(
                {
                    "burst_deg": burst,
                    "lost_fraction": 1 - fraction_recovered(trials),
                    "lost_trials": lost,
                    "outcomes": count_outcomes(trials),
                }
            )
            if lost and example is None:
                cycle = cycles[lost[0] % len(cycles)]
                more = {"burst": burst, "seed": settings.seed, "trial": lost[0], "series": True}
                (again,) = settings.run(FOLDER, disturb_cycle, [cycle.settings | more])
                shown = ("burst_deg", "trial", "failure", "series")
                example = {
                    "training": training,
                    "amplitude_deg": cycle.teaching.amplitude,
                    **{name: again[name] for name in shown},
                }
    return {
        "target": TARGET,
        "trials": settings.trials,
        "burst_steps": [BURST_BEGIN, BURST_END],
        "trainings": trainings,
        "example": example,
        "paper": PAPER,
    }


def tables(result: Mapping[str, Any]) -> list[ResultTable]:
    """The part of the trials that is lost, by base and ε."""
    rows, notes = [], [f"The paper: {result['paper']}"]
    for training, entry in result["trainings"].items():
        if entry["teaching_failure"] is not None:
            notes.append(f"{training}: {entry['teaching_failure']['message']}.")
        for burst in entry["bursts"]:
            outcomes = ", ".join(
                f"{count} {OUTCOMES[name]}" for name, count in burst["outcomes"].items()
            )
            lost = f"{burst['lost_fraction']:.0%}"
            rows.append((training, f"{burst['burst_deg']:g}", lost, outcomes))
    title = f"The Lissajous curve lost, {result['trials']} seeds"
    return [ResultTable(title, ("training", "ε (°)", "lost", "outcomes"), rows, notes)]


def draw(result: Mapping[str, Any]) -> Figure:
    """A lost trial over time and as a portrait; the part lost against ε."""
    timestep, example = result["body"]["timestep"], result["example"]
    figure = new_figure(11.0, 7.0)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.3))
    over_time = figure.add_subplot(grid[0, :])
    portrait, lost = figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1])
    write_letters([over_time, portrait, lost])
    if example is None:
        say_missing(over_time, {"message": "every trial recovered"})
        say_missing(portrait, {"message": "every trial recovered"})
    else:
        series = example["series"]
        draw_outputs(over_time, series, timestep, burst=True, target=False)
        over_time.set_ylabel("output (degrees)", fontsize=9)
        over_time.set_xlim(left=timestep * (BURST_BEGIN - 2_000))
        failure = example["failure"]
        outcome = OUTCOMES["off_cycle" if failure is None else failure["reason"]]
        title = f"{example['training']} training, ε = {example['burst_deg']:g}°"
        over_time.set_title(f"{title}, seed {example['trial']}: {outcome}", fontsize=9)
        steps, outputs = np.array(series["step"]), np.array(series["outputs_deg"])
        curves = [
            (outputs[:, steps >= BURST_BEGIN], ORANGE),
            (outputs[:, (steps >= BURST_BEGIN - 2_000) & (steps < BURST_BEGIN)], BLACK),
        ]
        draw_portrait(portrait, np.array(series["target_deg"])[:, :100], curves)
    for (training, entry), colour, marker in zip(
        result["trainings"].items(), (GREEN, PURPLE), "os", strict=True
    ):
        lost.plot(
            [burst["burst_deg"] for burst in entry["bursts"]],
            [100 * burst["lost_fraction"] for burst in entry["bursts"]],
            color=colour,
            marker=marker,
            markersize=5,
            linewidth=1.2,
            label=f"{training} training, R = {entry['amplitude_deg']:g}°",
        )
    lost.set_xscale("log")
    lost.set(ylim=(-5, 105))
    lost.set_xlabel("half width of the noise ε (degrees)", fontsize=9)
    lost.set_ylabel(f"lost of {result['trials']} trials (%)", fontsize=9)
    lost.legend(fontsize=8, frameon=False)
    explain_outputs(
        figure, burst=True, more=[(BLACK, "before the noise"), (ORANGE, "since the noise began")]
    )
    return figure


FIGURE11 = Experiment("figure11", 15, run, tables, draw)
