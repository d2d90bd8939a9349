"""Figures 5B and 5C: what the readout has of each compartment (section 3.1).

The contribution ratio (5B) is the error of a readout trained with all compartments and tested with
the weights of one set to zero, divided by the largest over all compartments. The performance ratio
(5C) is the error of a readout trained and tested without one compartment, divided by the error with
all: above 1, the compartment was of use.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from octoarm_agents.common.intervals import summarise
from octoarm_agents.common.plotting import (
    BLACK,
    GREY,
    TASK_COLOURS,
    TASK_LABELS,
    new_figure,
    write_letters,
)
from octoarm_agents.experiments.emulation.protocol import RANGE, TASK_HEADINGS, TASKS, TRIALS
from octoarm_agents.experiments.emulation.trials import (
    leave_out_compartments,
    list_failures,
    make_trials,
    note_failures,
)
from octoarm_agents.experiments.plots import number_compartments
from octoarm_agents.experiments.runner import Experiment, RefusedError, RunSettings
from octoarm_agents.experiments.tables import ResultTable, format_spread


@dataclass(frozen=True)
class Ratio:
    """One of the two ratios.

    Attributes:
        experiment: its name.
        name: of the ratio.
        compute: its values, (compartments,), from a trial of `leave_out_compartments` and a task.
        paper: what the paper says of each task.
        reference: where the bars begin, marked by a line unless it is zero.
    """

    experiment: str
    name: str
    compute: Callable[[Mapping[str, Any], str], Sequence[float]]
    paper: Mapping[str, str]
    reference: float = 0.0

    @property
    def key(self) -> str:
        """In the JSON file."""
        return self.name.replace(" ", "_")

    def run(self, settings: RunSettings) -> dict[str, Any]:
        """Mean and standard deviation over the trials, by compartment."""
        compartments = settings.parameters.compartments
        if compartments < 2:
            raise RefusedError("compartments = 1: none can be left out of a single one")
        amplitude = RANGE if settings.amplitude is None else settings.amplitude
        point = {"kind": "sines", "amplitude": amplitude}
        (trials,) = make_trials(settings, self.experiment, leave_out_compartments, [point])
        finished = [trial for trial in trials if trial["failure"] is None]
        tasks: dict[str, Any] = {}
        for task in TASKS:
            ratios = np.array([self.compute(trial, task) for trial in finished])
            summaries = [summarise(each.tolist()) for each in ratios.reshape(-1, compartments).T]
            tasks[task] = {
                self.key: {name: [each[name] for each in summaries] for name in ("mean", "sd")},
                "highest": [int(k) + 1 for k in np.argsort(ratios.mean(axis=0))[:-4:-1]]
                if finished
                else None,
                "full": summarise([trial["full"][task] for trial in finished]),
                "paper": self.paper[task],
            }
        return {
            "range_deg": amplitude,
            "trials": settings.trials,
            "failures": list_failures(trials),
            "compartments": list(range(1, compartments + 1)),
            "tasks": tasks,
        }

    def tables(self, result: Mapping[str, Any]) -> list[ResultTable]:
        """The ratios by compartment and task."""
        ratios = [result["tasks"][task][self.key] for task in TASKS]
        rows = [
            (
                str(compartment),
                *(format_spread(each["mean"][k], each["sd"][k], ".3g", ".2g") for each in ratios),
            )
            for k, compartment in enumerate(result["compartments"])
        ]
        title = f"{self.name.capitalize()}, R = {result['range_deg']:g}°, {result['trials']} trials"
        return [ResultTable(title, ("compartment", *TASK_HEADINGS), rows, note_failures(result))]

    def draw(self, result: Mapping[str, Any]) -> Figure:
        """Bars with standard deviations by compartment, one panel a task."""
        figure = new_figure(11.0, 3.6)
        panels = figure.subplots(1, 3)
        compartments = np.array(result["compartments"])
        for axes, task in zip(panels, TASKS, strict=True):
            ratio = result["tasks"][task][self.key]
            if ratio["mean"][0] is None:
                axes.text(0.5, 0.5, "every trial failed", transform=axes.transAxes, ha="center")
            else:
                axes.bar(
                    compartments,
                    np.array(ratio["mean"]) - self.reference,
                    bottom=self.reference,
                    yerr=None if ratio["sd"][0] is None else ratio["sd"],
                    color=TASK_COLOURS[task],
                    width=0.75,
                    capsize=2,
                    error_kw={"linewidth": 0.9, "ecolor": GREY},
                )
            if self.reference:
                axes.axhline(self.reference, color=BLACK, linewidth=0.8)
            axes.set_title(TASK_LABELS[task], fontsize=10)
            number_compartments(axes, len(compartments))
        panels[0].set_ylabel(self.name)
        write_letters(panels)
        return figure


def contribution_ratios(trial: Mapping[str, Any], task: str) -> list[float]:
    """Error without each compartment's weights, in units of the largest."""
    errors = [entry[task] for entry in trial["zeroed"]]
    largest = max(errors)
    return [error / largest for error in errors]


def performance_ratios(trial: Mapping[str, Any], task: str) -> list[float]:
    """Error of readouts trained without each compartment, in units of that with all."""
    return [entry[task] / trial["full"][task] for entry in trial["retrained"]]


_CONTRIBUTION = Ratio(
    "figure5b",
    "contribution ratio",
    contribution_ratios,
    {
        "second_order": "High in compartments 2, 3, 4, 8 and 9, with high standard deviations; low"
        " in 1, 6, 19 and 20, with low ones.",
        "tenth_order": "High in compartments 16, 17 and 18.",
        "volterra": "High in compartments 14 and 15.",
    },
)

_PERFORMANCE = Ratio(
    "figure5c",
    "performance ratio",
    performance_ratios,
    {
        "second_order": "High around the base, in compartments 1, 2, 3 and 4.",
        "tenth_order": "Below 1 around the tip, in compartments beyond 15: over-fitting.",
        "volterra": "High in compartments 14, 15 and 16.",
    },
    reference=1.0,
)

FIGURE5B, FIGURE5C = (
    Experiment(each.experiment, TRIALS, each.run, each.tables, each.draw)
    for each in (_CONTRIBUTION, _PERFORMANCE)
)
