"""The figures of the comparison."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from octoarm_agents.common.plotting import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    new_figure,
)
from octoarm_env import LIMIT_CYCLES

__all__ = ["PICTURES"]

_COLOURS = {
    "readout_pinv": SKY,
    "readout_ridge": BLUE,
    "linear_search": ORANGE,
    "ppo": VERMILLION,
    "sac": GREEN,
    "tqc": PURPLE,
    "recurrent_ppo": "#8C510A",
    "hold": GREY,
    "clock": BLACK,
}
_MARKERS = dict(zip(_COLOURS, "osv^D<>xP", strict=True))
_TITLES = {
    "quadratic": "quadratic cycle",
    "van_der_pol": "Van der Pol cycle",
    "lissajous": "Lissajous curve",
}

_LARGEST = 500.0


def draw_curves(result: Mapping[str, Any]) -> Figure:
    """Return over environment steps, with what a readout needs and earns."""
    targets = result["settings"]["targets"]
    figure = new_figure(4.2 * len(targets), 3.9)
    panels = figure.subplots(1, len(targets), sharey=True, squeeze=False)[0]
    for axes, target in zip(panels, targets, strict=True):
        rows = [row for row in result["rows"] if row["target"] == target]
        readouts = [row for row in rows if row["agent"].startswith("readout")]
        if readouts:
            axes.axvline(result["settings"]["teaching_steps"], color=BLUE, linestyle=":")
            best = max(row["return"]["iqm"] for row in readouts)
            axes.axhline(best, color=BLUE, linestyle=":")
        for row in rows:
            if row["curves"]:
                _draw_curve(axes, row)
        axes.set(xscale="log", title=_TITLES[target], xlabel="environment steps", ylim=(-15, 510))
        _plain(axes)
    panels[0].set_ylabel("return of 500, judging seeds")
    handles = [
        Line2D([], [], color=_COLOURS[agent], label=agent)
        for agent in _COLOURS
        if any(row["agent"] == agent and row["curves"] for row in result["rows"])
    ]
    handles.append(
        Line2D([], [], color=BLUE, linestyle=":", label="readouts: their samples, their return")
    )
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=6 if len(targets) > 1 else 2,
        fontsize=8,
        frameon=False,
    )
    return figure


def _draw_curve(axes: Axes, row: Mapping[str, Any]) -> None:
    """Median over trainings, and the band from the worst to the best."""
    count = min(len(curve) for curve in row["curves"])
    steps = np.median([[p["steps"] for p in curve[:count]] for curve in row["curves"]], axis=0)
    returns = np.array([[p["return"] for p in curve[:count]] for curve in row["curves"]])
    colour = _COLOURS[row["agent"]]
    axes.fill_between(steps, returns.min(axis=0), returns.max(axis=0), color=colour, alpha=0.15)
    axes.plot(steps, np.median(returns, axis=0), color=colour, linewidth=1.5)


def draw_returns(result: Mapping[str, Any]) -> Figure:
    """What is missing to the largest return: interquartile means, intervals, single trainings."""
    targets = result["settings"]["targets"]
    figure = new_figure(4.2 * len(targets), 3.6)
    panels = figure.subplots(1, len(targets), sharey=True, sharex=True, squeeze=False)[0]
    for axes, target in zip(panels, targets, strict=True):
        rows = [row for row in result["rows"] if row["target"] == target]
        names = [row["agent"] for row in rows]
        for place, row in enumerate(rows):
            entry, colour = row["return"], _COLOURS[row["agent"]]
            missing = [_LARGEST - value for value in entry["values"]]
            axes.plot(missing, [place] * len(missing), ".", color=colour, alpha=0.4, markersize=5)
            ends = [_LARGEST - entry["high"], _LARGEST - entry["low"]]
            axes.plot(ends, [place, place], color=colour, linewidth=2)
            axes.plot(_LARGEST - entry["iqm"], place, _MARKERS[row["agent"]], color=colour)
        axes.set(xscale="log", title=_TITLES[target], xlabel="return missing to 500")
        axes.set_yticks(range(len(names)), names)
        axes.grid(axis="x", alpha=0.3)
        _plain(axes)
    panels[0].invert_yaxis()
    return figure


def draw_robustness(result: Mapping[str, Any]) -> Figure:
    """Return over noise, recovery over pushes, distance on other bodies; with intervals."""
    targets = result["settings"]["targets"]
    figure = new_figure(4.2 * len(targets), 9.4)
    panels = figure.subplots(3, len(targets), sharey="row", squeeze=False)
    for column, target in enumerate(targets):
        rows = [row for row in result["rows"] if row["target"] == target]
        shifts = np.linspace(-1, 1, len(rows))
        for shift, row in zip(shifts, rows, strict=True):
            noises, pushes = row["noises"], row["pushes"]
            sizes = np.array([each["size"] for each in noises]) * 1e6
            _draw_line(
                panels[0, column], row, sizes * 1.06**shift, [each["return"] for each in noises]
            )
            _draw_line(
                panels[1, column],
                row,
                np.array([each["size"] for each in pushes]) * 1.03**shift,
                [each["recovered"] for each in pushes],
            )
            bodies = [*row["bodies"], row["transfer"]]
            _draw_line(
                panels[2, column],
                row,
                np.arange(len(bodies)) + 0.25 * shift,
                [each["orbit_distance"] for each in bodies],
                line="",
            )
        panels[0, column].set(xscale="log", xlabel="noise on the lengths (µm)")
        panels[0, column].set_title(_TITLES[target], fontsize=10)
        panels[1, column].set(xscale="log", xlabel="push of the base (degrees)")
        panels[1, column].set_xticks(sizes_of(rows), [f"{size:g}" for size in sizes_of(rows)])
        panels[1, column].minorticks_off()
        names = [f"{k:g}, {d:g}" for k, d in result["settings"]["bodies"]]
        panels[2, column].set_xticks(range(len(names) + 1), [*names, "mean"])
        panels[2, column].set_xlabel("stiffness, damping (factors)")
        for axes in panels[:, column]:
            _plain(axes)
    for axes, label in zip(
        panels[:, 0],
        ("return of 500", "share back on the orbit", "distance from the orbit, in amplitudes"),
        strict=True,
    ):
        axes.set_ylabel(label)
    _legend(figure, result)
    return figure


def sizes_of(rows: Sequence[Mapping[str, Any]]) -> list[float]:
    """Sizes of the pushes."""
    return [each["size"] for each in rows[0]["pushes"]]


def _draw_line(
    axes: Axes,
    row: Mapping[str, Any],
    places: Any,
    entries: Sequence[Mapping[str, float | None]],
    line: str = "-",
) -> None:
    # What did not happen (None) is not drawn.
    middle, low, high = (
        np.array([each[key] for each in entries], dtype=np.float64)
        for key in ("iqm", "low", "high")
    )
    reach = [middle - low, high - middle]
    axes.errorbar(
        places,
        middle,
        np.maximum(reach, 0),
        color=_COLOURS[row["agent"]],
        marker=_MARKERS[row["agent"]],
        markersize=4,
        linewidth=1,
        linestyle=line,
    )


def draw_portraits(result: Mapping[str, Any]) -> Figure:
    """The base's angles over the target orbit, two seconds at the end of an episode."""
    targets, agents = result["settings"]["targets"], []
    for row in result["rows"]:
        if row["agent"] not in agents:
            agents.append(row["agent"])
    figure = new_figure(1.6 * len(agents) + 0.6, 1.75 * len(targets) + 0.3)
    panels = figure.subplots(len(targets), len(agents), sharex=True, sharey=True, squeeze=False)
    for line, target in enumerate(targets):
        amplitude = result["environment"][target]["amplitude"]
        orbit = LIMIT_CYCLES[target].orbit(amplitude)
        for axes, agent in zip(panels[line], agents, strict=True):
            axes.plot(*np.vstack((orbit, orbit[:1])).T, color=BLACK, linewidth=4, alpha=0.15)
            row = next(
                each
                for each in result["rows"]
                if (each["agent"], each["target"]) == (agent, target)
            )
            axes.plot(*np.array(row["portrait"]).T, color=_COLOURS[agent], linewidth=0.9)
            axes.set_aspect("equal")
            reach = 1.3 * amplitude
            axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
            if line == 0:
                axes.set_title(agent, fontsize=9)
            axes.tick_params(labelsize=7)
        panels[line, 0].set_ylabel(f"{_TITLES[target]}\nφ (degrees)", fontsize=8)
    for axes in panels[-1]:
        axes.set_xlabel("θ (degrees)", fontsize=8)
    return figure


def _legend(figure: Figure, result: Mapping[str, Any]) -> None:
    present = {row["agent"] for row in result["rows"]}
    handles = [
        Line2D([], [], color=colour, marker=_MARKERS[agent], markersize=5, label=agent)
        for agent, colour in _COLOURS.items()
        if agent in present
    ]
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=5 if len(result["settings"]["targets"]) > 1 else 3,
        fontsize=8,
        frameon=False,
    )


def _plain(axes: Axes) -> None:
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.title.set_fontsize(10)


PICTURES = {
    "learning_curves": draw_curves,
    "returns": draw_returns,
    "robustness": draw_robustness,
    "phase_portraits": draw_portraits,
}
"""Names of the PNG files, and what draws them from what ``compare.json`` holds."""
