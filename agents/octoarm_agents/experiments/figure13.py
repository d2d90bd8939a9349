"""Figure 13: how a disturbance of one step goes on, and which springs would bring it in (3.2).

(A) Noise is added to the outputs of one step; mean squared differences to the undisturbed run over
the next 500 steps. (B) dw = √(w_1² + w_2²), the size of the outputs' answer to a spring.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from octoarm_agents.common.intervals import format_range
from octoarm_agents.experiments.cycle_settings import CYCLE_LABELS
from octoarm_agents.experiments.figure12 import by_compartment
from octoarm_agents.experiments.runner import Context, Experiment, ResultTable
from octoarm_agents.experiments.task2 import FOLDER, TaughtCycle, teach_cycles
from octoarm_agents.experiments.task2_trials import NUDGED_STEPS, nudge_cycle

__all__ = ["EXPERIMENT", "describe_sizes"]

NUDGES = (0.005, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1)
"""ε [degrees]; the paper names the ends."""

MEASURES = {
    "output_1": "MSE O₁ (degrees²)",
    "output_2": "MSE O₂ (degrees²)",
    "springs": "MSE springs (m²)",
}

PAPER_FEATURES = {
    "grows_with_noise": "All measures increase with ε.",
    "output_1_more_sensitive": "Lissajous: O₁ is more sensitive than O₂.",
    "same_within_compartments": "dw is almost the same within each compartment.",
    "decreases_to_tip": "Quadratic: dw decreases from base to tip, in a zig-zag.",
    "only_near_base": "Lissajous: only compartments around the base have a high dw.",
}

_SAME = 0.2
"""Standard deviation within a compartment, over its mean, below which springs count as the same."""


def run(context: Context) -> dict[str, Any]:
    """Disturb one step, and look at the weights; plain training, a noise seed after the other."""
    assert context.trials is not None
    taught = {
        target: pair["plain"] for target, pair in teach_cycles(context, trainings=["plain"]).items()
    }
    ready = [cycles for cycles in taught.values() if cycles[0].failure is None]
    results = context.run(
        FOLDER,
        nudge_cycle,
        [
            cycles[trial % len(cycles)].settings
            | {"nudges": NUDGES, "seed": context.seed, "trial": trial}
            for cycles in ready
            for trial in range(context.trials)
        ],
    )
    entries: dict[str, Any] = {}
    for target, cycles in taught.items():
        entries[target] = cycles[0].describe() | {
            "failure": cycles[0].failure,
            "nudges": [],
            "dw": [],
        }
    for index, cycles in enumerate(ready):
        trials = results[index * context.trials : (index + 1) * context.trials]
        entries[cycles[0].teaching.target] |= _describe(cycles, trials)
    return {
        "trials": context.trials,
        "followed_steps": NUDGED_STEPS,
        "cycles": entries,
        "paper": PAPER_FEATURES,
        "confirmed": _check_features(entries),
    }


def _describe(cycles: Sequence[TaughtCycle], trials: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Means over trials, and dw of every readout."""
    failed = [trial["failure"] for trial in trials if trial["failure"] is not None]
    entry: dict[str, Any] = {
        "failure": failed[0] if failed else None,
        "dw": [describe_sizes(np.array(cycle.result["weights"])) for cycle in cycles],
        "nudges": [],
    }
    if failed:
        return entry
    for index, nudge in enumerate(NUDGES):
        results = [trial["results"][index] for trial in trials]
        finished = [each for each in results if each["springs"] is not None]
        values = [(*each["outputs"], each["springs"]) for each in finished]
        means = np.mean(values, axis=0).tolist() if values else [None] * len(MEASURES)
        spreads = (
            np.std(values, axis=0, ddof=1).tolist() if len(values) > 1 else [None] * len(MEASURES)
        )
        entry["nudges"].append(
            {
                "nudge_deg": nudge,
                "failed_trials": len(results) - len(finished),
                "mean": dict(zip(MEASURES, means, strict=True)),
                "sd": dict(zip(MEASURES, spreads, strict=True)),
            }
        )
    return entry


def describe_sizes(weights: Any) -> dict[str, Any]:
    """Compute dw and how it is spread over the arm.

    Args:
        weights: (4 N, 2) [degrees/m].

    Returns:
        ``springs`` (N rows of four) and ``compartments`` (their means) [degrees/m],
        ``spread_within`` (median over compartments of standard deviation over mean),
        ``rank_correlation`` of the means with the compartment's number, and ``part_near_base``, of
        the sum, in the first quarter of the arm.
    """
    from scipy.stats import spearmanr

    sizes = by_compartment(np.hypot(weights[:, 0], weights[:, 1]))
    means = sizes.mean(axis=1)
    quarter = max(len(means) // 4, 1)
    return {
        "springs": sizes.tolist(),
        "compartments": means.tolist(),
        "spread_within": float(np.median(sizes.std(axis=1) / means)),
        "rank_correlation": float(spearmanr(np.arange(len(means)), means).statistic),
        "part_near_base": float(means[:quarter].sum() / means.sum()),
    }


def _check_features(cycles: Mapping[str, Any]) -> dict[str, list[bool]]:
    """Whether the paper's observations hold: for the means over trials, or for every readout."""

    def values(target: str, measure: str) -> list[float | None]:
        return [each["mean"][measure] for each in cycles[target]["nudges"]]

    def grows(numbers: Sequence[float | None]) -> bool:
        known = [number for number in numbers if number is not None]
        return len(known) == len(NUDGES) and bool((np.diff(known) > 0).all())

    def sizes(target: str, name: str) -> list[float]:
        return [each[name] for each in cycles[target]["dw"]] if target in cycles else []

    shown = [target for target in ("quadratic", "lissajous") if target in cycles]
    sensitive: list[bool] = []
    if "lissajous" in cycles:
        pairs = zip(values("lissajous", "output_1"), values("lissajous", "output_2"), strict=True)
        sensitive = [a is not None and b is not None and a > b for a, b in pairs]
    return {
        "grows_with_noise": [grows(values(target, name)) for target in shown for name in MEASURES],
        "output_1_more_sensitive": sensitive,
        "same_within_compartments": [
            spread < _SAME for target in shown for spread in sizes(target, "spread_within")
        ],
        "decreases_to_tip": [size < -0.5 for size in sizes("quadratic", "rank_correlation")],
        "only_near_base": [part > 0.5 for part in sizes("lissajous", "part_near_base")],
    }


def tables(result: Mapping[str, Any]) -> list[ResultTable]:
    """The differences at the smallest and the largest ε, and the paper's observations."""
    rows, notes = [], []
    for target, entry in result["cycles"].items():
        if entry["failure"] is not None:
            notes.append(f"{target}: {entry['failure']['message']}.")
        for each in entry["nudges"][:: max(len(entry["nudges"]) - 1, 1)]:
            numbers = ("–" if v is None else f"{v:.2e}" for v in each["mean"].values())
            rows.append((target, f"{each['nudge_deg']:g}", *numbers, str(each["failed_trials"])))
    columns = ("cycle", "ε (°)", *MEASURES.values(), "failed")
    title = f"Mean squared differences over {result['followed_steps']} steps, "
    features = [
        (text, f"{sum(result['confirmed'][name])} of {len(result['confirmed'][name])}")
        for name, text in result["paper"].items()
    ]
    sizes = [
        (
            target,
            format_range([each["spread_within"] for each in entry["dw"]], ".2f"),
            format_range([each["rank_correlation"] for each in entry["dw"]], "+.2f"),
            format_range([each["part_near_base"] for each in entry["dw"]], ".0%"),
        )
        for target, entry in result["cycles"].items()
        if entry["dw"]
    ]
    return [
        ResultTable(title + f"{result['trials']} trials", columns, rows, notes),
        ResultTable(
            "Sizes dw of the weights, smallest to largest over the noise seeds",
            ("cycle", "spread in a compartment", "rank correlation with it", "in first quarter"),
            sizes,
        ),
        ResultTable(
            "The paper's observations (measures of a cycle, sizes ε, or readouts)",
            ("", "confirmed"),
            features,
        ),
    ]


def draw(result: Mapping[str, Any], path: Path) -> None:
    """Differences against ε above, dw by compartment below; a column a cycle."""
    from octoarm_agents.common.plotting import (
        BLUE,
        GREEN,
        GREY,
        ORANGE,
        VERMILLION,
        new_figure,
        save_figure,
        write_letters,
    )
    from octoarm_agents.experiments.cycle_figures import say_missing

    figure = new_figure(13.0, 7.5)
    panels = figure.subplots(2, len(result["cycles"]), squeeze=False)
    colours = (BLUE, VERMILLION, GREEN)
    for (above, below), (target, entry) in zip(panels.T, result["cycles"].items(), strict=True):
        above.set_title(f"{CYCLE_LABELS[target]}, R = {entry['amplitude_deg']:g}°", fontsize=9)
        if entry["nudges"]:
            _draw_differences(above, entry["nudges"], colours)
        else:
            say_missing(above, entry["failure"])
        if not entry["dw"]:
            say_missing(below, entry["failure"])
            continue
        springs, means = np.array(entry["dw"][0]["springs"]), entry["dw"][0]["compartments"]
        numbers = np.arange(1, len(means) + 1)
        below.plot(numbers, means, color=GREY, linewidth=1.0, label="mean")
        for spring, (colour, marker) in enumerate(
            zip((BLUE, ORANGE, GREEN, VERMILLION), "o^sD", strict=True)
        ):
            label = f"spring {spring + 1}"
            below.plot(
                numbers, springs[:, spring], marker, color=colour, markersize=3.5, label=label
            )
        below.set_ylim(bottom=0)
        below.set_xticks([1, *range(5, len(means) + 1, 5)])
        below.set_xlabel("compartment, from the base")
        below.set_ylabel("dw (degrees/m)")
    write_letters(list(panels.ravel()))
    handles, labels = next(
        (axes.get_legend_handles_labels() for axes in panels[1] if axes.lines), ([], [])
    )
    figure.legend(handles, labels, fontsize=9, frameon=False, ncols=5, loc="outside lower center")
    save_figure(figure, path)


def _draw_differences(axes: Any, nudges: Sequence[Mapping[str, Any]], colours: Any) -> None:
    """Outputs on the left scale, springs on the right one; both logarithmic."""
    right = axes.twinx()
    for (measure, label), colour, marker in zip(MEASURES.items(), colours, "o^s", strict=True):
        known = [each for each in nudges if each["mean"][measure] is not None]
        scale = right if measure == "springs" else axes
        scale.plot(
            [each["nudge_deg"] for each in known],
            [each["mean"][measure] for each in known],
            color=colour,
            marker=marker,
            markersize=4,
            linewidth=1.2,
            label=label.partition(" (")[0],
        )
    for each in (axes, right):
        each.set_xscale("log")
        each.set_yscale("log")
    axes.set_xlabel("noise of the single step ε (degrees)")
    axes.set_ylabel("mean square of outputs (degrees²)")
    right.set_ylabel("mean square of springs (m²)", fontsize=9)
    right.tick_params(which="both", labelsize=8)
    right.spines["top"].set_visible(False)
    pairs = [each.get_legend_handles_labels() for each in (axes, right)]
    axes.legend(pairs[0][0] + pairs[1][0], pairs[0][1] + pairs[1][1], fontsize=7, frameon=False)


EXPERIMENT = Experiment("figure13", 15, run, draw, tables)
