"""Figure 5B: the contribution ratio of each compartment (section 3.1).

The readout is trained with all compartments and tested with the weights of one set to zero. The
contribution ratio is the error of that, divided by the largest over all compartments.
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
    "second_order": "High in compartments 2, 3, 4, 8 and 9, with high standard deviations; low in"
    " 1, 6, 19 and 20, with low ones.",
    "tenth_order": "High in compartments 16, 17 and 18.",
    "volterra": "High in compartments 14 and 15.",
}


def contribution_ratios(trial: Mapping[str, Any], task: str) -> list[float]:
    """Error without each compartment's weights, in units of the largest."""
    errors = [entry[task] for entry in trial["zeroed"]]
    largest = max(errors)
    return [error / largest for error in errors]


def run(context: Context) -> dict[str, Any]:
    """Mean and standard deviation of the contribution ratios."""
    return run_ratios(context, "figure5b", "contribution_ratio", contribution_ratios, PAPER)


def tables(result: Mapping[str, Any]) -> list[ResultTable]:
    """The ratios by compartment."""
    return [ratio_table(result, "contribution_ratio", "Contribution ratio")]


def draw(result: Mapping[str, Any], path: Path) -> None:
    """Bars by compartment."""
    draw_ratios(result, path, "contribution_ratio", "contribution ratio", None)


EXPERIMENT = Experiment("figure5b", TRIALS, run, draw, tables)
