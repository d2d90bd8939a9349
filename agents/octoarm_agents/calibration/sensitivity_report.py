"""The table and the picture of what each open parameter does."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from octoarm_agents.common.plotting import (
    BLUE,
    GREEN,
    GREY,
    TASK_COLOURS,
    TASK_LABELS,
    VERMILLION,
    new_figure,
    write_letters,
)
from octoarm_agents.experiments.emulation.protocol import TASKS
from octoarm_env import LIMIT_CYCLES

_LEAVES = "leaves its domain"
_CYCLE_MARKS = (("o", BLUE), ("s", VERMILLION), ("D", GREEN))


def sensitivity_markdown(result: Mapping[str, Any]) -> str:
    """A Markdown table: a row a moved parameter, errors as ratios to Table 2, largest R.

    Args:
        result: of `octoarm_agents.calibration.sensitivity.measure_sensitivity`.
    """
    settings = result["settings"]
    trained = settings["noise_seeds"] > 0
    cycles = [f"R of {target}" for target in LIMIT_CYCLES]
    if trained:
        cycles += [f"{target}, plain training" for target in LIMIT_CYCLES]
    columns = ["parameter", "value", *(TASK_LABELS[task] for task in TASKS), "score", *cycles]
    starts = ", ".join(str(start) for start in settings["initial_steps"])
    lines = [
        f"Error divided by that of Table 2 (Task 1, R = {settings['range_degrees']:g}°, mean over"
        f" T_ini = {starts}), the score of both, and the largest R in degrees up to which the"
        f" teacher can force the arm for {settings['teacher_steps']} steps, direct base. Plain"
        " training: outcomes of the paper's own, over noise seeds.",
        "",
        f"| {' | '.join(columns)} |",
        f"|{'---|' * 2}{'---:|' * (len(columns) - 2)}",
    ]
    for change in result["changes"]:
        cells = [change["parameter"], change["label"], *_ratio_cells(change), *_cycle_cells(change)]
        if trained:
            cells += _outcome_cells(change)
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _ratio_cells(change: Mapping[str, Any]) -> list[str]:
    if change["error"] is not None:
        return ["cannot rest"] * (len(TASKS) + 1)
    ratios = change["task1"]["mean_ratios"]
    if ratios is None:
        return [_LEAVES] * len(TASKS) + ["–"]
    return [f"{ratios[task]:.3g}" for task in TASKS] + [f"{change['task1']['score']:.2f}"]


def _cycle_cells(change: Mapping[str, Any]) -> list[str]:
    if change["largest_amplitudes"] is None:
        return ["–"] * len(LIMIT_CYCLES)
    largest = (change["largest_amplitudes"][target] for target in LIMIT_CYCLES)
    return ["none" if each is None else f"{each:g}" for each in largest]


def _outcome_cells(change: Mapping[str, Any]) -> list[str]:
    if change["outcomes"] is None:
        return ["–"] * len(LIMIT_CYCLES)
    cells = []
    for target in LIMIT_CYCLES:
        counts = Counter(change["outcomes"][target]).most_common()
        alone = len(counts) == 1
        cells.append(", ".join(name if alone else f"{count} {name}" for name, count in counts))
    return cells


def draw_sensitivity(result: Mapping[str, Any]) -> Figure:
    """A panel a task: a dot a moved parameter, a cross where the arm leaves its domain.

    The last panel shows the largest R of each cycle.

    Args:
        result: of `octoarm_agents.calibration.sensitivity.measure_sensitivity`.
    """
    changes = result["changes"]
    figure = new_figure(13.0, 1.6 + 0.24 * len(changes))
    panels = figure.subplots(1, len(TASKS) + 1, sharey=True)
    found = [change["task1"] and change["task1"]["mean_ratios"] for change in changes]
    for axes, task in zip(panels, TASKS, strict=False):
        edge = axes.get_yaxis_transform()
        for height, ratios in enumerate(found):
            if ratios:
                axes.plot(ratios[task], height, "o", color=TASK_COLOURS[task], markersize=5)
            else:
                axes.plot(0.97, height, "x", color=GREY, transform=edge, markersize=6)
        if found[0]:
            axes.axvline(found[0][task], color=TASK_COLOURS[task], linewidth=0.9)
        axes.axvline(1.0, color=GREY, linestyle=":", linewidth=0.9)
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_title(TASK_LABELS[task], fontsize=10)
        axes.set_xlabel("error / that of Table 2")
    _draw_amplitudes(panels[-1], changes)
    names = [f"{change['parameter']} {change['label']}".strip() for change in changes]
    panels[0].set_yticks(range(len(changes)), names)
    panels[0].set_ylim(len(changes) - 0.3, -0.7)
    write_letters(list(panels))
    for axes in panels:
        axes.grid(axis="y", color=GREY, alpha=0.2, linewidth=0.6)
    figure.supxlabel(
        "line: the body as it is; dotted: the paper's; cross: leaves its domain", fontsize=8
    )
    return figure


def _draw_amplitudes(axes: Any, changes: list[Mapping[str, Any]]) -> None:
    """The largest R of each cycle, the cycles a little beside each other."""
    for index, (target, (marker, colour)) in enumerate(
        zip(LIMIT_CYCLES, _CYCLE_MARKS, strict=True)
    ):
        points = [
            (change["largest_amplitudes"][target] or 0.0, height + 0.22 * (index - 1))
            for height, change in enumerate(changes)
            if change["largest_amplitudes"] is not None
        ]
        if points:
            label = target.replace("_", " ")
            x, y = zip(*points, strict=True)
            axes.plot(x, y, marker, color=colour, markersize=4, label=label)
    axes.set_xlim(left=-3)
    axes.legend(fontsize=7, frameon=False)
    axes.set_title("largest R of the teacher", fontsize=10)
    axes.set_xlabel("R (degrees)")
