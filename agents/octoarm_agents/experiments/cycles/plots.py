"""What the figures of limit cycles have in common: outputs over time, portraits, lost runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike

from octoarm_agents.common.plotting import BLACK, BLUE, ORANGE, VERMILLION
from octoarm_agents.experiments.cycles.trials import BURST_BEGIN, BURST_END

_OUTPUTS = ((BLUE, "output 1, θ"), (VERMILLION, "output 2, φ"))
_TARGET: dict[str, Any] = {"color": BLACK, "linewidth": 4.0, "alpha": 0.18}


def draw_outputs(
    axes: Axes,
    series: Mapping[str, Any],
    timestep: float,
    *,
    burst: bool = False,
    target: bool = True,
) -> None:
    """Both outputs over time, over the target.

    Args:
        axes: to draw on.
        series: ``step``, ``outputs_deg``, ``target_deg`` of a trial.
        timestep: of the body [s].
        burst: shade the steps with noise.
        target: draw the target.
    """
    time = [timestep * step for step in series["step"]]
    if burst:
        axes.axvspan(
            timestep * BURST_BEGIN, timestep * BURST_END, color=ORANGE, alpha=0.25, linewidth=0
        )
    for (colour, _), said, wanted in zip(
        _OUTPUTS, series["outputs_deg"], series["target_deg"], strict=True
    ):
        if target:
            axes.plot(time, wanted, **_TARGET)
        axes.plot(time, said, color=colour, linewidth=1.1)
    axes.margins(x=0.0)
    axes.ticklabel_format(axis="x", useOffset=False)
    axes.set_xlabel("time in closed loop (s)", fontsize=9)


def draw_portrait(
    axes: Axes,
    target: ArrayLike,
    outputs: Sequence[tuple[ArrayLike, str]],
) -> None:
    """One output against the other.

    Args:
        axes: to draw on.
        target: (2, K), at least one turn [degrees].
        outputs: curves (2, T) [degrees] and their colours, the later above.
    """
    axes.plot(*np.asarray(target), **_TARGET)
    for curve, colour in outputs:
        axes.plot(*np.asarray(curve), color=colour, linewidth=0.9)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("output 1 (degrees)")
    axes.set_ylabel("output 2 (degrees)")


def explain_outputs(
    figure: Figure, *, burst: bool = False, more: Sequence[tuple[str, str]] = ()
) -> None:
    """One legend for all panels, below them.

    Args:
        figure: to write on.
        burst: explain the shaded steps.
        more: colours and labels of further lines.
    """
    handles = [Line2D([], [], color=colour, label=label) for colour, label in (*_OUTPUTS, *more)]
    handles.append(Line2D([], [], label="target", **_TARGET))
    if burst:
        shade: dict[str, Any] = {"color": ORANGE, "linewidth": 8.0, "alpha": 0.25}
        handles.append(Line2D([], [], label="noise on both outputs", **shade))
    figure.legend(
        handles=handles, fontsize=9, frameon=False, ncols=len(handles), loc="outside lower center"
    )
