"""The figures of the comparison."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from octoarm_agents.common.files import write_atomically
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

Row = Mapping[str, Any]

_LOOKS = {
    "readout_pinv": (SKY, "o"),
    "readout_ridge": (BLUE, "s"),
    "readout_noise": ("#44AA99", "h"),
    "readout_weighted": ("#332288", "p"),
    "readout_aggregated": ("#661100", "d"),
    "readout_designed": ("#CC3377", "*"),
    "readout_past": ("#999933", "X"),
    "linear_search": (ORANGE, "v"),
    "ppo": (VERMILLION, "^"),
    "ppo_noise": ("#E7B800", "H"),
    "sac": (GREEN, "D"),
    "tqc": (PURPLE, "<"),
    "recurrent_ppo": ("#8C510A", ">"),
    "hold": (GREY, "x"),
    "clock": (BLACK, "P"),
}
"""Colour and marker of every agent."""

_TITLES = {
    "quadratic": "quadratic cycle",
    "van_der_pol": "Van der Pol cycle",
    "lissajous": "Lissajous curve",
}

_LARGEST = 500.0


def draw_all(result: Mapping[str, Any], out: Path) -> None:
    """Draw the figures of a comparison, what ``compare.json`` holds, into a folder.

    Raises:
        OSError: the folder cannot be written to.
    """
    rows = {
        target: [row for row in result["rows"] if row["target"] == target]
        for target in result["settings"]["targets"]
    }
    for name, figure in (
        ("learning_curves", _draw_curves(rows, result["settings"]["teaching_steps"])),
        ("returns", _draw_returns(rows)),
        ("robustness", _draw_robustness(rows)),
        ("phase_portraits", _draw_portraits(rows, result["environment"])),
    ):
        write_atomically(out / f"{name}.png", figure.savefig)


def _draw_curves(rows: Mapping[str, Sequence[Row]], teaching_steps: int) -> Figure:
    """Return over environment steps, with what a readout needs and earns."""
    figure = new_figure(4.2 * len(rows), 3.9)
    panels = figure.subplots(1, len(rows), sharey=True, squeeze=False)[0]
    for axes, (target, own) in zip(panels, rows.items(), strict=True):
        readouts = [row["return"]["iqm"] for row in own if row["agent"].startswith("readout")]
        if readouts:
            axes.axvline(teaching_steps, color=BLUE, linestyle=":")
            axes.axhline(max(readouts), color=BLUE, linestyle=":")
        for row in own:
            if row["curves"]:
                _draw_curve(axes, row)
        axes.set(xscale="log", title=_TITLES[target], xlabel="environment steps", ylim=(-15, 510))
        _plain(axes)
    panels[0].set_ylabel("return of 500, judging seeds")
    trained = {row["agent"] for own in rows.values() for row in own if row["curves"]}
    label = "readouts: their samples, their return"
    bounds = Line2D([], [], color=BLUE, linestyle=":", label=label)
    _legend(figure, trained, 6 if len(rows) > 1 else 2, bounds, markers=False)
    return figure


def _draw_curve(axes: Axes, row: Row) -> None:
    """Median over trainings, and the band from the worst to the best."""
    count = min(len(curve) for curve in row["curves"])
    steps, returns = (
        np.array([[point[key] for point in curve[:count]] for curve in row["curves"]])
        for key in ("steps", "return")
    )
    steps, (colour, _) = np.median(steps, axis=0), _LOOKS[row["agent"]]
    axes.fill_between(steps, returns.min(axis=0), returns.max(axis=0), color=colour, alpha=0.15)
    axes.plot(steps, np.median(returns, axis=0), color=colour, linewidth=1.5)


def _draw_returns(rows: Mapping[str, Sequence[Row]]) -> Figure:
    """What is missing to the largest return: interquartile means, intervals, single trainings."""
    figure = new_figure(4.2 * len(rows), 3.6)
    panels = figure.subplots(1, len(rows), sharey=True, sharex=True, squeeze=False)[0]
    for axes, (target, own) in zip(panels, rows.items(), strict=True):
        for place, row in enumerate(own):
            entry, (colour, marker) = row["return"], _LOOKS[row["agent"]]
            missing = [_LARGEST - value for value in entry["values"]]
            axes.plot(missing, [place] * len(missing), ".", color=colour, alpha=0.4, markersize=5)
            ends = [_LARGEST - entry["high"], _LARGEST - entry["low"]]
            axes.plot(ends, [place, place], color=colour, linewidth=2)
            axes.plot(_LARGEST - entry["iqm"], place, marker, color=colour)
        axes.set(xscale="log", title=_TITLES[target], xlabel="return missing to 500")
        axes.set_yticks(range(len(own)), [row["agent"] for row in own])
        axes.grid(axis="x", alpha=0.3)
        _plain(axes)
    panels[0].invert_yaxis()
    return figure


def _draw_robustness(rows: Mapping[str, Sequence[Row]]) -> Figure:
    """Return over noise, recovery over pushes, distance on other bodies; with intervals."""
    figure = new_figure(4.2 * len(rows), 9.4)
    panels = figure.subplots(3, len(rows), sharey="row", squeeze=False)
    for column, (target, own) in enumerate(rows.items()):
        noisy, pushed, other = panels[:, column]
        noises, pushes = ([each["size"] for each in own[0][name]] for name in ("noises", "pushes"))
        for shift, row in zip(np.linspace(-1, 1, len(own)), own, strict=True):
            bodies = [*row["bodies"], row["transfer"]]
            for axes, places, entries, figure_of in (
                (noisy, np.array(noises) * 1e6 * 1.06**shift, row["noises"], "return"),
                (pushed, np.array(pushes) * 1.03**shift, row["pushes"], "recovered"),
                (other, np.arange(len(bodies)) + 0.25 * shift, bodies, "orbit_distance"),
            ):
                _draw_line(axes, row["agent"], places, [each[figure_of] for each in entries])
        for line in other.get_lines():
            line.set_linestyle("")
        noisy.set(xscale="log", xlabel="noise on the lengths (µm)", title=_TITLES[target])
        pushed.set(xscale="log", xlabel="push of the base (degrees)")
        pushed.set_xticks(pushes, [f"{size:g}" for size in pushes])
        pushed.minorticks_off()
        names = [f"{each['stiffness']:g}, {each['damping']:g}" for each in own[0]["bodies"]]
        other.set_xticks(range(len(names) + 1), [*names, "mean"])
        other.set_xlabel("stiffness, damping (factors)")
        for axes in (noisy, pushed, other):
            _plain(axes)
    panels[0, 0].set_ylabel("return of 500")
    panels[1, 0].set_ylabel("share back on the orbit")
    panels[2, 0].set_ylabel("distance from the orbit, in amplitudes")
    present = {row["agent"] for own in rows.values() for row in own}
    _legend(figure, present, 5 if len(rows) > 1 else 3)
    return figure


_PORTRAITS = 8
"""Of agents, side by side."""


def _draw_line(
    axes: Axes, agent: str, places: Any, entries: Sequence[Mapping[str, float | None]]
) -> None:
    # What did not happen (None) is not drawn.
    middle, low, high = (
        np.array([each[key] for each in entries], dtype=np.float64)
        for key in ("iqm", "low", "high")
    )
    reach = np.maximum([middle - low, high - middle], 0)
    colour, marker = _LOOKS[agent]
    axes.errorbar(places, middle, reach, color=colour, marker=marker, markersize=4, linewidth=1)


def _draw_portraits(
    rows: Mapping[str, Sequence[Row]], environment: Mapping[str, Mapping[str, Any]]
) -> Figure:
    """The base's angles over the target orbit, two seconds at the end of an episode."""
    agents = len(next(iter(rows.values())))
    columns = min(agents, _PORTRAITS)
    lines = -(-agents // columns)
    figure = new_figure(1.6 * columns + 0.6, 1.75 * lines * len(rows) + 0.3)
    panels = figure.subplots(
        len(rows) * lines, columns, sharex="row", sharey="row", squeeze=False
    ).reshape(len(rows), lines * columns)
    for line, (target, own) in zip(panels, rows.items(), strict=True):
        amplitude = environment[target]["amplitude"]
        orbit = LIMIT_CYCLES[target].orbit(amplitude)
        reach = 1.3 * amplitude
        for axes, row in zip(line, own, strict=False):
            axes.plot(*np.vstack((orbit, orbit[:1])).T, color=BLACK, linewidth=4, alpha=0.15)
            axes.plot(*np.array(row["portrait"]).T, color=_LOOKS[row["agent"]][0], linewidth=0.9)
            axes.set(aspect="equal", xlim=(-reach, reach), ylim=(-reach, reach))
            axes.tick_params(labelsize=7)
            axes.set_title(row["agent"], fontsize=8)
        for axes in line[agents:]:
            axes.set_visible(False)
        for axes in line[::columns]:
            axes.set_ylabel(f"{_TITLES[target]}\nφ (degrees)", fontsize=8)
    for axes in panels[-1, -columns:]:
        axes.set_xlabel("θ (degrees)", fontsize=8)
    return figure


def _legend(
    figure: Figure, agents: set[str], columns: int, *more: Line2D, markers: bool = True
) -> None:
    """The agents' looks, and what else is drawn."""
    handles = [
        Line2D([], [], color=colour, marker=marker if markers else "", markersize=5, label=agent)
        for agent, (colour, marker) in _LOOKS.items()
        if agent in agents
    ]
    figure.legend(
        handles=[*handles, *more],
        loc="outside lower center",
        ncols=columns,
        fontsize=8,
        frameon=False,
    )


def _plain(axes: Axes) -> None:
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.title.set_fontsize(10)
