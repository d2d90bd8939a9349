"""The figure of the Floquet map."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from octoarm_agents.common.plotting import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    PURPLE,
    VERMILLION,
    new_figure,
    save_figure,
    write_letters,
)
from octoarm_agents.experiments.cycle_figures import say_missing
from octoarm_agents.experiments.cycle_settings import CYCLE_LABELS
from octoarm_agents.experiments.floquet_trials import is_stable

__all__ = ["draw_floquet"]

_COLOURS = (VERMILLION, PURPLE, BLUE, GREEN)
_MARKERS = "osD"

_EXPONENTS = (-3.0, 1e3)
_LEFT = 1e6
"""Response at which loops are drawn whose arm left its domain, above all others."""


def draw_floquet(result: Mapping[str, Any], path: Path) -> None:
    """Exponents over ν, a row an R and a column a cycle; below, all loops and what became of them.

    Args:
        result: of the experiment.
        path: of the figure.
    """
    cycles = result["cycles"]
    rows = max(len(entries) for entries in cycles.values())
    figure = new_figure(13.0, 3.2 + 2.7 * rows)
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=(rows, 1.25))[:, 0]
    panels = above.subplots(rows, len(cycles), sharex=True, sharey=True, squeeze=False)
    factors = sorted(
        {loop["factor"] for entries in cycles.values() for e in entries for loop in e["loops"]}
    )
    colours = dict(zip(factors, _COLOURS, strict=False))
    for column, (target, entries) in zip(panels.T, cycles.items(), strict=True):
        for axes, entry in zip(column, entries, strict=True):
            _draw_exponents(axes, entry, colours)
            axes.set_title(f"{CYCLE_LABELS[target]}, R = {entry['amplitude_deg']:g}°", fontsize=9)
    for axes in panels[-1]:
        axes.set_xlabel("noise of the training ν (m)")
    for axes in panels[:, 0]:
        axes.set_ylabel("leading exponent (1/s)")
    left, right = below.subplots(1, 2, sharey=True)
    _draw_fates(left, right, result, colours)
    write_letters([*panels.ravel(), left, right])
    handles = [
        Line2D([], [], color=colour, marker="o", label=_label(factor))
        for factor, colour in colours.items()
    ]
    handles += [
        Line2D([], [], color=BLACK, marker="o", linestyle="", label="held"),
        Line2D([], [], color=BLACK, marker="o", linestyle="", fillstyle="none", label="lost"),
    ]
    handles += [
        Line2D([], [], color=GREY, marker=marker, linestyle="", label=f"{CYCLE_LABELS[target]}")
        for target, marker in zip(cycles, _MARKERS, strict=False)
    ]
    figure.legend(handles=handles, fontsize=9, frameon=False, ncols=5, loc="outside lower center")
    save_figure(figure, path)


def _label(factor: float) -> str:
    return "the paper's ridge" if factor == 0 else f"weighted ridge, {factor:g} κ"


def _draw_exponents(axes: Axes, entry: Mapping[str, Any], colours: Mapping[float, str]) -> None:
    """The leading exponent of an R against ν, a line a factor."""
    if entry["failure"] is not None:
        say_missing(axes, entry["failure"])
        return
    axes.axhspan(_EXPONENTS[0], 0, color=GREEN, alpha=0.08, linewidth=0)
    axes.axhline(0, color=GREY, linewidth=0.8)
    for factor, colour in colours.items():
        loops = [
            loop
            for loop in entry["loops"]
            if loop["factor"] == factor and loop["leading_exponent"] is not None
        ]
        noises = [loop["noise"] for loop in loops]
        exponents = [loop["leading_exponent"] for loop in loops]
        axes.plot(noises, exponents, color=colour, linewidth=1.1)
        for loop in loops:
            _mark(axes, loop["noise"], loop["leading_exponent"], colour, loop["held"])
    axes.set_xscale("log")
    axes.set_yscale("symlog", linthresh=1.0)
    axes.set_ylim(*_EXPONENTS)


def _draw_fates(
    left: Axes, right: Axes, result: Mapping[str, Any], colours: Mapping[float, str]
) -> None:
    """Response to noise, of all loops against the exponent, of the stable against the error."""
    left.axvspan(_EXPONENTS[0], 0, color=GREEN, alpha=0.08, linewidth=0)
    left.axvline(0, color=GREY, linewidth=0.8)
    right.set_facecolor(f"{GREEN}14")  # as the other: an opacity of 0.08
    for marker, entries in zip(_MARKERS, result["cycles"].values(), strict=False):
        for entry in entries:
            for loop in entry["loops"]:
                if loop["leading_exponent"] is None:
                    continue
                response = loop["responses"][-1]
                value = _LEFT if response is None else response
                colour, held = colours[loop["factor"]], loop["held"]
                _mark(left, loop["leading_exponent"], value, colour, held, marker)
                if is_stable(loop):
                    _mark(right, loop["training_error"], value, colour, held, marker)
    for axes in (left, right):
        axes.set_yscale("log")
    left.set_xscale("symlog", linthresh=1.0)
    left.set_xlim(*_EXPONENTS)
    left.set_xlabel("leading exponent (1/s)")
    left.set_title("all loops", fontsize=9)
    size = result["response_noises"][-1]
    left.set_ylabel(f"response to noise of {size:g} R\n(top: the arm left its domain)")
    right.set_xscale("log")
    right.set_xlabel("training error / R")
    right.set_title("loops with a negative exponent", fontsize=9)


def _mark(axes: Axes, x: float, y: float, colour: str, held: bool, marker: str = "o") -> None:
    """A point, filled if the cycle was held."""
    face = colour if held else "white"
    axes.plot([x], [y], marker=marker, markersize=6, color=colour, markerfacecolor=face, zorder=3)
