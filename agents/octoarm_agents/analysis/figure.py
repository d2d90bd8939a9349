"""The figure of an analysis: memory, processing capacity, dimension, and how the start is lost."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from octoarm_agents.analysis.measures import Measures
from octoarm_agents.analysis.survey import ArmSurvey
from octoarm_agents.common.plotting import (
    BLUE,
    GREEN,
    GREY,
    VERMILLION,
    new_figure,
    shades,
    write_letters,
)

_IMPOSSIBLE = "\nimpossible: see the warnings"


def analysis_figure(width: float, height: float) -> Figure:
    """An empty figure, in inches, with room between its panels."""
    figure = new_figure(width, height)
    figure.set_layout_engine("constrained", w_pad=0.08, h_pad=0.08)
    return figure


def draw_analysis(measures: Measures, survey: ArmSurvey | None = None) -> Figure:
    """Draw the measures of a recording; of a whole survey also ranks and the echo-state test."""
    figure = analysis_figure(9.6, 7.2)
    memory, processing, dimension, last = figure.subplots(2, 2).ravel()
    _draw_memory(memory, measures)
    _draw_processing(processing, measures)
    _draw_dimension(dimension, measures, survey)
    if survey is None:
        _draw_degrees(last, measures)
    else:
        _draw_echo(last, survey)
    write_letters(figure.axes)
    return figure


def _draw_memory(axes: Axes, measures: Measures) -> None:
    memory = measures.memory
    several = len(memory.capacities) > 1
    colours = shades(len(memory.capacities)) if several else [BLUE]
    for column, (capacities, colour) in enumerate(zip(memory.capacities, colours, strict=True)):
        label = None if column else "on held-out rows"
        circles: dict[str, Any] = {"markersize": 4, "markerfacecolor": "none", "label": label}
        axes.plot(memory.held_out[column], "o", color=VERMILLION, **circles)
        label = "all rows, without bias" + (f", input {column + 1}" if several else "")
        axes.plot(capacities, color=colour, linewidth=1.4, label=label)
    axes.set(xlim=(-0.5, measures.settings.max_delay + 0.5), ylim=(-0.02, 1.05))
    axes.set_xlabel(f"delay k ({measures.recording.sampling.unit})")
    axes.set_ylabel("memory capacity $MC_k$")
    title = f"MC = {memory.total:.2f}, held out {memory.held_out_total:.2f}"
    names = {"memory capacity", "memory capacity on held-out rows"}
    _legend(axes, title + _IMPOSSIBLE * bool(names & measures.impossible.keys()))


def _draw_processing(axes: Axes, measures: Measures) -> None:
    processing = measures.processing
    table = processing.by_degree_and_oldest_delay
    delays = np.arange(table.shape[1])
    base = np.zeros(len(delays))
    columns = table, shades(len(table)), processing.largest_delays_by_degree
    for degree, (row, colour, delay) in enumerate(zip(*columns, strict=True), start=1):
        label = f"degree {degree}: {row.sum():.2f} (delays to {delay})"
        axes.bar(delays, row, bottom=base, width=0.9, color=colour, label=label)
        base += row
    # A false alarm at a large delay shall not press all else to the side.
    used = np.flatnonzero(base > 0.01 * base.max())
    axes.set_xlim(-0.6, (used[-1] if len(used) else 0) + 2.5)
    axes.set_xlabel(f"oldest input in the function ({measures.recording.sampling.unit})")
    axes.set_ylabel("information processing capacity")
    title = f"sum = {processing.total:.2f} of at most {processing.largest_possible_total:.2f}"
    _legend(axes, title + _IMPOSSIBLE * ("information processing capacity" in measures.impossible))


def _draw_dimension(axes: Axes, measures: Measures, survey: ArmSurvey | None) -> None:
    values, tolerance = measures.singular_values, measures.settings.tolerance
    _singular_values(axes, values / values[0], BLUE, f"states ({measures.rank_at_tolerance})")
    if survey is not None:
        ranks = survey.ranks
        first = ranks.kernel_singular_values[0]
        label = f"different streams ({ranks.kernel_rank})"
        _singular_values(axes, ranks.kernel_singular_values / first, GREEN, label)
        label = f"similar streams ({ranks.generalisation_rank})"
        _singular_values(axes, ranks.generalisation_singular_values / first, VERMILLION, label)
    axes.axhline(tolerance, color=GREY, linewidth=0.9, linestyle=":")
    axes.set_ylim(bottom=max(axes.get_ylim()[0], 1e-9))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlabel="index", ylabel="singular value / largest")
    _legend(axes, f"(number above {tolerance:g})")


def _singular_values(axes: Axes, values: np.ndarray, colour: str, label: str) -> None:
    index = np.arange(1, len(values) + 1)
    shown = values > 0
    axes.semilogy(index[shown], values[shown], ".-", color=colour, linewidth=1.0, label=label)


def _draw_degrees(axes: Axes, measures: Measures) -> None:
    processing = measures.processing
    sums = processing.by_degree
    degrees = np.arange(1, len(sums) + 1)
    axes.bar(degrees, sums, color=shades(len(sums)))
    for degree, value, counts in zip(degrees, sums, processing.counts, strict=True):
        axes.text(int(degree), value, counts, ha="center", va="bottom", fontsize=8)
    axes.set(xticks=degrees, ylim=(0, 1.15 * max(float(sums.max()), 0.1)))
    axes.set(xlabel="total degree (labels: functions that count)", ylabel="sum of capacities")


def _draw_echo(axes: Axes, survey: ArmSurvey) -> None:
    echo, lyapunov = survey.echo, survey.lyapunov
    time = echo.interval_seconds * np.arange(len(echo.distances))
    # Beyond the fit there is only rounding.
    end = min(int(1.2 * echo.fitted_samples) + 10, len(time))
    shown = (echo.distances > 0) & (time < time[end - 1])
    axes.semilogy(time[shown], echo.distances[shown], color=BLUE, linewidth=1.3, label="distance")
    if echo.decay_time_seconds:
        fitted = time[: echo.fitted_samples]
        logs = np.log(echo.distances[: echo.fitted_samples])
        line = np.exp(logs.mean() - (fitted - fitted.mean()) / echo.decay_time_seconds)
        label = f"fit, decay time {echo.decay_time_seconds:.2f} s"
        axes.semilogy(fitted, line, "--", color=VERMILLION, linewidth=1.2, label=label)
    axes.set_xlim(0, time[end - 1])
    axes.set_xlabel("time since the common input began (s)")
    axes.set_ylabel("distance between two starts\n(natural sizes)")
    _legend(axes, f"Lyapunov exponent {lyapunov} /s")


def _legend(axes: Axes, title: str) -> None:
    axes.legend(title=title, title_fontsize=9, fontsize=8, frameon=False, loc="upper right")
