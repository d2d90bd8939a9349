"""What the figures of the experiments have in common."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

# Okabe and Ito's colours, told apart by all common kinds of colour vision.
BLUE, VERMILLION, GREEN, ORANGE = "#0072B2", "#D55E00", "#009E73", "#E69F00"
PURPLE, SKY, GREY, BLACK = "#CC79A7", "#56B4E9", "#767676", "#000000"

TASK_LABELS = {
    "second_order": "2nd-order system",
    "tenth_order": "10th-order system",
    "volterra": "Volterra series",
}
TASK_COLOURS = {"second_order": BLUE, "tenth_order": VERMILLION, "volterra": GREEN}


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, in inches, that no window will ever show."""
    layout = ConstrainedLayoutEngine(w_pad=0.06, h_pad=0.06, hspace=0.03, wspace=0.03)
    figure = Figure(figsize=(width, height), dpi=150, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def shades(count: int) -> list[tuple[float, float, float, float]]:
    """So many colours, from dark to light, that every eye can order."""
    return [colormaps["viridis"](0.92 * index / max(count - 1, 1)) for index in range(count)]


def write_letters(panels: Sequence[Axes]) -> None:
    """Give the panels their letters, and all the same plain look."""
    for letter, axes in zip("abcdefghijklmnopqrstuvwxyz", panels, strict=False):
        axes.set_title(f"({letter})", loc="left", fontsize=10, fontweight="bold")
        axes.tick_params(which="both", labelsize=8)
        for axis in (axes.xaxis, axes.yaxis):
            axis.label.set_fontsize(9)
        axes.spines[["top", "right"]].set_visible(False)
