"""Figure 13: how a disturbance of one step goes on, and which springs would bring it in (3.2).

(A) Noise is added to the outputs of one step; mean squared differences to the undisturbed run over
the next 500 steps. (B) dw = √(w_1² + w_2²), the size of the outputs' answer to a spring.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from octoarm_agents.common.intervals import format_range
from octoarm_agents.common.plotting import (
    BLUE,
    GREEN,
    GREY,
    VERMILLION,
    new_figure,
    write_letters,
)
from octoarm_agents.experiments.cycles.taught import FOLDER, TaughtCycle, teach_cycles
from octoarm_agents.experiments.cycles.trials import NUDGED_STEPS, nudge_cycle
from octoarm_agents.experiments.plots import (
    SPRING_COLOURS,
    explain_below,
    number_compartments,
    say_missing,
)
from octoarm_agents.experiments.runner import Experiment, RunSettings
from octoarm_agents.experiments.tables import ResultTable, format_number, observation_table
from octoarm_agents.reservoir.cycles import CYCLE_LABELS

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

_SIZES = {"spread_within": ".2f", "rank_correlation": "+.2f", "part_near_base": ".0%"}
"""What is told of dw, and how."""

_SAME = 0.2
"""Standard deviation within a compartment, over its mean, below which springs count as the same."""


def run(settings: RunSettings) -> dict[str, Any]:
    """Disturb one step, and look at the weights; plain training, a noise seed after the other."""
    taught = {
        target: pair["plain"]
        for target, pair in teach_cycles(settings, trainings=["plain"]).items()
    }
    ready = {target: cycles for target, cycles in taught.items() if cycles[0].failure is None}
    points = [[cycle.settings | {"nudges": NUDGES} for cycle in each] for each in ready.values()]
    trials = dict(zip(ready, settings.repeat(FOLDER, nudge_cycle, points), strict=True))
    entries = {
        target: cycles[0].describe() | _describe(cycles, trials.get(target, []))
        for target, cycles in taught.items()
    }
    return {
        "trials": settings.trials,
        "followed_steps": NUDGED_STEPS,
        "cycles": entries,
        "paper": PAPER_FEATURES,
        "confirmed": _check_features(entries),
    }


def _describe(cycles: Sequence[TaughtCycle], trials: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Means over trials, and dw of every readout."""
    if cycles[0].failure is not None:
        return {"failure": cycles[0].failure, "nudges": [], "dw": []}
    failed = [trial["failure"] for trial in trials if trial["failure"] is not None]
    nudges: list[dict[str, Any]] = []
    for index, nudge in enumerate(() if failed else NUDGES):
        results = [trial["results"][index] for trial in trials]
        values = np.array(
            [(*e["outputs"], e["springs"]) for e in results if e["springs"] is not None]
        )
        failures = {"nudge_deg": nudge, "failed_trials": len(results) - len(values)}
        nudges.append(failures | dict.fromkeys(("mean", "sd"), dict.fromkeys(MEASURES)))
        if len(values):
            nudges[-1]["mean"] = dict(zip(MEASURES, values.mean(axis=0).tolist(), strict=True))
        if len(values) > 1:
            sd = values.std(axis=0, ddof=1).tolist()
            nudges[-1]["sd"] = dict(zip(MEASURES, sd, strict=True))
    return {
        "failure": failed[0] if failed else None,
        "nudges": nudges,
        "dw": [describe_sizes(np.array(cycle.result["weights"])) for cycle in cycles],
    }


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

    sizes = np.hypot(weights[:, 0], weights[:, 1]).reshape(-1, 4)
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

    def means_of(target: str) -> list[Any]:
        return [each["mean"] for each in cycles[target]["nudges"]]

    def grows(target: str, measure: str) -> bool:
        known = [means[measure] for means in means_of(target) if means[measure] is not None]
        return len(known) == len(NUDGES) and bool((np.diff(known) > 0).all())

    def sizes(target: str, name: str) -> list[float]:
        return [each[name] for each in cycles[target]["dw"]]

    shown = ("quadratic", "lissajous")
    outputs = [(means["output_1"], means["output_2"]) for means in means_of("lissajous")]
    spreads = [spread for target in shown for spread in sizes(target, "spread_within")]
    return {
        "grows_with_noise": [grows(target, measure) for target in shown for measure in MEASURES],
        "output_1_more_sensitive": [
            first is not None and first > second for first, second in outputs
        ],
        "same_within_compartments": [spread < _SAME for spread in spreads],
        "decreases_to_tip": [size < -0.5 for size in sizes("quadratic", "rank_correlation")],
        "only_near_base": [part > 0.5 for part in sizes("lissajous", "part_near_base")],
    }


def tables(result: Mapping[str, Any]) -> list[ResultTable]:
    """The differences at the smallest and the largest ε, and the paper's observations."""
    rows, notes, sizes = [], [], []
    for target, entry in result["cycles"].items():
        if entry["failure"] is not None:
            notes.append(f"{target}: {entry['failure']['message']}.")
        for each in entry["nudges"][:: max(len(entry["nudges"]) - 1, 1)]:
            numbers = map(format_number, each["mean"].values())
            rows.append((target, f"{each['nudge_deg']:g}", *numbers, str(each["failed_trials"])))
        if entry["dw"]:
            told = [
                format_range([each[name] for each in entry["dw"]], digits)
                for name, digits in _SIZES.items()
            ]
            sizes.append((target, *told))
    title = f"Mean squared differences over {result['followed_steps']} steps, "
    return [
        ResultTable(
            title + f"{result['trials']} trials",
            ("cycle", "ε (°)", *MEASURES.values(), "failed"),
            rows,
            notes,
        ),
        ResultTable(
            "Sizes dw of the weights, smallest to largest over the noise seeds",
            ("cycle", "spread in a compartment", "rank correlation with it", "in first quarter"),
            sizes,
        ),
        observation_table(
            "The paper's observations (measures of a cycle, sizes ε, or readouts)",
            result["paper"],
            {"confirmed": result["confirmed"]},
        ),
    ]


def draw(result: Mapping[str, Any]) -> Figure:
    """Differences against ε above, dw by compartment below; a column a cycle."""
    figure = new_figure(13.0, 7.5)
    panels = figure.subplots(2, len(result["cycles"]), squeeze=False)
    for (above, below), (target, entry) in zip(panels.T, result["cycles"].items(), strict=True):
        above.set_title(f"{CYCLE_LABELS[target]}, R = {entry['amplitude_deg']:g}°", fontsize=9)
        if entry["nudges"]:
            _draw_differences(above, entry["nudges"])
        else:
            say_missing(above, entry["failure"])
        if not entry["dw"]:
            say_missing(below, entry["failure"])
            continue
        springs, means = np.array(entry["dw"][0]["springs"]), entry["dw"][0]["compartments"]
        numbers = np.arange(1, len(means) + 1)
        below.plot(numbers, means, color=GREY, linewidth=1.0, label="mean")
        for spring, (colour, marker) in enumerate(zip(SPRING_COLOURS, "o^sD", strict=True)):
            style = {"color": colour, "markersize": 3.5, "label": f"spring {spring + 1}"}
            below.plot(numbers, springs[:, spring], marker, **style)
        below.set_ylim(bottom=0)
        number_compartments(below, len(means))
        below.set_ylabel("dw (degrees/m)")
    write_letters(list(panels.flat))
    explain_below(figure, panels[1], columns=5)
    return figure


def _draw_differences(axes: Axes, nudges: Sequence[Mapping[str, Any]]) -> None:
    """Outputs on the left scale, springs on the right one; both logarithmic."""
    right = axes.twinx()
    styles = zip((BLUE, VERMILLION, GREEN), "o^s", strict=True)
    for (measure, label), (colour, marker) in zip(MEASURES.items(), styles, strict=True):
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
    axes.legend(handles=[*axes.lines, *right.lines], fontsize=7, frameon=False)


FIGURE13 = Experiment("figure13", 15, run, tables, draw)
