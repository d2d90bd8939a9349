"""`octoarm reproduce`."""

from __future__ import annotations

import inspect
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from octoarm_agents.cli.options import number_between, output_folder, read_body
from octoarm_agents.experiments import EXPERIMENTS

if TYPE_CHECKING:
    from rich.table import Table

    from octoarm_agents.experiments.runner import ResultTable
    from octoarm_env import ArmParameters

ALL = "all"


def _check_name(name: str) -> str:
    if name != ALL and name not in EXPERIMENTS:
        raise typer.BadParameter(
            f"no experiment {name!r}: expected {ALL} or one of {', '.join(EXPERIMENTS)}."
        )
    return name


def reproduce(
    name: Annotated[
        str,
        typer.Argument(
            help=f"What to reproduce: {ALL}, or one of {', '.join(EXPERIMENTS)}.",
            callback=_check_name,
            metavar="NAME",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(help="Folder for NAME.png and NAME.json.", callback=output_folder),
    ] = Path("out/reproduce"),
    trials: Annotated[
        int | None,
        typer.Option(
            help="Number of trials.",
            show_default="the experiment's own, as in the paper",
            callback=number_between(1, 100_000),
        ),
    ] = None,
    seed: Annotated[
        int,
        typer.Option(help="Seed of everything random.", callback=number_between(0, 2**32 - 1)),
    ] = 0,
    jobs: Annotated[
        int | None,
        typer.Option(
            help="Processes; the results do not depend on it.",
            show_default="number of processors",
            callback=number_between(1, 1024),
        ),
    ] = None,
    amplitude: Annotated[
        float | None,
        typer.Option(
            "--amplitude",
            "-R",
            help="R: largest angle of the base in degrees, where the experiment has one.",
            show_default="the experiment's own",
            callback=number_between(0.1, 360.0, "degrees"),
        ),
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(
            help="Physics steps in closed loop, where the experiment lets go of the arm.",
            show_default="the experiment's own, as in the paper",
            callback=number_between(10_000, 100_000_000),
        ),
    ] = None,
    arm: Annotated[
        Path | None,
        typer.Option(
            help="A body: nakajima2013, inertial, or a JSON file of parameters.",
            show_default="the default body",
        ),
    ] = None,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Compute every trial anew, even if it is stored.")
    ] = False,
) -> None:
    """Reproduce a table or figure of the paper: a JSON file, a picture, and a table printed.

    Finished trials are kept beside the files, in hidden folders, so that an interrupted run goes on
    where it ended. Trials in which the arm leaves its domain are reported as failed.
    """
    from rich.console import Console

    from octoarm_agents.experiments import load_experiment
    from octoarm_agents.experiments.refusal import RefusedError
    from octoarm_agents.experiments.runner import Context
    from octoarm_agents.experiments.runner import reproduce as run

    parameters = _check_body(read_body(arm))
    context = Context(
        out=out,
        trials=trials,
        seed=seed,
        jobs=jobs or os.cpu_count() or 1,
        amplitude=amplitude,
        steps=steps,
        parameters=parameters,
        fresh=fresh,
    )
    console = Console()
    for each in EXPERIMENTS if name == ALL else (name,):
        try:
            result = run(load_experiment(each), context)
        except RefusedError as error:
            raise typer.BadParameter(f"{each}: {error}.") from None
        for table in load_experiment(each).tables(result):
            console.print(_table(table))
            for note in table.notes:
                console.print(note, soft_wrap=True, markup=False)
        console.print(f"Wrote {out / each}.png and {out / each}.json.", soft_wrap=True)


def _check_body(parameters: ArmParameters) -> ArmParameters:
    """Refuse a body that no arm can be made of."""
    from octoarm_env import Arm

    try:
        Arm(parameters)
    except ValueError as error:  # it has no static equilibrium
        raise typer.BadParameter(str(error), param_hint="'--arm'") from None
    return parameters


def _table(content: ResultTable) -> Table:
    from rich.table import Table

    table = Table(title=content.title)
    for index, column in enumerate(content.columns):
        table.add_column(column, justify="right" if index else "left")
    for row in content.rows:
        table.add_row(*row)
    return table


# Appended here, not written out, so that every experiment appears in ``--help`` by itself.
_paragraphs = inspect.cleandoc(reproduce.__doc__ or "").split("\n\n")
reproduce.__doc__ = "\n\n".join(
    (
        *(paragraph.replace("\n", " ") for paragraph in _paragraphs),
        "\b\n" + "\n".join(f"{name:<14}{title}" for name, title in EXPERIMENTS.items()),
    )
)
