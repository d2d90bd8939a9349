"""What decides whether a limit cycle is held: the stability of the loop, beyond the paper.

Section 3.2 finds success "extremely sensitive" to R and ν. Here readouts are fitted over ν and R,
as in the paper and with the ridge weighted by disturbances (`octoarm_agents.reservoir.teaching`).
Three numbers of each loop are set against what it did when the arm was let go:

- the leading Floquet exponents on the teacher's orbit: if more than the phase's is above zero, the
  loop leaves it;
- the response to white noise: a loop with negative exponents can still be lost, if deviations grow
  before they die out and leave the small basin in which they do;
- the training error: a loop that is stable about a wrong orbit is none that holds the cycle.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from octoarm_agents.common.plotting import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    PURPLE,
    VERMILLION,
    new_figure,
    write_letters,
)
from octoarm_agents.experiments.cycles.floquet_trials import (
    PHASE_ERROR,
    RESPONSE_NOISES,
    RESPONSE_TURNS,
    is_stable,
    is_thrown_far,
    probe_loops,
)
from octoarm_agents.experiments.cycles.taught import FOLDER
from octoarm_agents.experiments.plots import say_missing
from octoarm_agents.experiments.runner import Experiment, RunSettings
from octoarm_agents.experiments.tables import ResultTable
from octoarm_agents.reservoir.closed_loop import HELD_DISTANCE
from octoarm_agents.reservoir.cycles import CYCLE_LABELS, CYCLES

STEPS = 20_000
AMPLITUDES = (0.5, 1.0, 1.5)
"""R tried, in units of the cycle's own."""

NOISES = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5)
FACTORS = (0.0, 0.1, 1.0, 10.0)
"""ν [m], and factors of the cycle's own κ; 0 is the paper's training."""


_COLOURS = (VERMILLION, PURPLE, BLUE, GREEN)
_MARKERS = "osD"

_EXPONENTS = (-3.0, 1e3)
_LEFT = 1e6
"""Response at which loops are drawn whose arm left its domain, above all others."""


def run(settings: RunSettings) -> dict[str, Any]:
    """Numbers and fate of every loop of the grid."""
    steps = STEPS if settings.steps is None else settings.steps
    teachings = []
    for trainings in CYCLES.values():
        own = trainings["weighted"]
        tried = [round(part * own.amplitude, 6) for part in AMPLITUDES]
        for amplitude in tried if settings.amplitude is None else [settings.amplitude]:
            teachings.append(replace(own, amplitude=amplitude, seed=own.seed + settings.seed))
    grid = {"noises": NOISES, "factors": FACTORS, "steps": steps}
    trials = [{"teaching": asdict(each)} | grid for each in teachings]
    results = settings.run(FOLDER, probe_loops, trials)
    cycles: dict[str, list[dict[str, Any]]] = {target: [] for target in CYCLES}
    for teaching, result in zip(teachings, results, strict=True):
        cycles[teaching.target].append(
            {
                "amplitude_deg": teaching.amplitude,
                "disturbances": list(teaching.disturbances),
            }
            | result
        )
    return {
        "trials": 1,
        "steps": steps,
        "exponent_turns": RESPONSE_TURNS,
        "phase_error": PHASE_ERROR,
        "response_noises": list(RESPONSE_NOISES),
        "cycles": cycles,
        "verdict": _judge([loop for _, _, loop in _all_loops(cycles)]),
    }


def _all_loops(
    cycles: Mapping[str, Sequence[Mapping[str, Any]]],
) -> Iterable[tuple[str, Mapping[str, Any], Mapping[str, Any]]]:
    """Target, entry of its R, and loop."""
    for target, entries in cycles.items():
        for entry in entries:
            for loop in entry["loops"]:
                yield target, entry, loop


def _judge(loops: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """How well the numbers of the loops tell which are held."""
    held = [loop for loop in loops if loop["held"]]
    stable = [loop for loop in loops if is_stable(loop)]
    lost = [loop for loop in stable if not loop["held"]]
    largest = max((loop["training_error"] for loop in held), default=None)
    wrong = [loop for loop in lost if largest is not None and loop["training_error"] > largest]
    far = [loop for loop in lost if is_thrown_far(loop)]
    return {
        "loops": len(loops),
        "held": len(held),
        "stable": len(stable),
        "held_and_stable": sum(is_stable(loop) for loop in held),
        "stable_but_lost": len(lost),
        "of_them_thrown_far": len(far),
        "of_them_error_above_all_held": len(wrong),
        "of_them_neither": sum(not (loop in far or loop in wrong) for loop in lost),
        "largest_error_held": largest,
    }


def tables(result: Mapping[str, Any]) -> list[ResultTable]:
    """Exponents by R, κ and ν, a table a cycle; then the loops that were lost though stable."""
    found = []
    for target, entries in result["cycles"].items():
        rows, notes = [], []
        noises = sorted({loop["noise"] for entry in entries for loop in entry["loops"]})
        for entry in entries:
            if entry["failure"] is not None:
                notes.append(f"R = {entry['amplitude_deg']:g}°: {entry['failure']['message']}.")
            for factor in dict.fromkeys(loop["factor"] for loop in entry["loops"]):
                loops = [loop for loop in entry["loops"] if loop["factor"] == factor]
                cells = {loop["noise"]: _exponents(loop) for loop in loops}
                rows.append((_weighting(entry, factor), *(cells[noise] for noise in noises)))
        columns = ("R, weighting", *(f"ν = {noise:.0e}" for noise in noises))
        title = (
            f"{CYCLE_LABELS[target]}: leading two exponents (1/s) by ν (m),"
            f" * held for {result['steps']} steps"
        )
        found.append(ResultTable(title, columns, rows, notes))
    return [*found, _lost_though_stable(result)]


def _weighting(entry: Mapping[str, Any], factor: float) -> str:
    return f"{entry['amplitude_deg']:g}°, {factor:g} κ"


def _exponents(loop: Mapping[str, Any]) -> str:
    exponents = loop["exponents"][:2]
    numbers = "/".join(f"{value:.{1 if abs(value) < 10 else 0}f}" for value in exponents)
    return (numbers or "huge") + ("*" if loop["held"] else "")


def _lost_though_stable(result: Mapping[str, Any]) -> ResultTable:
    rows = [
        (
            target,
            _weighting(entry, loop["factor"]),
            f"{loop['noise']:.0e}",
            f"{loop['leading_exponent']:+.2f}",
            f"{loop['training_error']:.1e}",
            *("lost" if value is None else f"{value:.0f}" for value in loop["responses"]),
        )
        for target, entry, loop in _all_loops(result["cycles"])
        if is_stable(loop) and not loop["held"]
    ]
    responses = [f"noise {size:.0e}" for size in result["response_noises"]]
    columns = ("cycle", "R, weighting", "ν (m)", "exponent", "error / R", *responses)
    verdict = result["verdict"]
    notes = [
        f"Of {verdict['loops']} loops {verdict['held']} were held, {verdict['held_and_stable']} of"
        f" them among the {verdict['stable']} that are stable by their exponents.",
        f"Of the {verdict['stable_but_lost']} stable ones that were lost,"
        f" {verdict['of_them_thrown_far']} are thrown farther than {HELD_DISTANCE:g} R by noise of"
        f" {result['response_noises'][-1]:g} R: their deviations leave the small basin before they"
        f" die out. {verdict['of_them_error_above_all_held']} have a larger training error than any"
        f" loop that was held; {verdict['of_them_neither']} neither.",
        "Noise: deviation of the outputs across the orbit, over the noise on them of so many R.",
    ]
    return ResultTable("Lost though stable by their exponents", columns, rows, notes)


def draw(result: Mapping[str, Any]) -> Figure:
    """Exponents over ν, a row an R and a column a cycle; below, what became of all loops."""
    cycles = result["cycles"]
    rows = max(len(entries) for entries in cycles.values())
    figure = new_figure(13.0, 3.2 + 2.7 * rows)
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=(rows, 1.25))[:, 0]
    panels = above.subplots(rows, len(cycles), sharex=True, sharey=True, squeeze=False)
    factors = sorted({loop["factor"] for _, _, loop in _all_loops(cycles)})
    colours = dict(zip(factors, _COLOURS, strict=False))
    for column, (target, entries) in zip(panels.T, cycles.items(), strict=True):
        for axes, entry in zip(column, entries, strict=True):
            _draw_exponents(axes, entry, colours)
            axes.set_title(f"{CYCLE_LABELS[target]}, R = {entry['amplitude_deg']:g}°", fontsize=9)
    for axes in panels[-1]:
        axes.set_xlabel("noise of the training ν (m)")
    for axes in panels[:, 0]:
        axes.set_ylabel("leading exponent (1/s)")
    left, right = below.subplots(1, 2, sharey=True)
    _draw_fates(left, right, result, colours)
    write_letters([*panels.ravel(), left, right])
    handles = [
        Line2D([], [], color=colour, marker="o", label=_label(factor))
        for factor, colour in colours.items()
    ]
    handles += [
        Line2D([], [], color=BLACK, marker="o", linestyle="", label="held"),
        Line2D([], [], color=BLACK, marker="o", linestyle="", fillstyle="none", label="lost"),
    ]
    handles += [
        Line2D([], [], color=GREY, marker=marker, linestyle="", label=f"{CYCLE_LABELS[target]}")
        for target, marker in zip(cycles, _MARKERS, strict=False)
    ]
    figure.legend(handles=handles, fontsize=9, frameon=False, ncols=5, loc="outside lower center")
    return figure


def _label(factor: float) -> str:
    return "the paper's ridge" if factor == 0 else f"weighted ridge, {factor:g} κ"


def _draw_exponents(axes: Axes, entry: Mapping[str, Any], colours: Mapping[float, str]) -> None:
    """The leading exponent of an R against ν, a line a factor."""
    if entry["failure"] is not None:
        say_missing(axes, entry["failure"])
        return
    axes.axhspan(_EXPONENTS[0], 0, color=GREEN, alpha=0.08, linewidth=0)
    axes.axhline(0, color=GREY, linewidth=0.8)
    for factor, colour in colours.items():
        loops = [
            loop
            for loop in entry["loops"]
            if loop["factor"] == factor and loop["leading_exponent"] is not None
        ]
        noises = [loop["noise"] for loop in loops]
        exponents = [loop["leading_exponent"] for loop in loops]
        axes.plot(noises, exponents, color=colour, linewidth=1.1)
        for loop in loops:
            _mark(axes, loop["noise"], loop["leading_exponent"], colour, loop["held"])
    axes.set_xscale("log")
    axes.set_yscale("symlog", linthresh=1.0)
    axes.set_ylim(*_EXPONENTS)


def _draw_fates(
    left: Axes, right: Axes, result: Mapping[str, Any], colours: Mapping[float, str]
) -> None:
    """Response to noise, of all loops against the exponent, of the stable against the error."""
    left.axvspan(_EXPONENTS[0], 0, color=GREEN, alpha=0.08, linewidth=0)
    left.axvline(0, color=GREY, linewidth=0.8)
    right.set_facecolor(f"{GREEN}14")  # as the other: an opacity of 0.08
    markers = dict(zip(result["cycles"], _MARKERS, strict=False))
    for target, _, loop in _all_loops(result["cycles"]):
        if loop["leading_exponent"] is None:
            continue
        response = loop["responses"][-1]
        value = _LEFT if response is None else response
        style = (colours[loop["factor"]], loop["held"], markers[target])
        _mark(left, loop["leading_exponent"], value, *style)
        if is_stable(loop):
            _mark(right, loop["training_error"], value, *style)
    for axes in (left, right):
        axes.set_yscale("log")
    left.set_xscale("symlog", linthresh=1.0)
    left.set_xlim(*_EXPONENTS)
    left.set_xlabel("leading exponent (1/s)")
    left.set_title("all loops", fontsize=9)
    size = result["response_noises"][-1]
    left.set_ylabel(f"response to noise of {size:g} R\n(top: the arm left its domain)")
    right.set_xscale("log")
    right.set_xlabel("training error / R")
    right.set_title("loops with a negative exponent", fontsize=9)


def _mark(axes: Axes, x: float, y: float, colour: str, held: bool, marker: str = "o") -> None:
    """A point, filled if the cycle was held."""
    face = colour if held else "white"
    axes.plot([x], [y], marker=marker, markersize=6, color=colour, markerfacecolor=face, zorder=3)


FLOQUET = Experiment("floquet", 1, run, tables, draw)
