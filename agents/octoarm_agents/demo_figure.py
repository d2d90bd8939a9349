"""The figure of the demonstration."""

from __future__ import annotations

import textwrap
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.lines import Line2D

from octoarm_agents.common.plotting import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    VERMILLION,
    new_figure,
    write_letters,
)
from octoarm_agents.demo import BURST_STEPS, DemoResult

_AROUND = 2.5
"""Seconds shown of the outputs before the burst and after it."""


def draw_demo(result: DemoResult) -> Figure:
    """Draw what the arm did: orbit, shapes, weights, outputs around the burst, distance.

    A run that ended early is drawn as far as it went.
    """
    figure = new_figure(9.0, 8.6)
    grid = GridSpec(3, 3, figure, height_ratios=(1.45, 1.0, 0.85), width_ratios=(1.15, 1.0, 1.0))
    _draw_orbit(figure.add_subplot(grid[0, 0]), result)
    _draw_shapes(figure.add_subplot(grid[0, 1]), result)
    _draw_weights(figure.add_subplot(grid[0, 2]), result)
    _draw_outputs(figure.add_subplot(grid[1, :]), result)
    _draw_distance(figure.add_subplot(grid[2, :]), result)
    if result.failure is not None:
        message = f"Ended while {result.failure['stage']}: {result.failure['message']}"
        figure.suptitle(textwrap.fill(message, 100), fontsize=9, color=VERMILLION)
    write_letters(figure.axes)
    return figure


def _draw_orbit(axes: Axes, result: DemoResult) -> None:
    """Both outputs against each other, over the target."""
    begin = result.settings.burst_begin
    outputs = result.outputs
    closed = np.vstack((result.orbit, result.orbit[:1]))
    axes.plot(*closed.T, color="black", linewidth=5.0, alpha=0.18, label="target orbit")
    turn = round(result.turn)
    axes.plot(*outputs[begin:].T, color=VERMILLION, linewidth=0.7, label="burst and recovery")
    axes.plot(*outputs[:begin][-2 * turn :].T, color=BLUE, linewidth=1.2, label="before the burst")
    reach = 1.25 * max(
        result.settings.teaching.amplitude, float(np.abs(outputs).max(initial=0.0)) / 1.2
    )
    axes.set(xlim=(-reach, reach), ylim=(-reach, 1.62 * reach))
    ticks = result.settings.teaching.amplitude * np.array((-1.0, -0.5, 0.0, 0.5, 1.0))
    axes.set(xticks=ticks, yticks=ticks)
    axes.set(aspect="equal", xlabel="output 1, θ (degrees)", ylabel="output 2, φ (degrees)")
    axes.legend(fontsize=8, frameon=False, loc="upper center")


def _draw_shapes(axes: Axes, result: DemoResult) -> None:
    """The arm's centre line at equal intervals of one turn, seen along the y-axis, hanging."""
    count = len(result.shapes)
    if not count:
        _say_missing(axes)
    # From dark to light, so that every eye can order them.
    colours = [colormaps["viridis"](0.92 * k / count) for k in range(count)]
    for shape, colour in zip(result.shapes, colours, strict=True):
        x, height = 100 * shape[:, 0], -100 * shape[:, 2]
        axes.plot(x, height, color=colour, linewidth=1.6)
        axes.plot(x[-1:], height[-1:], "o", color=colour, markersize=4)
    axes.plot(0, 0, "s", color="black", markersize=6)
    depth = 100 * float(result.shapes[:, :, 2].max(initial=0.3))
    reach = max(0.5 * depth, 110 * float(np.abs(result.shapes[:, :, 0]).max(initial=0.0)))
    axes.set(xlim=(-reach, reach), ylim=(-1.4 * depth, 0.05 * depth))
    axes.set(aspect="equal", xlabel="x (cm)", ylabel="height above the base (cm)")
    if count:
        handles = [
            Line2D([], [], color=colours[k], marker="o", markersize=4, label=f"{k}/{count}")
            for k in range(0, count, 2)
        ]
        axes.legend(
            handles=handles,
            title="phase (turns)",
            title_fontsize=8,
            fontsize=8,
            frameon=False,
            ncols=2,
            columnspacing=1.0,
            handlelength=1.2,
            loc="lower center",
            bbox_to_anchor=(0.5, 0.0),
        )


def _draw_weights(axes: Axes, result: DemoResult) -> None:
    """The readout: all weights of both outputs by compartment."""
    axes.axhline(0, color=GREY, linewidth=0.8)
    if result.readout is None:
        _say_missing(axes)
    else:
        weights = result.readout.weights_
        compartment = 1 + np.arange(len(weights)) // 4
        for output, colour, marker, shift in ((0, BLUE, "o", -0.16), (1, VERMILLION, "^", 0.16)):
            axes.plot(
                compartment + shift,
                weights[:, output],
                marker,
                color=colour,
                markersize=3.5,
                markeredgewidth=0,
                label=f"output {output + 1}",
            )
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + 0.22 * (high - low))
        axes.legend(fontsize=8, frameon=False, ncols=2, loc="upper center", handletextpad=0.1)
        axes.set_xticks([1, *range(5, int(compartment[-1]) + 1, 5)])
    axes.set(xlabel="compartment", ylabel="readout weight (degrees/m)")


def _draw_outputs(axes: Axes, result: DemoResult) -> None:
    """Both outputs over time around the burst; time counts from the burst's begin."""
    time = _time(result)
    begin, end = -_AROUND, BURST_STEPS * result.parameters.timestep + _AROUND
    if 0 < len(time) < result.settings.burst_begin:  # an early end is shown instead of the burst
        begin, end = max(time[-1] - 2 * _AROUND, time[0]), time[-1] + 0.1
    shown = (time >= begin) & (time <= end)
    _shade_burst(axes, result)
    amplitude = result.settings.teaching.amplitude
    for level in (-amplitude, amplitude):
        axes.axhline(level, color=GREY, linewidth=0.8, linestyle=":")
    for output, colour, label in ((0, BLUE, "output 1, θ"), (1, VERMILLION, "output 2, φ")):
        values = result.outputs[shown, output]
        axes.plot(time[shown], values, color=colour, linewidth=1.1, label=label)
    axes.set(xlim=(begin, end), xlabel="time since the burst began (s)", ylabel="output (degrees)")
    _legend_above(axes)


def _draw_distance(axes: Axes, result: DemoResult) -> None:
    """Distance to the orbit over the whole closed loop."""
    _shade_burst(axes, result)
    time = _time(result)
    turn = round(result.turn)
    each = np.maximum(result.distances, 1e-9)
    axes.semilogy(time, each, color=GREEN, alpha=0.35, linewidth=0.5, label="each step")
    if len(time) > turn:
        mean = np.convolve(result.distances, np.full(turn, 1 / turn), "valid")
        time, label = time[turn - 1 :], "mean of the last turn"
        axes.semilogy(time, mean, color=GREEN, linewidth=1.6, label=label)
    begin = -result.settings.burst_begin * result.parameters.timestep
    axes.set_xlim(begin, begin + result.settings.steps * result.parameters.timestep)
    axes.set_ylim(bottom=1e-5)
    axes.set_xlabel("time since the burst began (s)")
    axes.set_ylabel("distance to\ntarget orbit / R")
    _legend_above(axes)


def _say_missing(axes: Axes) -> None:
    axes.text(0.5, 0.6, "not reached", transform=axes.transAxes, ha="center", color=GREY)


def _legend_above(axes: Axes) -> None:
    axes.legend(fontsize=8, frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 0.98))


def _shade_burst(axes: Axes, result: DemoResult) -> None:
    length = BURST_STEPS * result.parameters.timestep
    label = f"white noise of ±{result.settings.burst:g}° on both outputs"
    axes.axvspan(0, length, color=ORANGE, alpha=0.25, linewidth=0, label=label)


def _time(result: DemoResult) -> Any:
    """Seconds since the burst began, one for each output."""
    steps = np.arange(len(result.outputs)) - result.settings.burst_begin
    return steps * result.parameters.timestep
