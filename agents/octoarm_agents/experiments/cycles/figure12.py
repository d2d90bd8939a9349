"""Figure 12: the weights of the readouts that hold the limit cycles (section 3.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from octoarm_agents.common.intervals import format_range
from octoarm_agents.common.plotting import GREY, new_figure, write_letters
from octoarm_agents.experiments.cycles.taught import teach_cycles
from octoarm_agents.experiments.plots import (
    SPRING_COLOURS,
    explain_below,
    number_compartments,
    say_missing,
)
from octoarm_agents.experiments.runner import Experiment, RunSettings
from octoarm_agents.experiments.tables import ResultTable, observation_table
from octoarm_agents.reservoir.cycles import CYCLE_LABELS, TRAININGS
from octoarm_env.arrays import Float

BASE_COMPARTMENTS = 6
"""In the paper's Lissajous curve, output 1 has almost no weights beyond compartment 6."""

_ALIKE = 0.5
"""Size of a correlation from which on two patterns of weights count as corresponding."""

_ALMOST_ALL = 0.9
"""Part of the sum of squares from which on the rest counts as almost without weights."""

PAPER_FEATURES = {
    "quadratic_springs": "Quadratic: springs 1, 2 correspond to springs 3, 4.",
    "quadratic_outputs": "Quadratic: output 1 corresponds to output 2.",
    "lissajous_springs": "Lissajous: springs 1, 2 correspond to springs 3, 4.",
    "lissajous_outputs": "Lissajous: output 1 does not correspond to output 2.",
    "lissajous_near_base": "Lissajous: output 1 has almost no weights beyond compartment 6.",
}


def run(settings: RunSettings) -> dict[str, Any]:
    """Weights of both trainings, and what the paper says of them as numbers."""
    cycles: dict[str, Any] = {}
    for target, pair in teach_cycles(settings).items():
        cycles[target] = {}
        for training, taught in pair.items():
            entry = cycles[target][training] = taught[0].describe() | {"readouts": []}
            if taught[0].failure is not None:
                continue
            for cycle in taught:
                weights = np.array(cycle.result["weights"])
                entry["readouts"].append(
                    {
                        "seed": cycle.teaching.seed,
                        "outputs": [describe_weights(column) for column in weights.T],
                        "correlation_of_outputs": _correlation(*weights.T),
                    }
                )
    return {
        "trials": 1,
        "cycles": cycles,
        "paper": PAPER_FEATURES,
        "confirmed": {training: _check_features(cycles, training) for training in TRAININGS},
    }


def _check_features(cycles: Mapping[str, Any], training: str) -> dict[str, list[bool]]:
    """Whether the paper's observations hold, for each repetition of a training."""

    def each(target: str, holds: Callable[[Mapping[str, Any]], bool]) -> list[bool]:
        return [holds(readout) for readout in cycles[target][training]["readouts"]]

    def springs_alike(readout: Mapping[str, Any]) -> bool:
        return all(abs(output["correlation_of_pairs"]) >= _ALIKE for output in readout["outputs"])

    def outputs_alike(readout: Mapping[str, Any]) -> bool:
        return bool(abs(readout["correlation_of_outputs"]) >= _ALIKE)

    return {
        "quadratic_springs": each("quadratic", springs_alike),
        "quadratic_outputs": each("quadratic", outputs_alike),
        "lissajous_springs": each("lissajous", springs_alike),
        "lissajous_outputs": each("lissajous", lambda readout: not outputs_alike(readout)),
        "lissajous_near_base": each(
            "lissajous", lambda readout: readout["outputs"][0]["part_near_base"] >= _ALMOST_ALL
        ),
    }


def describe_weights(weights: Float) -> dict[str, Any]:
    """The weights of an output, and the paper's observations as numbers.

    Args:
        weights: (4 N,), in the order of the springs [degrees/m].

    Returns:
        ``weights`` (N rows of four), ``correlation_of_pairs`` of springs 1, 2 with springs 3, 4,
        and ``part_near_base``, what compartments 1 to 6 have of the sum of squares.
    """
    table = weights.reshape(-1, 4)
    squares = np.square(table).sum(axis=1)
    return {
        "weights": table.tolist(),
        "correlation_of_pairs": _correlation(table[:, :2].ravel(), table[:, 2:].ravel()),
        "part_near_base": float(squares[:BASE_COMPARTMENTS].sum() / squares.sum()),
    }


def _correlation(first: Float, second: Float) -> float:
    return float(np.corrcoef(first, second)[0, 1])


def tables(result: Mapping[str, Any]) -> list[ResultTable]:
    """The paper's observations as numbers, over the repetitions of a training, and the verdicts."""
    rows, notes = [], []
    for target, pair in result["cycles"].items():
        for training, entry in pair.items():
            readouts = entry["readouts"]
            if not readouts:
                notes.append(f"{target}: {entry['teaching_failure']['message']}.")
                continue
            between = format_range([each["correlation_of_outputs"] for each in readouts], "+.2f")
            for number in range(2):
                outputs = [readout["outputs"][number] for readout in readouts]
                largest = [np.abs(output["weights"]).max() for output in outputs]
                pairs = [output["correlation_of_pairs"] for output in outputs]
                near_base = [output["part_near_base"] for output in outputs]
                rows.append(
                    (
                        target,
                        training,
                        str(number + 1),
                        format_range(largest, ".3g"),
                        format_range(pairs, "+.2f"),
                        format_range(near_base, ".0%"),
                        between,
                    )
                )
    columns = (
        *("cycle", "training", "output", "largest (°/m)", "springs 1, 2 with 3, 4"),
        *(f"squares in 1-{BASE_COMPARTMENTS}", "output 1 with 2"),
    )
    title = "Weights and their correlations, smallest to largest over the noise seeds"
    return [
        ResultTable(title, columns, rows, notes),
        observation_table(
            f"The paper's observations (correspond: correlation of {_ALIKE:g} or more in size)",
            result["paper"],
            result["confirmed"],
        ),
    ]


def draw(result: Mapping[str, Any]) -> Figure:
    """Bars of the plain training's first readouts, a row a cycle and a column an output.

    The four springs of a compartment stand together.
    """
    figure = new_figure(13.0, 8.5)
    panels = figure.subplots(len(result["cycles"]), 2, squeeze=False)
    for row, (target, pair) in zip(panels, result["cycles"].items(), strict=True):
        entry = pair["plain"]
        for number, axes in enumerate(row):
            if not entry["readouts"]:
                say_missing(axes, entry["teaching_failure"])
                continue
            weights = np.array(entry["readouts"][0]["outputs"][number]["weights"])
            compartments = np.arange(1, len(weights) + 1)
            for spring, colour in enumerate(SPRING_COLOURS):
                axes.bar(
                    compartments + 0.2 * (spring - 1.5),
                    weights[:, spring],
                    width=0.2,
                    color=colour,
                    label=f"spring {spring + 1}",
                )
            axes.axhline(0, color=GREY, linewidth=0.6)
            number_compartments(axes, len(weights))
            axes.set_xlim(0.4, len(weights) + 0.6)
            axes.set_ylabel(f"weight of output {number + 1}\n(degrees/m)")
            axes.set_title(f"{CYCLE_LABELS[target]}, R = {entry['amplitude_deg']:g}°", fontsize=9)
    for axes in panels[:-1].flat:
        axes.set_xlabel("")
    write_letters(list(panels.flat))
    explain_below(figure, panels.flat, columns=4)
    return figure


FIGURE12 = Experiment("figure12", 1, run, tables, draw)
