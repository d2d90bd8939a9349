"""`octoarm tune`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from octoarm_agents.cli.options import (
    Algorithm,
    ClusterAddress,
    Seed,
    need_extra,
    number,
    output_folder,
    refused,
    workers_of,
)

_TRIALS = "Trials, those of an earlier call included."
_STEPS = "Environment steps of each training of a trial."
_OUT = "Folder for study.json, with every trial, and ALGORITHM.yml, the best."


def tune(
    algorithm: Algorithm,
    trials: Annotated[
        int | None, number(_TRIALS, 1, 100_000, show_default="as many as --minutes allow")
    ] = None,
    minutes: Annotated[float, number("Begin no trial after this time.", 0.01, 100_000)] = 12.0,
    steps: Annotated[
        int | None,
        number(_STEPS, 1, 1_000_000_000, show_default="10,000 to 100,000, by algorithm"),
    ] = None,
    seed: Seed = 0,
    cluster: ClusterAddress = None,
    jobs: Annotated[
        int | None,
        number("Trials at once, with --cluster.", 1, 1024, show_default="all processors"),
    ] = None,
    out: Annotated[Path | None, typer.Option(help=_OUT, show_default="out/tune/ALGORITHM")] = None,
) -> None:
    """Search hyper-parameters (Optuna's TPE) by short trainings.

    A trial trains on all three targets; its value is the mean of the returns
    (of 500) that the last policies earn on seeds of their own. Trials behind
    the others are given up: here by the median, on a cluster (Ray Tune) by
    asynchronous successive halving. The first trial is what octoarm train uses now.
    The same call goes on where it was interrupted.

    Use the result with octoarm train ALGORITHM --hyperparameters ALGORITHM.yml.
    """
    with need_extra("rl"):
        from octoarm_agents.rl.tuning import tune_algorithm

    folder = output_folder(out or Path("out/tune") / algorithm)
    if cluster is None and jobs is not None:
        raise typer.BadParameter("only with --cluster: here, one trial comes after the other.")
    where: Any = None if cluster is None else workers_of(jobs, cluster)

    def report(trial: dict[str, Any], best: float) -> None:
        shown = "given up" if trial["pruned"] else f"{trial['value']:.1f} of 500"
        typer.echo(f"trial {trial['number']}: {shown}; best {best:.1f}")

    with refused(), need_extra("ray,rllib"):
        result = tune_algorithm(
            algorithm,
            folder,
            trials=trials,
            minutes=minutes,
            steps=steps,
            seed=seed,
            cluster=where,
            report=report,
        )
    best = result["best"]
    typer.echo(
        f"Best of {len(result['trials'])} trials: number {best['number']}, "
        f"{best['value']:.1f} of 500. Wrote study.json and {algorithm}.yml into {folder}."
    )
