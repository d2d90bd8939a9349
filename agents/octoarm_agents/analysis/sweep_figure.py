"""The figure of a sweep: each measure against the swept quantity."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from octoarm_agents.analysis.figure import analysis_figure
from octoarm_agents.analysis.sweep import QUANTITIES, Quantity, SweepPoint
from octoarm_agents.common.plotting import BLUE, GREEN, GREY, VERMILLION, shades, write_letters


def draw_sweep(quantity: Quantity, points: Sequence[SweepPoint]) -> Figure:
    """Draw memory, capacities, ranks, Lyapunov exponent and decay time; failures as crosses."""
    figure = analysis_figure(11.0, 6.8)
    memory, processing, ranks, lyapunov, echo, notes = figure.subplots(2, 3).ravel()
    points = sorted(points, key=lambda point: point.value)
    _draw_lines(memory, points, {"memory_capacity": ("MC", BLUE)}, "memory capacity")
    _draw_degrees(processing, points)
    _draw_lines(
        ranks,
        points,
        {
            "rank_at_tolerance": ("states", BLUE),
            "kernel_rank": ("different streams (kernel)", GREEN),
            "generalisation_rank": ("similar streams (generalisation)", VERMILLION),
            "participation_ratio": ("participation ratio of the states", GREY),
        },
        "rank",
    )
    _draw_lyapunov(lyapunov, points)
    _draw_lines(
        echo, points, {"echo_decay_time_seconds": ("decay time", BLUE)}, "echo decay time (s)"
    )
    for axes in (memory, processing, ranks, lyapunov, echo):
        _finish_axis(axes, quantity, points)
    write_letters(figure.axes[:-1])
    _write_failures(notes, points)
    return figure


def _column(points: Sequence[SweepPoint], name: str) -> tuple[list[float], list[float]]:
    """Values of the quantity and of one figure, where there is one."""
    found = [
        (point.value, point.summary[name])
        for point in points
        if point.summary is not None and point.summary[name] is not None
    ]
    return [value for value, _ in found], [figure for _, figure in found]


def _draw_lines(
    axes: Axes, points: Sequence[SweepPoint], lines: dict[str, tuple[str, str]], label: str
) -> None:
    for name, (legend, colour) in lines.items():
        axes.plot(*_column(points, name), "o-", color=colour, markersize=4, label=legend)
    axes.set_ylim(0, 1.08 * max(axes.get_ylim()[1], 1e-3))
    axes.set_ylabel(label)
    if len(lines) > 1:
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + 0.35 * (high - low))
        axes.legend(fontsize=8, frameon=False, loc="upper left")


def _draw_degrees(axes: Axes, points: Sequence[SweepPoint]) -> None:
    values, rows = _column(points, "capacity_by_degree")
    axes.set_ylabel("information processing capacity")
    if not values:
        return
    table = np.array(rows).T
    labels = [f"degree {k}" for k in range(1, len(table) + 1)]
    labels[0] = "degree 1 (linear)"
    axes.stackplot(values, table, colors=shades(len(table)), labels=labels, alpha=0.9)
    axes.plot(values, table.sum(axis=0), "o", color="black", markersize=3)
    # Room for the legend above the areas, which fill the panel from side to side.
    axes.set_ylim(0, 1.5 * float(table.sum(axis=0).max()) + 1e-3)
    axes.legend(fontsize=8, frameon=False, loc="upper left", ncols=2, reverse=True)


def _draw_lyapunov(axes: Axes, points: Sequence[SweepPoint]) -> None:
    values, exponents = _column(points, "lyapunov_exponent_per_second")
    errors = _column(points, "lyapunov_standard_error_per_second")[1]
    axes.axhline(0, color=GREY, linewidth=0.9)
    axes.errorbar(values, exponents, errors, fmt="o-", color=BLUE, markersize=4, capsize=3)
    axes.set_ylabel("largest conditional\nLyapunov exponent (1/s)")


def _finish_axis(axes: Axes, quantity: Quantity, points: Sequence[SweepPoint]) -> None:
    values = [point.value for point in points]
    failed = [point.value for point in points if point.summary is None]
    if failed:  # a line without points has no size, which the layout cannot do with
        axes.plot(
            failed,
            [0.03] * len(failed),
            "x",
            color=VERMILLION,
            markersize=8,
            markeredgewidth=2,
            transform=axes.get_xaxis_transform(),
            clip_on=False,
            zorder=5,
        )
    axes.set_xscale("log")
    axes.set_xlim(values[0] / 1.2, values[-1] * 1.2)
    axes.set_xticks(values, [f"{value:g}" for value in values])
    axes.minorticks_off()
    axes.set_xlabel(QUANTITIES[quantity])


def _write_failures(axes: Axes, points: Sequence[SweepPoint]) -> None:
    axes.axis("off")
    lines = [
        textwrap.fill(f"× {point.value:g}: {point.failure}", 46)
        for point in points
        if point.failure is not None
    ]
    if lines:
        text = "\n".join(["Could not be measured:", *lines])
        axes.text(0, 1, text, va="top", fontsize=8, color=VERMILLION, transform=axes.transAxes)
