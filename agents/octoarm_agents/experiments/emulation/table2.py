"""Table 2: errors of the emulation tasks, beside what needs no body (section 3.1).

Besides the paper's two columns: baselines on the same rows, the same table with an input that has
no simple structure, errors under sensor noise, training errors, and the rank of the states.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from octoarm_agents.common.intervals import summarise, welch_p_value
from octoarm_agents.common.plotting import (
    BLUE,
    GREY,
    ORANGE,
    TASK_LABELS,
    VERMILLION,
    new_figure,
    write_letters,
)
from octoarm_agents.experiments.emulation.protocol import (
    HOLD_STEPS,
    INPUTS,
    PAPER,
    RANGE,
    TASK_HEADINGS,
    TASKS,
    TRIALS,
)
from octoarm_agents.experiments.emulation.trials import (
    compare_methods,
    list_failures,
    make_trials,
    note_failures,
)
from octoarm_agents.experiments.runner import Experiment, RunSettings
from octoarm_agents.experiments.tables import ResultTable, format_number, format_spread

SENSOR_NOISE = (1e-8, 1e-7, 1e-6, 1e-5, 1e-4)
"""Standard deviations of the normal noise on the lengths, in training and test [m]."""

IID_RANGE_FACTOR = 0.5
"""The random input is driven at half of R: at R = 60 its largest leaps, of up to 120 degrees within
50 ms, throw a directly driven arm out of its domain; at 30 they do not."""

_LABELS = {
    "arm": "arm",
    "linear_regressor": "linear regressor",
    "mean_predictor": "training mean",
    "cubic": "cubic of In(t)",
    "delay2": "11 delays, degree 2",
    "delay3": "6 delays, degree 3",
    "esn80": "80-node network",
}


def run(settings: RunSettings) -> dict[str, Any]:
    """The table, as the keys of ``table2.json``."""
    amplitude = RANGE if settings.amplitude is None else settings.amplitude
    amplitudes = (amplitude, amplitude * IID_RANGE_FACTOR)
    points = [
        {"kind": kind, "amplitude": amplitude, "sensor_noise": SENSOR_NOISE}
        for kind, amplitude in zip(INPUTS, amplitudes, strict=True)
    ]
    results = make_trials(settings, "table2", compare_methods, points)
    table, iid = map(_tabulate, results, amplitudes)
    for task, paper in PAPER.items():
        entry = table["tasks"][task]
        entry["paper"] = {method: mean for method, (mean, _) in paper.items()}
        entry["paper_sd"] = {method: sd for method, (_, sd) in paper.items()}
        entry["ratio_to_paper"] = {
            method: None if entry[method]["mean"] is None else entry[method]["mean"] / mean
            for method, (mean, _) in paper.items()
        }
    return table | {"iid": iid | {"hold_steps": HOLD_STEPS}}


def _tabulate(trials: Sequence[Mapping[str, Any]], amplitude: float) -> dict[str, Any]:
    """The table of one input."""
    finished = [trial for trial in trials if trial["failure"] is None]

    def errors(method: str, phase: str, task: str) -> list[float]:
        if method == "arm":
            return [trial["arm"][phase][task] for trial in finished]
        return [trial["baselines"][method][phase][task] for trial in trials]

    tasks: dict[str, Any] = {}
    for task in TASKS:
        tasks[task] = {
            method: summarise(errors(method, "test", task))
            | {"training_mean": summarise(errors(method, "training", task))["mean"]}
            for method in _LABELS
        }
        tasks[task]["p_value"] = welch_p_value(
            errors("arm", "test", task), errors("linear_regressor", "test", task)
        )
    ranks = [trial["state_rank"] for trial in finished]
    return {
        "range_deg": amplitude,
        "trials": len(trials),
        "failures": list_failures(trials),
        "initial_steps": [trial["initial_steps"] for trial in trials],
        "state_rank": float(np.median(ranks)) if ranks else None,
        "tasks": tasks,
        "sensor_noise": [
            {"sd_metres": level}
            | {
                task: summarise([trial["sensor_noise"][k]["test"][task] for trial in finished])
                for task in TASKS
            }
            for k, level in enumerate(SENSOR_NOISE)
        ],
    }


def tables(result: Mapping[str, Any]) -> list[ResultTable]:
    """Both inputs' errors, and those under sensor noise."""
    return [
        _error_table("Mean squared error, input of Eq. 17", result),
        _error_table("Mean squared error, i.i.d. input", result["iid"]),
        ResultTable(
            "Mean squared error of the arm with noise on the lengths, input of Eq. 17",
            ("standard deviation", *TASK_HEADINGS),
            [
                (f"{level['sd_metres']:.0e} m", *(_told(level[task]) for task in TASKS))
                for level in result["sensor_noise"]
            ],
        ),
    ]


def _error_table(title: str, table: Mapping[str, Any]) -> ResultTable:
    tasks = [table["tasks"][task] for task in TASKS]
    rows = []
    for method, label in _LABELS.items():
        rows.append((label, *(_told(entry[method]) for entry in tasks)))
        if method in tasks[0].get("paper", ()):
            papers = (format_spread(e["paper"][method], e["paper_sd"][method]) for e in tasks)
            rows.append(("  in the paper", *papers))
    rows.append(("p, arm / regressor", *(format_number(entry["p_value"]) for entry in tasks)))
    return ResultTable(
        f"{title}, R = {table['range_deg']:g}°, {table['trials']} trials,"
        f" state rank {format_number(table['state_rank'], 'g')}",
        ("method", *TASK_HEADINGS),
        rows,
        note_failures(table),
    )


def _told(summary: Mapping[str, Any]) -> str:
    return format_spread(summary["mean"], summary["sd"])


def draw(result: Mapping[str, Any]) -> Figure:
    """Bars on a logarithmic axis: a row for each input, a column for each task."""
    figure = new_figure(12.0, 6.6)
    panels = figure.subplots(2, 3)
    for row, (table, name) in enumerate(((result, "input of Eq. 17"), (result["iid"], "i.i.d."))):
        for column, task in enumerate(TASKS):
            axes = panels[row, column]
            _draw_bars(axes, table["tasks"][task], labelled=column == 0)
            axes.set_xlabel(f"mean squared error, {name}, R = {table['range_deg']:g}°")
            axes.set_title(TASK_LABELS[task], fontsize=10)
    write_letters(panels.flat)
    return figure


def _draw_bars(axes: Axes, entry: Mapping[str, Any], *, labelled: bool) -> None:
    """One bar a method, with its standard deviation and its value."""
    bars: list[tuple[str, float | None, float | None, str]] = []
    for method, label in _LABELS.items():
        colour = {"arm": BLUE, "linear_regressor": VERMILLION}.get(method, GREY)
        summary = entry[method]
        bars.append((label, summary["mean"], summary["sd"], colour))
        if method in entry.get("paper", ()):
            paper = entry["paper"][method], entry["paper_sd"][method]
            bars.append((f"{label}, paper", *paper, ORANGE))
    values = [mean for _, mean, _, _ in bars if mean is not None]
    high = max(values)
    # A method that makes a task's own formula would stretch the axis by 25 powers of ten.
    low = max(min(values) / 3, high * 1e-7)
    for place, (_, mean, sd, colour) in enumerate(bars):
        if mean is None:
            axes.text(low * 1.2, place, "left its domain", fontsize=8, va="center", color=GREY)
            continue
        error = None if sd is None else [[min(sd, 0.999 * mean)], [sd]]
        axes.barh(place, max(mean, low), xerr=error, color=colour, height=0.7, capsize=2)
        text = f"{mean:.1e}" + (" (off the axis)" if mean < low else "")
        end = max(mean + (sd or 0.0), low)
        axes.text(end * 1.25, place, text, fontsize=8, va="center")
    axes.set_xscale("log")
    axes.set_xlim(low, high * (high / low) ** 0.35)
    axes.set_yticks(range(len(bars)), [label for label, *_ in bars] if labelled else [])
    axes.set_ylim(len(bars) - 0.4, -0.6)


TABLE2 = Experiment("table2", TRIALS, run, tables, draw)
