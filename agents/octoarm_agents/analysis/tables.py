"""The summaries that the command line prints."""

from __future__ import annotations

from rich.box import SIMPLE, SQUARE
from rich.markup import escape
from rich.table import Table

from octoarm_agents.analysis.measures import Measures
from octoarm_agents.analysis.survey import ArmSurvey
from octoarm_agents.analysis.sweep import Quantity, SweepPoint


def measures_table(result: Measures) -> Table:
    """The measures of a recording."""
    memory, processing = result.memory, result.processing
    recording, rows = result.recording, result.recording.sampling.rows
    states = len(recording.state_names)
    table = _table(f"{len(recording)} {recording.sampling.unit}, {states} states")
    for kind, names in (("states", recording.state_names), ("input", recording.input_names)):
        if not names[0].isdigit():
            shown = names if len(names) < 3 else (names[0], "…", names[-1])
            table.add_row(kind, escape(", ".join(shown)))
    first, last = memory.training_rows[0] + 1, memory.test_rows[1]
    table.add_row(f"{rows} used (counted from 1)", f"{first} to {last}")
    table.add_row(
        f"memory capacity, delays 1 to {result.settings.max_delay}", _sum(result, "memory capacity")
    )
    test = memory.test_rows
    table.add_row(
        f"the same on {rows} {test[0] + 1} to {test[1]}",
        _sum(result, "memory capacity on held-out rows"),
    )
    table.add_row(
        "information processing capacity", _sum(result, "information processing capacity")
    )
    table.add_row(
        "the same, insignificant functions included",
        _sum(result, "information processing capacity, insignificant functions included"),
    )
    columns = processing.by_degree, processing.largest_delays_by_degree, processing.counts
    for degree, (value, delay, counts) in enumerate(zip(*columns, strict=True), start=1):
        name = f"  degree {degree}, delays to {delay} ({counts} functions count)"
        table.add_row(name, f"{value:.3f}")
    table.add_row("rank of the states, to rounding", f"{processing.rank}")
    if result.settings.noise:
        table.add_row("largest sum with this noise", f"{processing.largest_possible_total:.3f}")
    table.add_row(
        f"rank above {result.settings.tolerance:g} of the largest", f"{result.rank_at_tolerance}"
    )
    table.add_row("participation ratio", f"{result.effective_rank:.2f}")
    for column, distribution in enumerate(processing.inputs, start=1):
        table.add_row(f"polynomials of input {column}", distribution.family)
    return table


def survey_table(result: ArmSurvey) -> Table:
    """The measures of an arm's recording, and of the arm itself."""
    table = measures_table(result.measures)
    streams, ranks, echo = result.settings.streams, result.ranks, result.echo
    table.add_row(f"kernel rank, {streams} different streams", f"{ranks.kernel_rank}")
    table.add_row(f"generalisation rank, {streams} similar streams", f"{ranks.generalisation_rank}")
    table.add_row("initial state", echo.verdict)
    decay = "none" if echo.decay_time_seconds is None else f"{echo.decay_time_seconds:.3f} s"
    table.add_row("decay time of the initial state", decay)
    table.add_row("largest conditional Lyapunov exponent", f"{result.lyapunov} /s")
    return table


def sweep_table(quantity: Quantity, points: list[SweepPoint]) -> Table:
    """The main figures of a sweep, a line for each value."""
    names = {
        "memory_capacity": "MC",
        "capacity_linear": "linear IPC",
        "capacity_nonlinear": "higher IPC",
        "kernel_rank": "kernel rank",
        "generalisation_rank": "similar rank",
        "lyapunov_exponent_per_second": "exponent (1/s)",
        "echo_decay_time_seconds": "decay (s)",
    }
    table = _table(f"Sweep of {quantity}", "value", *names.values())
    for point in points:
        cells = ["-"] * len(names)
        if point.summary is not None:
            figures = [point.summary[name] for name in names]
            cells = ["none" if figure is None else f"{figure:.4g}" for figure in figures]
        table.add_row(f"{point.value:g}", *cells)
    return table


def _sum(result: Measures, name: str) -> str:
    """A sum of capacities; one that cannot be says so, and the warnings say why."""
    return f"{'impossible: ' * (name in result.impossible)}{result.sums[name]:.3f}"


def _table(title: str, *headings: str) -> Table:
    # Wide tables without the frame, so that they fit into 80 columns.
    box = SIMPLE if headings else SQUARE
    table = Table(
        title=title,
        title_justify="left",
        show_header=bool(headings),
        box=box,
        collapse_padding=bool(headings),
    )
    for column, heading in enumerate(headings or ("", "")):
        table.add_column(heading, justify="right" if column else "left")
    return table
