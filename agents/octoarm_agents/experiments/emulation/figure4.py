"""Figure 4: one trial of the emulation tasks over time (section 3.1)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from octoarm_agents.common.plotting import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    TASK_LABELS,
    VERMILLION,
    new_figure,
    shades,
    write_letters,
)
from octoarm_agents.experiments.emulation.protocol import (
    RANGE,
    TASK_HEADINGS,
    TASKS,
    TrialInput,
    fit_readout,
    mean_squared_errors,
    record_many,
)
from octoarm_agents.experiments.emulation.trials import SPRINGS_PER_COMPARTMENT
from octoarm_agents.experiments.runner import Experiment, RunSettings, round_numbers
from octoarm_agents.experiments.tables import ResultTable, format_number
from octoarm_agents.reservoir.baselines import powers
from octoarm_agents.reservoir.closed_loop import describe_domain_error
from octoarm_agents.reservoir.inputs import TIMESTEP
from octoarm_env import Arm, DomainError

SHOWN_STEPS = 3_000
EVERY = 5
"""Timesteps of the evaluation phase that are shown, and every how many of them: the input has
nothing above 10 Hz."""

PAPER = {
    "second_order": {"arm": 1.89e-7, "linear_regressor": 9.96e-7},
    "tenth_order": {"arm": 3.80e-6, "linear_regressor": 4.95e-4},
    "volterra": {"arm": 8.90e-5, "linear_regressor": 9.48e-4},
}
"""Mean squared errors in the caption of Figure 4."""


def run(settings: RunSettings) -> dict[str, Any]:
    """Trial 0: input, spring lengths, targets and outputs at the begin of the evaluation phase."""
    amplitude = RANGE if settings.amplitude is None else settings.amplitude
    drive = TrialInput.make("sines", settings.seed, 0)
    begin = drive.test.start
    shown = slice(begin, begin + SHOWN_STEPS, EVERY)
    (lengths,) = record_many([Arm(settings.parameters)], [drive], [amplitude])
    known = {"linear_regressor": powers(drive.signal, 1)}
    failure = None
    if isinstance(lengths, DomainError):
        failure = describe_domain_error(lengths)
    else:
        known["arm"] = lengths
    errors, series = {}, {}
    for method, features in known.items():
        outputs = fit_readout(features, drive).predict(features[drive.test])
        errors[method] = mean_squared_errors(outputs, drive.targets[drive.test])
        series[method] = outputs[:SHOWN_STEPS:EVERY]
    return {
        "range_deg": amplitude,
        "trials": 1,
        "initial_steps": drive.initial,
        "failure": failure,
        "time_seconds": round_numbers(np.arange(0, SHOWN_STEPS, EVERY) * TIMESTEP),
        "input": round_numbers(drive.signal[shown]),
        "spring_lengths_metres": round_numbers(known["arm"][shown].T) if "arm" in known else None,
        "tasks": {
            task: {
                "target": round_numbers(drive.targets[shown, column]),
                **{method: round_numbers(values[:, column]) for method, values in series.items()},
                "mse": {method: values[task] for method, values in errors.items()},
                "paper_mse": PAPER[task],
            }
            for column, task in enumerate(TASKS)
        },
    }


def tables(result: Mapping[str, Any]) -> list[ResultTable]:
    """Errors of this trial beside those of the paper's."""
    rows = []
    for method, name in (("arm", "arm"), ("linear_regressor", "linear regressor")):
        tasks = [result["tasks"][task] for task in TASKS]
        rows.append((name, *(format_number(task["mse"].get(method)) for task in tasks)))
        rows.append(("  in the paper", *(f"{t['paper_mse'][method]:.2e}" for t in tasks)))
    notes = [] if result["failure"] is None else [f"Failed: {result['failure']['message']}."]
    title = f"Mean squared error of the trial shown, R = {result['range_deg']:g}°"
    return [ResultTable(title, ("method", *TASK_HEADINGS), rows, notes)]


def draw(result: Mapping[str, Any]) -> Figure:
    """The input, springs 1 to 4 of all compartments, and the three outputs, one above another."""
    figure = new_figure(9.0, 11.5)
    panels = list(figure.subplots(8, 1, sharex=True))
    top, springs, outputs = panels[0], panels[1:5], panels[5:]
    time, lengths = result["time_seconds"], result["spring_lengths_metres"]
    top.plot(time, result["input"], color=BLACK, linewidth=1.0)
    top.set_ylabel("In(t)")
    for spring, axes in enumerate(springs):
        axes.set_ylabel(f"length of\nspring {spring + 1} (mm)")
        if lengths is None:
            message = result["failure"]["message"]
            axes.text(0.5, 0.5, message, transform=axes.transAxes, ha="center", color=GREY)
            continue
        rows = lengths[spring::SPRINGS_PER_COMPARTMENT]
        for values, shade in zip(rows, shades(len(rows)), strict=True):
            axes.plot(time, 1e3 * np.array(values), color=shade, linewidth=0.6)
    if lengths is not None:
        count = len(lengths) // SPRINGS_PER_COMPARTMENT
        scale = ScalarMappable(cmap=ListedColormap(shades(count)))
        scale.set_clim(0.5, count + 0.5)
        bar = figure.colorbar(scale, ax=springs, aspect=40, pad=0.01)
        bar.set_label("compartment, from the base", fontsize=8)
        bar.set_ticks([1, *range(5, count + 1, 5)])
        bar.ax.tick_params(labelsize=8)
    for axes, task in zip(outputs, TASKS, strict=True):
        entry = result["tasks"][task]
        axes.plot(time, entry["target"], color=ORANGE, linewidth=3.0, label="target")
        for method, colour, style in (("linear_regressor", VERMILLION, ":"), ("arm", BLUE, "-")):
            if method in entry:
                label = f"{method.replace('_', ' ')}, error {entry['mse'][method]:.2e}"
                axes.plot(time, entry[method], style, color=colour, linewidth=1.1, label=label)
        axes.set_ylabel(TASK_LABELS[task].replace(" ", "\n"))
        axes.margins(y=0.25)
        axes.legend(fontsize=7, frameon=False, ncols=3, loc="upper right", borderaxespad=0.1)
    panels[-1].set_xlim(time[0], time[-1])
    panels[-1].set_xlabel("time since the evaluation phase began (s)")
    write_letters(panels)
    for axes in panels:
        axes.title.set_fontsize(8)
    return figure


FIGURE4 = Experiment("figure4", 1, run, tables, draw)
