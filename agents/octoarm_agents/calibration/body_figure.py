"""The picture of a search for the body."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from octoarm_agents.calibration.evaluation import Evaluation
from octoarm_agents.calibration.space import OPEN_NUMBERS, READINGS, SearchSpace
from octoarm_agents.common.plotting import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    TASK_COLOURS,
    TASK_LABELS,
    VERMILLION,
    new_figure,
    write_letters,
)

_SPACE_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILLION, BLACK, GREY)

_PANELS = 3
"""Panels a row below."""


def draw_calibration(tried: Sequence[Evaluation], spaces: Sequence[SearchSpace]) -> Figure:
    """Above, errors against evaluations; below, the score against every parameter searched.

    Args:
        tried: evaluations, see `search_bodies`; at least one without failure.
        spaces: that were searched.
    """
    scatters = [*OPEN_NUMBERS, *(("gravity",) if spaces[0].tilt else ())]
    rows = math.ceil(len(scatters) / _PANELS)
    figure = new_figure(11.0, 3.6 + 3.2 * rows)
    grid = figure.add_gridspec(1 + rows, _PANELS)
    above = figure.add_subplot(grid[0, :])
    below = [
        figure.add_subplot(grid[1 + index // _PANELS, index % _PANELS])
        for index in range(len(scatters))
    ]
    _draw_ratios(above, tried)
    for axes, name in zip(below, scatters, strict=True):
        _draw_scatter(axes, name, tried, spaces)
    below[0].legend(fontsize=7, frameon=False)
    write_letters([above, *below])
    return figure


def _draw_ratios(axes: Axes, tried: Sequence[Evaluation]) -> None:
    """Ratios of every body in the order tried, and those of the best so far as lines."""
    leaders, leader, best = [], dict[str, float](), math.inf
    for each in tried:
        if each.failure is None and each.score < best:
            leader, best = each.ratios or {}, each.score
        leaders.append(leader)
    for task, colour in TASK_COLOURS.items():
        points = [(k, each.ratios[task]) for k, each in enumerate(tried) if each.ratios is not None]
        x, y = zip(*points, strict=True)
        axes.scatter(x, y, s=9, color=colour, alpha=0.5, linewidths=0)
        axes.step(
            range(len(tried)),
            [ratios.get(task, math.nan) for ratios in leaders],
            where="post",
            color=colour,
            linewidth=1.4,
            label=TASK_LABELS[task],
        )
    failures = [k for k, each in enumerate(tried) if each.failure is not None]
    _draw_failures(axes, failures, label="left its domain" if failures else None)
    axes.axhline(1.0, color=GREY, linestyle=":", linewidth=1.0)
    axes.set(xlabel="evaluation (line: the best body so far)", ylabel="error / that of Table 2")
    axes.set_yscale("log")
    axes.legend(fontsize=8, frameon=False, ncols=4, loc="lower right", bbox_to_anchor=(1.0, 1.0))


def _draw_scatter(
    axes: Axes, name: str, tried: Sequence[Evaluation], spaces: Sequence[SearchSpace]
) -> None:
    """Score against one parameter, a colour a space."""
    for number, space in enumerate(spaces):
        points = [
            (_abscissa(name, each.body), each.score)
            for each in tried
            if space.holds(each.body) and each.failure is None
        ]
        if points:
            colour = _SPACE_COLOURS[number % len(_SPACE_COLOURS)]
            x, y = zip(*points, strict=True)
            label = _label(space, spaces)
            axes.scatter(x, y, s=7, alpha=0.6, linewidths=0, color=colour, label=label)
    _draw_failures(axes, [_abscissa(name, each.body) for each in tried if each.failure is not None])
    if name in OPEN_NUMBERS:
        bounds = OPEN_NUMBERS[name]
        axes.set_xscale("log" if bounds.logarithmic else "linear")
        axes.set_xlabel(f"{name} ({bounds.unit})" if bounds.unit else name)
    else:
        axes.set_xlabel("tilt of gravity from the arm (degrees)")
    axes.set_ylabel("score")


def _draw_failures(axes: Axes, at: Sequence[float], label: str | None = None) -> None:
    """Strokes at the upper edge."""
    heights, transform = np.full(len(at), 0.97), axes.get_xaxis_transform()
    axes.plot(at, heights, "|", color=GREY, markersize=6, transform=transform, label=label)


def _abscissa(name: str, body: Mapping[str, Any]) -> float:
    if name != "gravity":
        return float(body[name])
    x, y, z = body[name]
    return math.degrees(math.atan2(math.hypot(x, y), z))


def _label(space: SearchSpace, spaces: Sequence[SearchSpace]) -> str:
    """What tells a space from the others."""
    parts = [f"lift {space.lift_scale:+g}"]
    for name in READINGS[1:]:
        if len({getattr(each, name) for each in spaces}) > 1:
            parts.append(getattr(space, name))
    return ", ".join(parts)
