"""The figure of the limit cycles in closed loop."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib import colormaps
from matplotlib.axes import Axes

from octoarm_agents.common.plotting import BLUE, GREEN, new_figure, save_figure, write_letters
from octoarm_agents.experiments.cycle_figures import (
    draw_outputs,
    draw_portrait,
    explain_outputs,
    say_missing,
)
from octoarm_agents.experiments.cycle_settings import CYCLE_LABELS

__all__ = ["draw_limit_cycles"]

_TITLES = (
    "plain training: after release",
    "at the end, target in phase",
    "at the end",
    "weighted ridge: at the end",
    "plain training: at the end",
)


def draw_limit_cycles(result: Mapping[str, Any], path: Path) -> None:
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
        for each in (axes[0], axes[1], axes[4]):
            each.set_xlabel("time in closed loop (s)")
    write_letters(panels)
    for panel, title in zip(panels, _TITLES, strict=False):
        panel.set_title(title, fontsize=9)
    explain_outputs(figure)
    save_figure(figure, path)


def _draw_end(axes: Axes, series: Mapping[str, Any], distance: float | None, colour: str) -> None:
    """Portrait of the end of a run."""
    draw_portrait(axes, series["target_deg"], [(series["outputs_deg"], colour)])
    if distance is not None:
        axes.set_xlabel(f"output 1 (degrees)\nmean distance {distance:.5f} R")


def _draw_lengths(axes: Axes, series: Mapping[str, Any], timestep: float) -> None:
    """Spring 1 of some compartments."""
    time = [timestep * step for step in series["step"]]
    count = len(series["compartments"])
    for index, values in enumerate(series["lengths_metres"]):
        colour = colormaps["viridis"](0.92 * index / max(count - 1, 1))
        label = f"{series['compartments'][index]}"
        axes.plot(time, [1e3 * v for v in values], color=colour, linewidth=1.0, label=label)
    axes.margins(x=0.0)
    axes.ticklabel_format(axis="x", useOffset=False)
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
