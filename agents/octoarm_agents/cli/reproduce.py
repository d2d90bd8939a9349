"""`octoarm reproduce`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from octoarm_agents.cli.options import (
    Body,
    ClusterAddress,
    Jobs,
    Seed,
    number,
    read_body,
    refused,
    result_folder,
    workers_of,
)
from octoarm_agents.cli.printing import new_table
from octoarm_agents.experiments import EXPERIMENTS

ALL = "all"
OWN = "the experiment's own"

_AMPLITUDE = "R: largest angle of the base in degrees, where the experiment has one."
_STEPS = "Physics steps in closed loop, where the experiment lets go of the arm."


def _check_name(name: str) -> str:
    if name != ALL and name not in EXPERIMENTS:
        raise typer.BadParameter(
            f"no experiment {name!r}: expected {ALL} or one of {', '.join(EXPERIMENTS)}."
        )
    return name


def reproduce(
    name: Annotated[
        str,
        typer.Argument(help=f"{ALL}, or one of those above.", callback=_check_name, metavar="NAME"),
    ],
    out: Annotated[Path, result_folder("NAME.png and NAME.json")] = Path("out/reproduce"),
    trials: Annotated[int | None, number("Number of trials.", 1, 100_000, show_default=OWN)] = None,
    seed: Seed = 0,
    jobs: Jobs = None,
    cluster: ClusterAddress = None,
    amplitude: Annotated[
        float | None,
        number(_AMPLITUDE, 0.1, 360.0, "degrees", "--amplitude", "-R", show_default=OWN),
    ] = None,
    steps: Annotated[int | None, number(_STEPS, 10_000, 100_000_000, show_default=OWN)] = None,
    arm: Body = None,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Compute every trial anew, even if it is stored.")
    ] = False,
) -> None:
    """Reproduce a table or figure of the paper: a JSON file, a picture, and a table printed.

    Finished trials are kept beside the files, in hidden folders, so that an interrupted run goes on
    where it ended. Trials in which the arm leaves its domain are reported as failed.
    """
    from rich.console import Console

    from octoarm_agents.experiments.runner import RefusedError, RunSettings, load_experiment
    from octoarm_agents.experiments.runner import reproduce as run
    from octoarm_env import Arm

    parameters = read_body(arm)
    with refused("--arm"):
        Arm(parameters)  # It has a static equilibrium.
    settings = RunSettings(
        out, trials, seed, workers_of(jobs, cluster), amplitude, steps, parameters, fresh
    )
    console = Console()
    for each in EXPERIMENTS if name == ALL else (name,):
        experiment = load_experiment(each)
        try:
            result = run(experiment, settings)
        except RefusedError as error:
            raise typer.BadParameter(f"{each}: {error}.") from None
        for table in experiment.tables(result):
            printed = new_table(table.title, *table.columns)
            for row in table.rows:
                printed.add_row(*row)
            console.print(printed)
            for note in table.notes:
                console.print(note, soft_wrap=True, markup=False)
        console.print(f"Wrote {out / each}.png and {out / each}.json.", soft_wrap=True)


# Appended here, not written out, so that every experiment appears in ``--help`` by itself.
_listed = "\n".join(f"    {name:<14}{each.help}" for name, each in EXPERIMENTS.items())
reproduce.__doc__ = f"{reproduce.__doc__}\n    \b\n{_listed}\n"
