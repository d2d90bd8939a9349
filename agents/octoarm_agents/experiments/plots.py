"""What the figures of the experiments have in common."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from octoarm_agents.common.plotting import BLUE, GREEN, GREY, ORANGE, VERMILLION

SPRING_COLOURS = (BLUE, ORANGE, GREEN, VERMILLION)
"""Of springs 1 to 4 of a compartment."""


def say_missing(axes: Axes, failure: Mapping[str, Any] | None) -> None:
    """Instead of a curve: why there is none."""
    message = "not reached" if failure is None else textwrap.fill(failure["message"], 28)
    place: dict[str, Any] = {"transform": axes.transAxes, "ha": "center", "va": "center"}
    axes.set_axis_off()
    axes.text(0.5, 0.5, message, color=GREY, fontsize=8, **place)


def number_compartments(axes: Axes, count: int) -> None:
    """Let the horizontal axis be that of the compartments."""
    axes.set_xticks([1, *range(5, count + 1, 5)])
    axes.set_xlabel("compartment, from the base")


def explain_below(figure: Figure, panels: Iterable[Axes], columns: int) -> None:
    """Below all panels, the legend of the first that has one."""
    legends = (axes.get_legend_handles_labels() for axes in panels)
    handles, labels = next((each for each in legends if each[0]), ([], []))
    figure.legend(
        handles, labels, fontsize=9, frameon=False, ncols=columns, loc="outside lower center"
    )
