"""Figure 5A: errors of the emulation tasks against the range R of the base (section 3.1).

The paper does not say how exactly the lengths were recorded. A small R gives small changes of
length, which a finite precision hides first, so that the same runs are also read through noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from octoarm_agents.common.intervals import summarise
from octoarm_agents.common.plotting import (
    BLACK,
    GREY,
    TASK_COLOURS,
    TASK_LABELS,
    new_figure,
    write_letters,
)
from octoarm_agents.experiments.emulation.protocol import TASK_HEADINGS, TASKS, TRIALS
from octoarm_agents.experiments.emulation.trials import list_failures, make_trials, score_arm
from octoarm_agents.experiments.runner import Experiment, RunSettings
from octoarm_agents.experiments.tables import ResultTable, format_number, observation_table

RANGES = tuple(float(amplitude) for amplitude in range(15, 91, 5))
"""R [degrees]."""

SENSOR_NOISE = (1e-5, 1e-4)
"""Half widths of the uniform noise on the lengths, in training and test [m]."""

PAPER_FEATURES = {
    "highest_at_smallest_range": "In all tasks, R around 15 shows the highest errors.",
    "second_order_local_maximum_near_45": "The error of the 2nd-order system starts to increase "
    "again at around R = 30 and has a local maximum at around R = 45.",
    "tenth_order_monotone": "The error of the 10th-order system decreases monotonically with R.",
    "volterra_minimum_near_55": "The error of the Volterra task has its minimum at around R = 55 "
    "and increases monotonically beyond.",
}
"""What section 3.1 says of the figure."""

_QUARTILES = ("lower_quartile", "median", "upper_quartile")

AROUND = 5.0
"""How far from the R that the paper names "around" reaches: one point of the grid [degrees]."""


def run(settings: RunSettings) -> dict[str, Any]:
    """Errors at each R, without and with noise; ``--amplitude`` restricts the grid to that R."""
    ranges = RANGES if settings.amplitude is None else (settings.amplitude,)
    points = [
        {"kind": "sines", "amplitude": amplitude, "sensor_noise": SENSOR_NOISE}
        for amplitude in ranges
    ]
    trials = make_trials(settings, "figure5a", score_arm, points)
    by_range = dict(zip(ranges, trials, strict=True))
    return {
        "ranges_deg": list(ranges),
        "trials": settings.trials,
        "paper": PAPER_FEATURES,
        **_collect(by_range),
        "sensor_noise": {
            f"{level:g}": {"half_width_metres": level} | _collect(by_range, index)
            for index, level in enumerate(SENSOR_NOISE)
        },
    }


def _collect(
    by_range: Mapping[float, Sequence[Mapping[str, Any]]], level: int | None = None
) -> dict[str, Any]:
    """What the trials gave at each R, and whether it shows the paper's features.

    Args:
        by_range: trials by R [degrees], increasing.
        level: index into `SENSOR_NOISE`; None: without noise.

    Returns:
        ``points``, one an R, and ``confirmed``, which is None where there is but one R.
    """
    points: list[dict[str, Any]] = []
    for amplitude, trials in by_range.items():
        finished = [trial for trial in trials if trial["failure"] is None]
        tasks = {}
        for task in TASKS:
            errors = [
                (trial["arm"] if level is None else trial["sensor_noise"][level])["test"][task]
                for trial in finished
            ]
            quartiles = np.percentile(errors, (25, 50, 75)).tolist() if errors else [None] * 3
            tasks[task] = summarise(errors) | dict(zip(_QUARTILES, quartiles, strict=True))
        failures = list_failures(trials)
        points.append({"range_deg": amplitude, "failures": failures, "tasks": tasks})
    medians = {task: [point["tasks"][task]["median"] for point in points] for task in TASKS}
    confirmed = check_features(list(by_range), medians) if len(by_range) > 1 else None
    return {"points": points, "confirmed": confirmed}


def check_features(
    ranges: Sequence[float], medians: Mapping[str, Sequence[float | None]]
) -> dict[str, bool]:
    """Whether each of `PAPER_FEATURES` is there, judged by the medians over trials.

    Args:
        ranges: R [degrees], increasing.
        medians: error at each R by task; None where every trial failed. Such an R is left out, and
            a feature that needs it is not confirmed.

    Returns:
        True or False for each feature.
    """
    errors = np.array([medians[task] for task in TASKS], dtype=np.float64)
    known = ~np.isnan(errors).any(axis=0)
    second, tenth, volterra = errors = errors[:, known]
    left = np.array(ranges)[known]
    if len(left) < 2:
        return dict.fromkeys(PAPER_FEATURES, False)
    complete, lowest = len(left) == len(ranges), int(volterra.argmin())
    turns = (second[1:-1] > second[:-2]) & (second[1:-1] > second[2:])
    return {
        "highest_at_smallest_range": bool(left[0] == ranges[0] and (errors[:, :1] >= errors).all()),
        "second_order_local_maximum_near_45": bool(
            (np.abs(left[1:-1][turns] - 45) <= AROUND).any()
        ),
        "tenth_order_monotone": complete and bool((np.diff(tenth) < 0).all()),
        "volterra_minimum_near_55": complete
        and bool(abs(left[lowest] - 55) <= AROUND and (np.diff(volterra[lowest:]) > 0).all()),
    }


def tables(result: Mapping[str, Any]) -> list[ResultTable]:
    """Median errors by R, and the paper's features."""
    rows = [
        (
            f"{point['range_deg']:g}",
            *(format_number(point["tasks"][task]["median"]) for task in TASKS),
            str(len(point["failures"])),
        )
        for point in result["points"]
    ]
    title = f"Median of the mean squared error, {result['trials']} trials"
    by_range = ResultTable(title, ("R (degrees)", *TASK_HEADINGS, "failed trials"), rows)
    if result["confirmed"] is None:
        return [by_range]
    title = "The paper's observations confirmed, without and with noise on the lengths"
    answers = {"without noise": result["confirmed"]} | {
        _describe_noise(each): each["confirmed"] for each in result["sensor_noise"].values()
    }
    return [by_range, observation_table(title, result["paper"], answers)]


def _describe_noise(noisy: Mapping[str, Any]) -> str:
    """A level of the noise in words."""
    return f"±{noisy['half_width_metres'] * 1000:g} mm"


def draw(result: Mapping[str, Any]) -> Figure:
    """Median and quartiles against R, one panel a task; a mark where trials failed.

    Of the errors under noise there are the medians alone, as thinner lines.
    """
    figure = new_figure(11.0, 3.8)
    panels = figure.subplots(1, 3)
    failed = [point for point in result["points"] if point["failures"]]
    for axes, task in zip(panels, TASKS, strict=True):
        ranges, low, middle, high = _quartiles(result["points"], task)
        axes.errorbar(
            ranges,
            middle,
            yerr=(middle - low, high - middle),
            color=TASK_COLOURS[task],
            marker="o",
            markersize=4,
            linewidth=2.0,
            elinewidth=1.2,
            capsize=3,
            label=f"median and quartiles of {result['trials']} trials",
        )
        for noisy, style in zip(result["sensor_noise"].values(), ("--", "-."), strict=True):
            ranges, _, middle, _ = _quartiles(noisy["points"], task)
            axes.plot(
                ranges,
                middle,
                color=BLACK,
                linestyle=style,
                marker=".",
                markersize=4,
                linewidth=0.9,
                label=f"median, lengths with noise of {_describe_noise(noisy)}",
            )
        for index, point in enumerate(failed):
            axes.axvline(
                point["range_deg"],
                color=GREY,
                linestyle=":",
                label="trials failed here" if index == 0 else None,
            )
        if len(ranges):
            axes.set_yscale("log")
        axes.set_title(TASK_LABELS[task], fontsize=10)
        axes.set_xlabel("range of the base R (degrees)")
    panels[0].set_ylabel("mean squared error")
    handles, labels = panels[0].get_legend_handles_labels()
    # Error bars are listed last whenever they were drawn; the main series comes first here.
    handles, labels = (each[-1:] + each[:-1] for each in (handles, labels))
    figure.legend(handles, labels, fontsize=8, frameon=False, ncols=4, loc="outside lower center")
    write_letters(panels)
    return figure


def _quartiles(points: Sequence[Mapping[str, Any]], task: str) -> NDArray[np.float64]:
    """R [degrees], lower quartile, median and upper quartile where any trial succeeded: (4, n)."""
    rows = [
        (point["range_deg"], *(point["tasks"][task][name] for name in _QUARTILES))
        for point in points
        if point["tasks"][task]["median"] is not None
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, 4).T


FIGURE5A = Experiment("figure5a", TRIALS, run, tables, draw)
