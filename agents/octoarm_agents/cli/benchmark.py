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

_NO_MUJOCO = (
    "MuJoCo is not installed, so its twin was left out: pip install 'octoarm-agents[benchmark]'"
)


def benchmark(
    seconds: Annotated[
        float,
        typer.Option(
            help="Measuring time in seconds, all contenders together.",
            callback=number_between(0.1, 3600.0, "seconds"),
        ),
    ] = 10.0,
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
    """Time the physics, the same arm in MuJoCo, and the environment, in one run.

    The contenders take turns in several rounds; ratios are formed within a round, because absolute
    times on a shared machine are not steady. Columns are minimum, median and maximum over rounds.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from octoarm_agents.benchmark.speed import has_mujoco, measure_speed
    from octoarm_agents.files import write_json

    console, errors = Console(), Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=errors, transient=True) as progress:
        contenders = 7 if has_mujoco() else 6
        task = progress.add_task("measuring", total=rounds * contenders)
        result = measure_speed(seconds, rounds, lambda name: progress.advance(task))
    content = result.to_dict()
    if out is not None:
        write_json(out, content)
    if as_json:
        typer.echo(json.dumps(content, indent=2, allow_nan=False))
        return
    console.print(_times(result))
    console.print(_comparisons(result))
    console.print(_machine(content), soft_wrap=True)
    if not has_mujoco():
        console.print(_NO_MUJOCO, soft_wrap=True, markup=False)
    if out is not None:
        console.print(f"Wrote {out}.", soft_wrap=True)


def _times(result: SpeedResult) -> Table:
    table = _table(f"Microseconds a step, {result.rounds} rounds")
    for name, spread in result.spreads.items():
        table.add_row(name, *(f"{value:.2f}" for value in spread.to_dict().values()))
    return table


def _comparisons(result: SpeedResult) -> Table:
    from octoarm_agents.benchmark.speed import (
        ENV_BARE,
        ENV_MADE,
        OVERHEAD_TARGET,
    )

    table = _table("Compared round by round")
    rows = (
        ("MuJoCo twin / arm, same physics", result.twin_over_arm, "×"),
        ("MuJoCo twin / arm in water with volume forces", result.twin_over_wet_arm, "×"),
        (
            f"OctoArmEnv.step beyond its physics (target ≤ {OVERHEAD_TARGET:g} µs)",
            result.overhead(ENV_BARE),
            "µs",
        ),
        ("gym.make's step beyond its physics", result.overhead(ENV_MADE), "µs"),
    )
    for name, spread, unit in rows:
        if spread is not None:
            table.add_row(name, *(f"{value:.1f} {unit}" for value in spread.to_dict().values()))
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
