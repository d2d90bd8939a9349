"""`octoarm benchmark`."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from octoarm_agents.cli.options import need_extra, number_between, output_file
from octoarm_agents.common.progress import progress_bar

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from octoarm_agents.benchmark.pictures import PictureResult
    from octoarm_agents.benchmark.server import ServerResult
    from octoarm_agents.benchmark.speed import Ratio, SpeedResult, Spread

_Result = TypeVar("_Result")

_MISSING = '{} not installed, so left out: pip install "octoarm-agents[benchmark]"'


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
    pictures: Annotated[
        bool, typer.Option("--pictures", help="Time pictures instead of the physics.")
    ] = False,
    server: Annotated[
        bool, typer.Option("--server", help="Load a server instead of timing the physics.")
    ] = False,
) -> None:
    """Time one arm, batches of 1 to 1024, the environments and their peers, in one run.

    Peers are the same arm in MuJoCo (RK4, 1 ms; it computes neither water nor volume forces, and is
    compared with an arm without them), and Gymnasium's SyncVectorEnv and AsyncVectorEnv over the
    single environment. The contenders take turns in several rounds; ratios are formed within a
    round, because absolute times on a shared machine are not steady. Columns are minimum, median
    and maximum over rounds.

    With --pictures: pictures of the environments in several sizes, beside those of Gymnasium's
    pygame environments and of MuJoCo's renderer, and what a step pays for pictures that nobody
    draws.

    With --server: steps a second and round trips of octoarm-server over loopback, with 1, 16 and
    128 connections, and of clients in Python. The load comes from the same machine and takes its
    part of the processor.
    """
    from rich.console import Console

    from octoarm_agents.common.files import write_json
    from octoarm_agents.common.serving import ServerNotFoundError

    if pictures and server:
        raise typer.BadParameter("not together with --pictures.", param_hint="'--server'")
    result: SpeedResult | PictureResult | ServerResult
    if server:
        with need_extra("benchmark"):
            from octoarm_agents.benchmark.server import measure_server
        try:
            result = _watched(measure_server, seconds, rounds)
        except (ServerNotFoundError, RuntimeError) as error:
            typer.echo(str(error), err=True)
            raise typer.Exit(1) from None
        show = partial(_show_server, result)
    elif pictures:
        with need_extra("render"):
            from octoarm_agents.benchmark.pictures import measure_pictures
        result = _watched(measure_pictures, seconds, rounds)
        show = partial(_show_pictures, result)
    else:
        from octoarm_agents.benchmark.speed import measure_speed

        result = _watched(measure_speed, seconds, rounds)
        show = partial(_show_speed, result)
    content = result.to_dict()
    if out is not None:
        write_json(out, content)
    if as_json:
        typer.echo(json.dumps(content, indent=2, allow_nan=False))
        return
    console = Console(width=120)
    show(console, content)
    if out is not None:
        console.print(f"Wrote {out}.", soft_wrap=True)


def _watched(
    measure: Callable[[float, int, Callable[[str, int], Any]], _Result],
    seconds: float,
    rounds: int,
) -> _Result:
    """Measure, and show how far that is."""
    with progress_bar(None, "measuring", unit=" slices") as bar:

        def advance(name: str, total: int) -> None:
            bar.total = total
            bar.update()

        return measure(seconds, rounds, advance)


def _show_speed(result: SpeedResult, console: Console, content: dict[str, Any]) -> None:
    from octoarm_agents.benchmark.speed import PEERS

    console.print(_times(result))
    console.print(_comparisons(result.ratios()))
    if result.memory is not None:
        console.print(f"Memory of a sub-environment: {result.memory / 1024:.1f} KiB.")
    console.print(_machine(content), soft_wrap=True)
    for name, peer in PEERS.items():
        if name not in result.microseconds:
            console.print(_MISSING.format(peer), soft_wrap=True, markup=False)


def _show_pictures(result: PictureResult, console: Console, content: dict[str, Any]) -> None:
    console.print(_picture_times(result))
    table = _table(f"Microseconds of a step, {result.rounds} rounds")
    _add_rows(table, result.steps)
    console.print(table)
    console.print(_comparisons(result.ratios()))
    target = content["target"]
    reached = "reached" if target["reached"] else "missed"
    console.print(
        f"Target, {target['frames_per_second']:g} frames a second of {target['picture']}: "
        f"{reached}."
    )
    console.print(_machine(content), soft_wrap=True)
    if result.opengl is not None:
        console.print(f"MuJoCo draws with {result.opengl}.", soft_wrap=True, markup=False)
    for name, reason in result.left_out.items():
        console.print(f"{name} left out: {reason}", soft_wrap=True, markup=False)


def _show_server(result: ServerResult, console: Console, content: dict[str, Any]) -> None:
    console.print(_loads(result))
    console.print(_comparisons(result.ratios()))
    target = content["target"]
    reached = "reached" if target["reached"] else "missed"
    medians = " and ".join(f"{median:.0f}" for median in target["median_us"].values())
    console.print(
        f"Target, at most {target['over_physics_us']:g} µs of a single connection's round trip "
        f"beyond the physics: {reached}, {medians} µs.",
        soft_wrap=True,
    )
    console.print(_machine(content), soft_wrap=True)
    for name, reason in result.left_out.items():
        console.print(f"{name} left out: {reason}", soft_wrap=True, markup=False)


def _loads(result: ServerResult) -> Table:
    """Medians over rounds."""
    from rich.table import Table

    table = Table(
        title=f"Steps a second, and microseconds of a step; medians of {result.rounds} rounds",
        title_justify="left",
    )
    table.add_column("")
    for heading in ("connections", "ms", "steps/s", "p50", "p90", "p99", "p99.9"):
        table.add_column(heading, justify="right")
    for name, load in result.loads.items():
        table.add_row(
            load.contender,
            str(load.connections) if load.connections else "–",
            f"{1000 * load.period:g}",
            f"{result.rates(name).median:,.0f}",
            *(f"{spread.median:,.0f}" for spread in result.round_trips(name).values()),
        )
    return table


def _picture_times(result: PictureResult) -> Table:
    table = _table(f"Milliseconds of a picture, {result.rounds} rounds")
    table.add_column("a second", justify="right")
    _add_rows(
        table, result.pictures, {name: f"{result.rate(name):,.0f}" for name in result.pictures}
    )
    return table


def _times(result: SpeedResult) -> Table:
    table = _table(f"Microseconds of an arm's time step, {result.rounds} rounds")
    table.add_column("times real time", justify="right")
    spreads = result.spreads
    _add_rows(table, spreads, {name: f"{result.real_time(name):,.0f}" for name in spreads})
    return table


def _comparisons(ratios: Iterable[Ratio]) -> Table:
    table = _table("Compared round by round")
    for ratio in ratios:
        digits = 0 if ratio.unit == "a second" else 2 if abs(ratio.spread.median) < 10 else 1
        figures = (f"{value:,.{digits}f} {ratio.unit}" for value in ratio.spread.to_dict().values())
        table.add_row(ratio.label, *figures)
    return table


def _add_rows(
    table: Table, spreads: Mapping[str, Spread], last: Mapping[str, str] | None = None
) -> None:
    """A row of each spread, and one more figure of each where there is one."""
    for name, spread in spreads.items():
        figures = [f"{value:.3f}" for value in spread.to_dict().values()]
        table.add_row(name, *figures, *([] if last is None else [last[name]]))


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
