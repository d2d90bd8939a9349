"""`octoarm tune`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from octoarm_agents.cli.options import need_extra, number_between, output_folder

__all__ = ["tune"]


def tune(
    algorithm: Annotated[
        Literal["ppo", "sac", "tqc", "recurrent_ppo"],
        typer.Argument(help="What trains.", show_default=False),
    ],
    trials: Annotated[
        int | None,
        typer.Option(
            help="Trials, those of an earlier call included.",
            show_default="as many as --minutes allow",
            callback=number_between(1, 100_000),
        ),
    ] = None,
    minutes: Annotated[
        float,
        typer.Option(
            help="Begin no trial after this time.", callback=number_between(0.01, 100_000)
        ),
    ] = 12.0,
    steps: Annotated[
        int | None,
        typer.Option(
            help="Environment steps of each training of a trial.",
            show_default="20,000 to 200,000, by algorithm",
            callback=number_between(1, 1_000_000_000),
        ),
    ] = None,
    seed: Annotated[
        int,
        typer.Option(help="Of search and trainings.", callback=number_between(0, 2**31 - 1)),
    ] = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for study.json, with every trial, and ALGORITHM.yml, the best.",
            show_default="out/tune/ALGORITHM",
        ),
    ] = None,
) -> None:
    """Search hyper-parameters (Optuna's TPE) by short trainings.

    A trial trains on all three targets; its value is the mean of the returns
    (of 500) that the last policies earn on seeds of their own. Trials behind
    the median are given up. The first trial is what octoarm train uses now.
    The same call goes on where it was interrupted.

    Use the result with octoarm train ALGO --hyperparameters ALGORITHM.yml.
    """
    with need_extra("rl"):
        import optuna  # noqa: F401

        from octoarm_agents.rl.tuning import tune_algorithm

    folder = output_folder(out or Path("out/tune") / algorithm)

    def report(number: int, value: float | None, best: float | None) -> None:
        shown = "given up" if value is None else f"{value:.1f} of 500"
        typer.echo(f"trial {number}: {shown}; best {'-' if best is None else f'{best:.1f}'}")

    result = tune_algorithm(
        algorithm, folder, trials=trials, minutes=minutes, steps=steps, seed=seed, report=report
    )
    best = result["best"]
    typer.echo(
        f"Best of {len(result['trials'])} trials: number {best['number']}, "
        f"{best['value']:.1f} of 500. Wrote study.json and {algorithm}.yml into {folder}."
    )
