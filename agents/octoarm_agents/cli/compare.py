"""`octoarm compare`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from octoarm_agents.cli.options import need_extra, number_between, output_folder

__all__ = ["compare"]


def _names(text: str | None) -> tuple[str, ...] | None:
    return None if text is None else tuple(name.strip() for name in text.split(","))


def compare(
    out: Annotated[
        Path,
        typer.Option(
            help="Folder for compare.json, compare.md, the figures, and the agents in trained/.",
            callback=output_folder,
        ),
    ] = Path("out/compare"),
    agents: Annotated[
        str | None,
        typer.Option(help="Some of the agents, with commas.", show_default="all nine"),
    ] = None,
    targets: Annotated[
        str | None,
        typer.Option(help="Some of the targets, with commas.", show_default="all three"),
    ] = None,
    seeds: Annotated[
        int,
        typer.Option(
            help="Trainings of each agent on each target.", callback=number_between(1, 1000)
        ),
    ] = 5,
    budget: Annotated[
        float,
        typer.Option(
            help="Factor of the environment steps of all trainings.",
            callback=number_between(1e-6, 1e6),
        ),
    ] = 1.0,
    episodes: Annotated[
        int,
        typer.Option(help="Episodes in each test.", callback=number_between(1, 4096)),
    ] = 16,
    seed: Annotated[
        int,
        typer.Option(
            help="First seed of the tests' episodes.", callback=number_between(0, 2**31 - 1)
        ),
    ] = 10_000,
    jobs: Annotated[
        int | None,
        typer.Option(
            help="Processes; only the timings depend on it.",
            show_default="number of processors",
            callback=number_between(1, 1024),
        ),
    ] = None,
) -> None:
    """Compare readouts, a searched linear policy, networks, and doing nothing.

    Trains readout_pinv, readout_ridge, linear_search, ppo, sac, tqc and
    recurrent_ppo, several times on each target, and measures all of them and
    hold and clock on the same episodes: return, tracking error, orbit and
    period, survival, recovery after pushes and noise, other bodies, cost.

    Trainings are kept in OUT/runs: the same call goes on where it was
    interrupted. About an hour and a quarter on two cores.
    """
    with need_extra("rl"):
        import octoarm_agents.rl  # noqa: F401
    from octoarm_agents.common.environment import TARGETS
    from octoarm_agents.common.files import write_text
    from octoarm_agents.comparison import AGENTS, Comparison, Protocol, draw_all
    from octoarm_agents.comparison import compare as run
    from octoarm_agents.comparison.report import write_report

    try:
        comparison = Comparison(
            agents=_names(agents) or AGENTS,
            targets=_names(targets) or TARGETS,
            seeds=seeds,
            budget=budget,
            protocol=Protocol(seed=seed, episodes=episodes),
            jobs=jobs or os.cpu_count() or 1,
        )
        result = run(comparison, out)
    except ValueError as error:
        raise typer.BadParameter(f"{error}.") from None
    write_text(out / "compare.md", write_report(result))
    draw_all(result, out)
    for target in result["settings"]["targets"]:
        typer.echo(target)
        for row in result["rows"]:
            if row["target"] == target:
                entry = row["return"]
                typer.echo(
                    f"  {row['agent']:14} {entry['iqm']:6.1f} of 500 "
                    f"[{entry['low']:.1f}, {entry['high']:.1f}]"
                )
    typer.echo(f"Wrote compare.json, compare.md, the figures and trained/ into {out}.")
