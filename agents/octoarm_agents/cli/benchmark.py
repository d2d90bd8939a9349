"""`octoarm benchmark`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from octoarm_agents.cli.options import ClusterAddress, need_extra, number, result_file, workers_of
from octoarm_agents.cli.printing import new_table
from octoarm_agents.common.progress import progress_bar

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table


Seconds = Annotated[
    float, number("Measuring time, all contenders together.", 0.1, 3600.0, "seconds")
]
Rounds = Annotated[int, number("Rounds in which the contenders take turns.", 1, 1001)]


def benchmark(
    seconds: Seconds = 30.0,
    rounds: Rounds = 11,
    out: Annotated[
        Path | None, result_file("JSON file for all figures.", show_default="no file")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the figures as JSON instead of tables.")
    ] = False,
    pictures: Annotated[
        bool, typer.Option("--pictures", help="Time pictures instead of the physics.")
    ] = False,
    server: Annotated[
        bool, typer.Option("--server", help="Load a server instead of timing the physics.")
    ] = False,
    cluster: ClusterAddress = None,
) -> None:
    """Time one arm, batches of 1 to 1024, the environments and their peers, in one run.

    Peers are the same arm in MuJoCo (without water and volume forces) and Gymnasium's vector
    environments. All take turns in several rounds; ratios are formed within a round, because
    absolute times on a shared machine are not steady.

    With --pictures: pictures in several sizes beside MuJoCo's renderer, and what a step pays for
    pictures that nobody draws. With --server: steps a second and round trips of octoarm-server over
    loopback, with 1, 16 and 128 connections, and of clients in Python; the load comes from the same
    machine. With --cluster: what a call costs on a Ray cluster and in processes here, and how
    trials scale to two at once. What the figures mean: docs/performance.md, docs/cluster.md.
    """
    from rich.console import Console

    from octoarm_agents.common.files import write_json
    from octoarm_agents.common.serving import ServerNotFoundError

    if pictures and server:
        raise typer.BadParameter("not together with --pictures.", param_hint="'--server'")
    if cluster is not None and (pictures or server):
        raise typer.BadParameter(
            "not together with --pictures or --server.", param_hint="'--cluster'"
        )
    if cluster is not None:
        workers_of(None, cluster)
        from octoarm_agents.benchmark.cluster import measure_cluster as measure
    elif server:
        with need_extra("benchmark"):
            from octoarm_agents.benchmark.server import measure_server as measure
    elif pictures:
        with need_extra("render"):
            import pygame  # noqa: F401
        from octoarm_agents.benchmark.pictures import measure_pictures as measure
    else:
        from octoarm_agents.benchmark.speed import measure_speed as measure
    with progress_bar(None, "measuring", unit=" slices") as bar:

        def advance(name: str, total: int) -> None:
            bar.total = total
            bar.update()

        try:
            content = measure(seconds, rounds, advance).to_dict()
        except (ServerNotFoundError, RuntimeError) as error:
            typer.echo(str(error), err=True)
            raise typer.Exit(1) from None
    if out is not None:
        write_json(out, content)
    if as_json:
        typer.echo(json.dumps(content, indent=2, allow_nan=False))
        return
    console = Console(width=120)
    _show(console, content)
    if out is not None:
        console.print(f"Wrote {out}.", soft_wrap=True)


def _show(console: Console, content: dict[str, Any]) -> None:
    """Print what a file of figures holds."""
    contenders: dict[str, dict[str, Any]] = content["contenders"]
    for first in dict.fromkeys(next(iter(row)) for row in contenders.values()):
        rows = {name: row for name, row in contenders.items() if next(iter(row)) == first}
        console.print(_table(rows, content["rounds"]))
    table = new_table("Compared round by round", "", "min", "median", "max")
    for ratio in content["ratios"].values():
        digits = 2 if abs(ratio["median"]) < 10 else 1
        figures = (f"{ratio[key]:,.{digits}f} {ratio['unit']}" for key in ("min", "median", "max"))
        table.add_row(ratio["label"], *figures)
    console.print(table)
    memory = content.get("bytes_per_vector_sub_environment")
    if memory is not None:
        console.print(f"Memory of a sub-environment: {memory / 1024:.1f} KiB.")
    machine, versions = content["machine"], content["versions"]
    installed = ", ".join(f"{name} {version}" for name, version in versions.items() if version)
    console.print(
        f"{machine['processor']}, {machine['cpu_count']} CPUs, "
        f"physics in {machine['instruction_set']}; {machine['platform']}; "
        f"Python {machine['python']}; {installed}",
        soft_wrap=True,
    )
    if "opengl" in content:
        console.print(f"MuJoCo draws with {content['opengl']}.", soft_wrap=True, markup=False)
    for name, reason in content["left_out"].items():
        console.print(f"{name} left out: {reason}", soft_wrap=True, markup=False)


def _table(rows: dict[str, dict[str, Any]], rounds: int) -> Table:
    """A table of contenders whose first figure is the same: its extremes, or medians of several."""
    several = any(isinstance(value, dict) for row in rows.values() for value in [*row.values()][1:])
    cells: dict[str, dict[str, float]] = {name: {} for name in rows}
    for name, row in rows.items():
        for figure, value in row.items():
            if not isinstance(value, dict):
                cells[name][figure] = value
            elif several:
                cells[name][figure] = value["median"]
            else:
                cells[name] |= {end: value[end] for end in ("min", "median", "max")}
    headings = list(dict.fromkeys(heading for row in cells.values() for heading in row))
    title = "Medians" if several else next(iter(next(iter(rows.values()))))
    table = new_table(
        f"{title.replace('_', ' ').capitalize()}, {rounds} rounds",
        "",
        *(heading.replace("_", " ") for heading in headings),
    )
    for name, row in cells.items():
        numbers = (row.get(heading) for heading in headings)
        table.add_row(name, *("" if each is None else f"{each:,.2f}" for each in numbers))
    return table
