"""Figure 12: the weights of the readouts that hold the limit cycles (section 3.2)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octoarm_agents.experiments import EXPERIMENTS
from octoarm_agents.experiments.cycle_settings import CYCLE_LABELS
from octoarm_agents.experiments.runner import Context, Experiment, ResultTable
from octoarm_agents.experiments.task2 import teach_cycles

__all__ = ["EXPERIMENT", "by_compartment", "describe_weights"]

Float = NDArray[np.float64]

SPRINGS = 4
BASE_COMPARTMENTS = 6
"""In the paper's Lissajous curve, output 1 has almost no weights beyond compartment 6."""

PAPER = {
    "quadratic": "Symmetric and corresponding over springs (1, 2 and 3, 4 of compartments 3 to 13),"
    " and over both outputs.",
    "van_der_pol": "Not shown.",
    "lissajous": "Symmetric within each output, not over both; output 1 has almost none in"
    " compartments 7 to 20.",
}


def run(context: Context) -> dict[str, Any]:
    """Weights of the direct base's readouts, and what the paper says of them as numbers."""
    cycles: dict[str, Any] = {}
    for target, by_actuator in teach_cycles(context, actuators=["direct"]).items():
        cycle = by_actuator["direct"]
        entry = cycle.describe() | {"paper": PAPER[target], "outputs": None}
        if cycle.failure is None:
            weights = np.array(cycle.result["weights"])
            entry["outputs"] = [describe_weights(column) for column in weights.T]
            entry["correlation_of_outputs"] = _correlation(*weights.T)
        cycles[target] = entry
    return {"trials": 1, "cycles": cycles}


def describe_weights(weights: Float) -> dict[str, Any]:
    """The weights of an output, and the paper's observations as numbers.

    Args:
        weights: (4 N,), in the order of the springs [degrees/m].

    Returns:
        ``weights`` (N rows of four), ``correlation_of_pairs`` of springs 1, 2 with springs 3, 4,
        and ``part_near_base``, what compartments 1 to 6 have of the sum of squares.
    """
    table = by_compartment(weights)
    squares = np.square(table).sum(axis=1)
    return {
        "weights": table.tolist(),
        "correlation_of_pairs": _correlation(table[:, :2].ravel(), table[:, 2:].ravel()),
        "part_near_base": float(squares[:BASE_COMPARTMENTS].sum() / squares.sum()),
    }


def by_compartment(values: Float) -> Float:
    """Values of springs, (4 N,), as a row (4,) each compartment."""
    return values.reshape(-1, SPRINGS)


def _correlation(first: Float, second: Float) -> float:
    return float(np.corrcoef(first, second)[0, 1])


def tables(result: Mapping[str, Any]) -> list[ResultTable]:
    """The paper's observations as numbers."""
    rows, notes = [], []
    for target, entry in result["cycles"].items():
        if entry["outputs"] is None:
            notes.append(f"{target}: {entry['teaching_failure']['message']}.")
            continue
        for number, output in enumerate(entry["outputs"], 1):
            weights = np.array(output["weights"])
            rows.append(
                (
                    target,
                    str(number),
                    f"{np.abs(weights).max():.3g}",
                    f"{output['correlation_of_pairs']:+.2f}",
                    f"{output['part_near_base']:.0%}",
                    f"{entry['correlation_of_outputs']:+.2f}",
                )
            )
        notes.append(f"The paper, {target}: {entry['paper']}")
    columns = (
        "cycle",
        "output",
        "largest (°/m)",
        "springs 1, 2 with 3, 4",
        f"squares in 1-{BASE_COMPARTMENTS}",
        "output 1 with 2",
    )
    return [ResultTable("Weights and their correlations, direct base", columns, rows, notes)]


def draw(result: Mapping[str, Any], path: Path) -> None:
    """Bars, a row a cycle and a column an output; the four springs of a compartment together."""
    from octoarm_agents.experiments.cycle_figures import say_missing
    from octoarm_agents.experiments.figures import (
        BLUE,
        GREEN,
        GREY,
        ORANGE,
        VERMILLION,
        new_figure,
        save_figure,
        write_letters,
    )

    figure = new_figure(13.0, 8.5)
    panels = figure.subplots(len(result["cycles"]), 2, squeeze=False)
    for row, (target, entry) in zip(panels, result["cycles"].items(), strict=True):
        for number, axes in enumerate(row):
            if entry["outputs"] is None:
                say_missing(axes, entry["teaching_failure"])
                continue
            weights = np.array(entry["outputs"][number]["weights"])
            compartments = np.arange(1, len(weights) + 1)
            for spring, colour in enumerate((BLUE, ORANGE, GREEN, VERMILLION)):
                axes.bar(
                    compartments + 0.2 * (spring - 1.5),
                    weights[:, spring],
                    width=0.2,
                    color=colour,
                    label=f"spring {spring + 1}",
                )
            axes.axhline(0, color=GREY, linewidth=0.6)
            axes.set_xticks([1, *range(5, len(weights) + 1, 5)])
            axes.set_xlim(0.4, len(weights) + 0.6)
            axes.set_ylabel(f"weight of output {number + 1}\n(degrees/m)")
            axes.set_title(f"{CYCLE_LABELS[target]}, R = {entry['amplitude_deg']:g}°", fontsize=9)
    for axes in panels[-1]:
        axes.set_xlabel("compartment, from the base")
    write_letters(list(panels.ravel()))
    handles, labels = next(
        (axes.get_legend_handles_labels() for axes in panels.ravel() if axes.patches), ([], [])
    )
    figure.legend(handles, labels, fontsize=9, frameon=False, ncols=4, loc="outside lower center")
    save_figure(figure, path)


EXPERIMENT = Experiment("figure12", EXPERIMENTS["figure12"], 1, run, draw, tables)
