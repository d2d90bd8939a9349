"""`octoarm tune`."""

from __future__ import annotations

from collections.abc import Callable
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

_OUT = "Folder for study.json, with every trial, and ALGORITHM.yml, the best."

Trials = Annotated[
    int | None,
    number(
        "Trials, those of an earlier call included.",
        1,
        100_000,
        show_default="as many as --minutes allow",
    ),
]
Minutes = Annotated[float, number("Begin no trial after this time.", 0.01, 100_000)]
TrialJobs = Annotated[
    int | None,
    number("Trials at once, with --cluster.", 1, 1024, show_default="all processors"),
]


def trial_steps(usual: str) -> Any:
    """Give the option of a trial's steps; `usual` is shown as what is taken by default."""
    help = "Environment steps of each training of a trial."
    return number(help, 1, 1_000_000_000, show_default=usual)


def tune(
    algorithm: Algorithm,
    trials: Trials = None,
    minutes: Minutes = 12.0,
    steps: Annotated[int | None, trial_steps("10,000 to 100,000, by algorithm")] = None,
    seed: Seed = 0,
    cluster: ClusterAddress = None,
    jobs: TrialJobs = None,
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
    given: dict[str, Any] = {"trials": trials, "minutes": minutes, "steps": steps, "seed": seed}
    search(
        lambda **where: tune_algorithm(algorithm, folder, **given, **where),
        f"study.json and {algorithm}.yml into {folder}",
        "{:.1f} of 500",
        cluster,
        jobs,
    )


def search(
    run: Callable[..., dict[str, Any]],
    written: str,
    shown: str,
    cluster: str | None,
    jobs: int | None,
) -> None:
    """Run a search, say what every trial is worth, and what was best.

    Args:
        run: called with ``cluster`` and ``report``; gives what ``study.json`` holds.
        written: names of the files, and where they are.
        shown: how a value is shown, a format.
        cluster: address of a Ray cluster, as typed.
        jobs: trials at once there.
    """
    if cluster is None and jobs is not None:
        raise typer.BadParameter("only with --cluster: here, one trial comes after the other.")
    where: Any = None if cluster is None else workers_of(jobs, cluster)

    def report(trial: dict[str, Any], best: float) -> None:
        told = "given up" if trial["pruned"] else shown.format(trial["value"])
        typer.echo(f"trial {trial['number']}: {told}; best {shown.format(best)}")

    with refused(), need_extra("ray,rllib"):
        result = run(cluster=where, report=report)
    best = result["best"]
    typer.echo(
        f"Best of {len(result['trials'])} trials: number {best['number']}, "
        f"{shown.format(best['value'])}. Wrote {written}."
    )
