"""What Figures 5B and 5C share: the errors without one compartment, over trials."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from octoarm_agents.common.intervals import summarise
from octoarm_agents.experiments.refusal import RefusedError
from octoarm_agents.experiments.runner import Context, ResultTable
from octoarm_agents.experiments.task1 import RANGE, TASKS, check_timestep
from octoarm_agents.experiments.task1_trials import leave_out_compartments, record_trials

__all__ = ["draw_ratios", "ratio_table", "run_ratios"]

Ratios = Callable[[Mapping[str, Any], str], Sequence[float]]


def run_ratios(
    context: Context, name: str, quantity: str, ratios: Ratios, paper: Mapping[str, str]
) -> dict[str, Any]:
    """Run the trials, and take mean and standard deviation of a ratio by compartment.

    Args:
        context: what the experiment is run with.
        name: of the experiment.
        quantity: key of the ratios in the result.
        ratios: of one trial and task, from what `leave_out_compartments` gives; (compartments,).
        paper: what the paper says of each task.

    Raises:
        ValueError: a body of one compartment, or of another timestep than the paper's.
    """
    check_timestep(context.parameters)
    compartments = context.parameters.compartments
    if compartments < 2:
        raise RefusedError("compartments = 1: none can be left out of a single one")
    assert context.trials is not None
    amplitude = RANGE if context.amplitude is None else context.amplitude
    trials = context.run(
        name,
        leave_out_compartments,
        [
            {"kind": "sines", "amplitude": amplitude, "seed": context.seed, "trial": trial}
            for trial in range(context.trials)
        ],
        record=record_trials,
    )
    finished = [trial for trial in trials if trial["failure"] is None]
    tasks: dict[str, Any] = {}
    for task in TASKS:
        table = np.array([ratios(trial, task) for trial in finished]).reshape(-1, compartments)
        summaries = [summarise(column.tolist()) for column in table.T]
        means = [summary["mean"] for summary in summaries]
        tasks[task] = {
            quantity: {"mean": means, "sd": [summary["sd"] for summary in summaries]},
            "highest": [int(k) + 1 for k in np.argsort(table.mean(axis=0))[:-4:-1]]
            if finished
            else None,
            "full": summarise([trial["full"][task] for trial in finished]),
            "paper": paper[task],
        }
    return {
        "range_deg": amplitude,
        "trials": context.trials,
        "failures": [
            {"trial": trial["trial"]} | trial["failure"]
            for trial in trials
            if trial["failure"] is not None
        ],
        "compartments": list(range(1, compartments + 1)),
        "tasks": tasks,
    }


def ratio_table(result: Mapping[str, Any], quantity: str, title: str) -> ResultTable:
    """Mean and standard deviation by compartment and task."""
    rows = []
    for index, compartment in enumerate(result["compartments"]):
        cells = []
        for task in TASKS:
            ratio = result["tasks"][task][quantity]
            mean, sd = ratio["mean"][index], ratio["sd"][index]
            cells.append(
                "–" if mean is None else f"{mean:.3g}" + ("" if sd is None else f" ± {sd:.2g}")
            )
        rows.append((str(compartment), *cells))
    notes = [f"Trial {each['trial']} failed: {each['message']}." for each in result["failures"]]
    return ResultTable(
        f"{title}, R = {result['range_deg']:g}°, {result['trials']} trials",
        ("compartment", "2nd order", "10th order", "Volterra"),
        rows,
        notes,
    )


def draw_ratios(
    result: Mapping[str, Any], path: Path, quantity: str, label: str, reference: float | None
) -> None:
    """Bars with standard deviations by compartment, one panel a task.

    Args:
        result: what `run_ratios` gave.
        path: of the figure.
        quantity: key of the ratios in the result.
        label: of the vertical axis.
        reference: where to draw a horizontal line, and let the bars begin.
    """
    from octoarm_agents.common.plotting import (
        BLACK,
        GREY,
        TASK_COLOURS,
        TASK_LABELS,
        new_figure,
        save_figure,
        write_letters,
    )

    figure = new_figure(11.0, 3.6)
    panels = figure.subplots(1, 3)
    compartments = np.array(result["compartments"])
    for axes, task in zip(panels, TASKS, strict=True):
        ratio = result["tasks"][task][quantity]
        if ratio["mean"][0] is None:
            axes.text(0.5, 0.5, "every trial failed", transform=axes.transAxes, ha="center")
        else:
            base = 0.0 if reference is None else reference
            spread = None if ratio["sd"][0] is None else ratio["sd"]
            axes.bar(
                compartments,
                np.array(ratio["mean"]) - base,
                bottom=base,
                yerr=spread,
                color=TASK_COLOURS[task],
                width=0.75,
                capsize=2,
                error_kw={"linewidth": 0.9, "ecolor": GREY},
            )
        if reference is not None:
            axes.axhline(reference, color=BLACK, linewidth=0.8)
        axes.set_title(TASK_LABELS[task], fontsize=10)
        axes.set_xlabel("compartment, from the base")
        axes.set_xticks([1, *range(5, len(compartments) + 1, 5)])
    panels[0].set_ylabel(label)
    write_letters(list(panels))
    save_figure(figure, path)
