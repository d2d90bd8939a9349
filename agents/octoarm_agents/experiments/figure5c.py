"""Figure 5C: the performance ratio of each compartment (section 3.1).

The readout is trained and tested without one compartment. The performance ratio is the error of
that, divided by the error with all compartments: above 1, the compartment was of use.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from octoarm_agents.experiments.compartments import draw_ratios, ratio_table, run_ratios
from octoarm_agents.experiments.runner import Context, Experiment, ResultTable
from octoarm_agents.experiments.task1 import TRIALS

__all__ = ["EXPERIMENT"]

PAPER = {
    "second_order": "High around the base, in compartments 1, 2, 3 and 4.",
    "tenth_order": "Below 1 around the tip, in compartments beyond 15: over-fitting.",
    "volterra": "High in compartments 14, 15 and 16.",
}


def performance_ratios(trial: Mapping[str, Any], task: str) -> list[float]:
    """Error of readouts trained without each compartment, in units of that with all."""
    return [entry[task] / trial["full"][task] for entry in trial["retrained"]]


def run(context: Context) -> dict[str, Any]:
    """Mean and standard deviation of the performance ratios."""
    return run_ratios(context, "figure5c", "performance_ratio", performance_ratios, PAPER)


def tables(result: Mapping[str, Any]) -> list[ResultTable]:
    """The ratios by compartment."""
    return [ratio_table(result, "performance_ratio", "Performance ratio")]


def draw(result: Mapping[str, Any], path: Path) -> None:
    """Bars by compartment, up or down from 1."""
    draw_ratios(result, path, "performance_ratio", "performance ratio", 1.0)


EXPERIMENT = Experiment("figure5c", TRIALS, run, draw, tables)
