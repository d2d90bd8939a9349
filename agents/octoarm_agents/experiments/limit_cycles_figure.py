"""The figure of the limit cycles in closed loop."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib import colormaps
from matplotlib.axes import Axes

from octoarm_agents.experiments.cycle_figures import (
    draw_outputs,
    draw_portrait,
    explain_outputs,
    say_missing,
)
from octoarm_agents.experiments.cycle_settings import CYCLE_LABELS
from octoarm_agents.experiments.figures import BLUE, new_figure, save_figure, write_letters

__all__ = ["draw_limit_cycles"]

_TITLES = ("after release", "at the end, target in phase", "at the end", "at the end")


def draw_limit_cycles(result: Mapping[str, Any], path: Path) -> None:
    """A row a cycle: outputs after release and at the end, phase portrait, lengths."""
    timestep = result["body"]["timestep"]
    figure = new_figure(13.0, 10.5)
    grid = figure.add_gridspec(3, 4, width_ratios=(1.5, 1.5, 1.0, 1.5))
    panels = []
    for row, (target, entry) in enumerate(result["cycles"].items()):
        axes = [figure.add_subplot(grid[row, column]) for column in range(4)]
        panels += axes
        failure = entry["teaching_failure"] or entry["failure"]
        series = entry["series"]
        for index in range(2):
            if index < len(series):
                draw_outputs(axes[index], series[index], timestep)
            else:
                say_missing(axes[index], failure)
        if len(series) == 2:
            _draw_end(axes[2], entry)
            _draw_lengths(axes[3], series[1], timestep)
        else:
            say_missing(axes[2], failure)
            say_missing(axes[3], failure)
        base = f"direct base, R = {entry['amplitude_deg']:g}°"
        axes[0].set_ylabel(f"{CYCLE_LABELS[target]}\n{base}\noutput (degrees)")
        for each in (axes[0], axes[1], axes[3]):
            each.set_xlabel("time in closed loop (s)")
    write_letters(panels)
    for panel, title in zip(panels, _TITLES, strict=False):
        panel.set_title(title, fontsize=9)
    explain_outputs(figure)
    save_figure(figure, path)


def _draw_end(axes: Axes, entry: Mapping[str, Any]) -> None:
    """Portrait of the end of the run."""
    series = entry["series"][1]
    draw_portrait(axes, series["target_deg"], [(series["outputs_deg"], BLUE)])
    distance = entry["orbit_distance_mean"]
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
