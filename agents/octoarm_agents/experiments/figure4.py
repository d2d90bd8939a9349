"""Figure 4: one trial of the emulation tasks over time (section 3.1)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octoarm_agents.experiments.runner import Context, Experiment, ResultTable
from octoarm_agents.experiments.task1 import (
    RANGE,
    TASKS,
    Drive,
    check_timestep,
    fit_readout,
    mean_squared_errors,
    record_lengths,
)
from octoarm_agents.experiments.task1_trials import SPRINGS_PER_COMPARTMENT
from octoarm_agents.reservoir.baselines import linear
from octoarm_agents.reservoir.closed_loop import describe_domain_error
from octoarm_agents.reservoir.inputs import TIMESTEP
from octoarm_env import DomainError

__all__ = ["EXPERIMENT"]

Float = NDArray[np.float64]

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


def run(context: Context) -> dict[str, Any]:
    """Trial 0: input, spring lengths, targets and outputs at the begin of the evaluation phase."""
    check_timestep(context.parameters)
    amplitude = RANGE if context.amplitude is None else context.amplitude
    drive = Drive.make("sines", context.seed, 0)
    begin = drive.test.start
    shown = slice(begin, begin + SHOWN_STEPS, EVERY)
    series: dict[str, Float] = {}
    failure, lengths = None, None
    features = linear(drive.signal)
    try:
        lengths = record_lengths(context.parameters, drive, amplitude)
    except DomainError as error:
        failure = describe_domain_error(error)
    errors = {}
    for method, known in (("linear_regressor", features), ("arm", lengths)):
        if known is not None:
            outputs = fit_readout(known, drive).predict(known[drive.test])
            errors[method] = mean_squared_errors(outputs, drive.targets[drive.test])
            series[method] = outputs[:SHOWN_STEPS:EVERY]
    return {
        "range_deg": amplitude,
        "trials": 1,
        "initial_steps": drive.initial,
        "failure": failure,
        "time_seconds": _plain((np.arange(begin, begin + SHOWN_STEPS, EVERY) - begin) * TIMESTEP),
        "input": _plain(drive.signal[shown]),
        "spring_lengths_metres": None if lengths is None else _plain(lengths[shown].T),
        "tasks": {
            task: {
                "target": _plain(drive.targets[shown, column]),
                **{method: _plain(values[:, column]) for method, values in series.items()},
                "mse": {method: values[task] for method, values in errors.items()},
                "paper_mse": PAPER[task],
            }
            for column, task in enumerate(TASKS)
        },
    }


def _plain(values: Float) -> Any:
    """Numbers for a JSON file, to seven digits: they are for looking at."""
    if values.ndim > 1:
        return [_plain(row) for row in values]
    return [float(f"{value:.7g}") for value in values]


def tables(result: Mapping[str, Any]) -> list[ResultTable]:
    """Errors of this trial beside those of the paper's."""
    rows = []
    for method, name in (("arm", "arm"), ("linear_regressor", "linear regressor")):
        tasks = [result["tasks"][task] for task in TASKS]
        own = [f"{t['mse'][method]:.2e}" if method in t["mse"] else "–" for t in tasks]
        rows.append((name, *own))
        rows.append(("  in the paper", *(f"{t['paper_mse'][method]:.2e}" for t in tasks)))
    notes = [] if result["failure"] is None else [f"Failed: {result['failure']['message']}."]
    return [
        ResultTable(
            f"Mean squared error of the trial shown, R = {result['range_deg']:g}°",
            ("method", "2nd order", "10th order", "Volterra"),
            rows,
            notes,
        )
    ]


def draw(result: Mapping[str, Any], path: Path) -> None:
    """The input, springs 1 to 4 of all compartments, and the three outputs, one above another."""
    from octoarm_agents.common.plotting import (
        BLACK,
        BLUE,
        GREY,
        ORANGE,
        TASK_LABELS,
        VERMILLION,
        new_figure,
        save_figure,
        write_letters,
    )

    figure = new_figure(9.0, 11.5)
    panels = list(figure.subplots(8, 1, sharex=True))
    time = result["time_seconds"]
    panels[0].plot(time, result["input"], color=BLACK, linewidth=1.0)
    panels[0].set_ylabel("In(t)")
    for spring in range(SPRINGS_PER_COMPARTMENT):
        axes = panels[1 + spring]
        axes.set_ylabel(f"length of\nspring {spring + 1} (mm)")
        if result["spring_lengths_metres"] is None:
            message = result["failure"]["message"]
            axes.text(0.5, 0.5, message, transform=axes.transAxes, ha="center", color=GREY)
            continue
        _draw_springs(axes, time, result["spring_lengths_metres"][spring::SPRINGS_PER_COMPARTMENT])
    if result["spring_lengths_metres"] is not None:
        _explain_colours(figure, panels[1 : 1 + SPRINGS_PER_COMPARTMENT], result)
    for axes, task in zip(panels[1 + SPRINGS_PER_COMPARTMENT :], TASKS, strict=True):
        entry = result["tasks"][task]
        axes.plot(time, entry["target"], color=ORANGE, linewidth=3.0, label="target")
        for method, colour, style in (
            ("linear_regressor", VERMILLION, ":"),
            ("arm", BLUE, "-"),
        ):
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
    save_figure(figure, path)


def _draw_springs(axes: Any, time: list[float], lengths: list[list[float]]) -> None:
    """One spring of every compartment, dark at the base, light at the tip."""
    from matplotlib import colormaps

    for index, values in enumerate(lengths):
        colour = colormaps["viridis"](0.92 * index / max(len(lengths) - 1, 1))
        axes.plot(time, 1e3 * np.array(values), color=colour, linewidth=0.6)


def _explain_colours(figure: Any, panels: list[Any], result: Mapping[str, Any]) -> None:
    """A colour bar that tells the compartment."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap

    count = len(result["spring_lengths_metres"]) // SPRINGS_PER_COMPARTMENT
    colours = ListedColormap(
        [colormaps["viridis"](0.92 * k / max(count - 1, 1)) for k in range(count)]
    )
    scale = ScalarMappable(cmap=colours)
    scale.set_clim(0.5, count + 0.5)
    bar = figure.colorbar(scale, ax=panels, aspect=40, pad=0.01)
    bar.set_label("compartment, from the base", fontsize=8)
    bar.set_ticks([1, *range(5, count + 1, 5)])
    bar.ax.tick_params(labelsize=8)


EXPERIMENT = Experiment("figure4", 1, run, draw, tables)
