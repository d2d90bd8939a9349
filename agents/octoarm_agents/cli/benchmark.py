"""`octoarm benchmark`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from octoarm_agents.cli.options import number_between, output_file

if TYPE_CHECKING:
    from rich.table import Table

    from octoarm_agents.benchmark.speed import SpeedResult

_MISSING = "{} not installed, so left out: pip install 'octoarm-agents[benchmark]'"


def benchmark(
    seconds: Annotated[
        float,
        typer.Option(
            help="Measuring time in seconds, all contenders together.",
            callback=number_between(0.1, 3600.0, "seconds"),
        ),
    ] = 30.0,
    rounds: Annotated[
        int,
        typer.Option(
            help="Rounds in which the contenders take turns.", callback=number_between(1, 1001)
        ),
    ] = 11,
    out: Annotated[
        Path | None,
        typer.Option(
            help="JSON file for all figures.", callback=output_file, show_default="no file"
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the figures as JSON instead of tables.")
    ] = False,
) -> None:
    """Time one arm, batches of 1 to 1024, the environments and their peers, in one run.

    Peers are the same arm in MuJoCo (RK4, 1 ms; it computes neither water nor volume forces, and is
    compared with an arm without them), Gymnasium's SyncVectorEnv and AsyncVectorEnv over the single
    environment, and a rod of PyElastica, which is another physics: only simulated seconds a second
    may be read off it. The contenders take turns in several rounds; ratios are formed within a
    round, because absolute times on a shared machine are not steady. Columns are minimum, median
    and maximum over rounds.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from octoarm_agents.benchmark.speed import PEERS, measure_speed
    from octoarm_agents.files import write_json

    console, errors = Console(width=120), Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=errors, transient=True) as progress:
        task = progress.add_task("measuring", total=None)
        result = measure_speed(
            seconds, rounds, lambda name, total: progress.update(task, advance=1, total=total)
        )
    content = result.to_dict()
    if out is not None:
        write_json(out, content)
    if as_json:
        typer.echo(json.dumps(content, indent=2, allow_nan=False))
        return
    console.print(_times(result))
    console.print(_comparisons(result))
    if result.memory is not None:
        console.print(f"Memory of a sub-environment: {result.memory / 1024:.1f} KiB.")
    console.print(_machine(content), soft_wrap=True)
    for name, peer in PEERS.items():
        if name not in result.microseconds:
            console.print(_MISSING.format(peer), soft_wrap=True, markup=False)
    if out is not None:
        console.print(f"Wrote {out}.", soft_wrap=True)


def _times(result: SpeedResult) -> Table:
    table = _table(f"Microseconds of an arm's time step, {result.rounds} rounds")
    table.add_column("times real time", justify="right")
    for name, spread in result.spreads.items():
        figures = (f"{value:.3f}" for value in spread.to_dict().values())
        table.add_row(name, *figures, f"{result.real_time(name):,.0f}")
    return table


def _comparisons(result: SpeedResult) -> Table:
    table = _table("Compared round by round")
    for ratio in result.ratios():
        digits = 0 if ratio.unit == "a second" else 2 if ratio.spread.median < 10 else 1
        figures = (f"{value:,.{digits}f} {ratio.unit}" for value in ratio.spread.to_dict().values())
        table.add_row(ratio.label, *figures)
    return table


def _table(title: str) -> Table:
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    table.add_column("")
    for heading in ("min", "median", "max"):
        table.add_column(heading, justify="right")
    return table


def _machine(content: dict[str, Any]) -> str:
    machine, versions = content["machine"], content["versions"]
    installed = ", ".join(f"{name} {version}" for name, version in versions.items() if version)
    return (
        f"{machine['processor']}, {machine['cpu_count']} CPUs, "
        f"physics in {machine['instruction_set']}; {machine['platform']}; "
        f"Python {machine['python']}; {installed}"
    )
