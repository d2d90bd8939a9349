"""`octoarm compare`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from octoarm_agents.cli.options import (
    Actuator,
    Amplitude,
    Body,
    ClusterAddress,
    Jobs,
    need_extra,
    number,
    refused,
    result_folder,
    workers_of,
)

Out = Annotated[
    Path,
    result_folder("compare.json, summary.json, compare.md, figures, agents in trained/"),
]


def compare(
    out: Out = Path("out/compare"),
    agents: Annotated[
        str | None, typer.Option(help="Some of the agents, with commas.", show_default="all")
    ] = None,
    targets: Annotated[
        str | None, typer.Option(help="Some of the targets, with commas.", show_default="all three")
    ] = None,
    seeds: Annotated[int, number("Trainings of each agent on each target.", 1, 1000)] = 5,
    budget: Annotated[
        float, number("Factor of the environment steps of all trainings.", 1e-6, 1e6)
    ] = 1.0,
    episodes: Annotated[int, number("Episodes in each test.", 1, 4096)] = 16,
    seed: Annotated[int, number("First seed of the tests' episodes.", 0, 2**31 - 1)] = 10_000,
    amplitude: Amplitude = None,
    arm: Body = None,
    actuator: Actuator = "direct",
    kept: Annotated[
        bool,
        typer.Option("--kept", help="Of what is in OUT/results alone: train nothing."),
    ] = False,
    jobs: Jobs = None,
    cluster: ClusterAddress = None,
) -> None:
    """Compare readouts, a searched linear policy, networks, and doing nothing.

    Trains several times on each target, and measures all agents on the same
    episodes: return, tracking error, orbit and period, survival, recovery
    after pushes and noise, other bodies, cost. The agents: readout_pinv,
    readout_ridge, readout_noise, readout_weighted, readout_aggregated,
    readout_designed, readout_past, linear_search, ppo, ppo_noise, sac, tqc,
    recurrent_ppo, hold, clock.

    What is finished is kept in OUT/results: the same call goes on where it
    was interrupted, and with more agents, targets or seeds the table grows.
    All together take about four hours on two cores; from the results in
    docs/comparison, with --out docs/comparison, a minute.
    """
    with need_extra("rl"):
        import octoarm_agents.rl  # noqa: F401
    from octoarm_agents.common.environment import TARGETS
    from octoarm_agents.common.files import write_text
    from octoarm_agents.comparison import AGENTS, Comparison, TestPlan, draw_all
    from octoarm_agents.comparison import compare as run
    from octoarm_agents.comparison.report import write_report

    given = {"amplitude": amplitude, "arm": None if arm is None else str(arm)}
    env = {name: value for name, value in given.items() if value is not None}
    if actuator != "direct":
        env["actuator"] = actuator
    with refused():
        comparison = Comparison(
            agents=_names(agents) or AGENTS,
            targets=_names(targets) or TARGETS,
            seeds=seeds,
            budget=budget,
            plan=TestPlan(seed=seed, episodes=episodes),
            jobs=workers_of(jobs, cluster),
            kept=kept,
            env=env,
        )
        result = run(comparison, out)
    write_text(out / "compare.md", write_report(result))
    draw_all(result, out)
    for target in comparison.targets:
        typer.echo(target)
        for row in result["rows"]:
            if row["target"] == target:
                earned = row["return"]
                interval = f"[{earned['low']:.1f}, {earned['high']:.1f}]"
                typer.echo(f"  {row['agent']:14} {earned['iqm']:6.1f} of 500 {interval}")
    typer.echo(f"Wrote compare.json, summary.json, compare.md, figures and trained/ into {out}.")


def _names(text: str | None) -> tuple[str, ...] | None:
    return None if text is None else tuple(name.strip() for name in text.split(","))
