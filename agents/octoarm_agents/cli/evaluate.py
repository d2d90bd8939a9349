"""`octoarm evaluate`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from octoarm_agents.cli.options import (
    Bodies,
    BodySeed,
    EpisodeSeed,
    EpisodeSteps,
    NoiseSize,
    OtherBody,
    PushSize,
    Vary,
    number,
    refused,
    result_file,
    varied,
)
from octoarm_agents.cli.policy_names import POLICY_HELP, find_policy
from octoarm_agents.cli.printing import new_table


def evaluate(
    policies: Annotated[list[str], typer.Argument(help=POLICY_HELP, show_default=False)],
    episodes: Annotated[int, number("Episodes of each.", 1, 4096)] = 32,
    steps: EpisodeSteps = 500,
    seed: EpisodeSeed = 10_000,
    push: PushSize = 0.0,
    noise: NoiseSize = 0.0,
    arm: OtherBody = None,
    vary: Vary = None,
    bodies: Bodies = 16,
    body_seed: BodySeed = 0,
    out: Annotated[
        Path | None, result_file("JSON file for the figures.", show_default="no file")
    ] = None,
) -> None:
    """Let policies act, each in the environment it was trained in.

    Prints return, tracking error, distance from the orbit whatever the phase,
    period and survival, and beside them what holding still and the clock that
    knows the target earn. The same call gives the same figures.
    """
    from rich.console import Console

    from octoarm_agents.common.files import write_json
    from octoarm_agents.policies.evaluation import TRIVIAL, evaluate_policy
    from octoarm_agents.policies.rollout import Noise, Push

    named = [find_policy(name, arm) for name in policies]
    drawn = varied(vary, bodies, body_seed)
    # Beside the policies of each home the trivial ones, unless they are among them.
    for home in list(named):
        for kind in TRIVIAL:
            beside = replace(home, name=kind, policy=kind)
            if not any(replace(each, name=kind) == beside for each in named):
                named.append(beside)
    table = new_table(
        None, "agent", "target", "return", "error (°)", "orbit distance", "period", "survival"
    )
    rows = []
    for each in named:
        with refused(about=f"{each.name}: "):
            figures = evaluate_policy(
                each.policy,
                replace(each, settings={**each.settings, **drawn}),
                episodes=episodes,
                steps=steps,
                seed=seed,
                push=Push.after_a_second(push, each.settings["control_period"]) if push else None,
                noise=Noise(noise) if noise else None,
            )
        target = each.settings["target"]
        rows.append({"agent": each.name, "target": target, **figures})
        distance, period = (figures[key] for key in ("orbit_distance", "period"))
        table.add_row(
            each.name,
            target if isinstance(target, str) else "own",
            f"{figures['return']:.1f}",
            f"{figures['tracking_error']:.3f}",
            *("-" if value is None else f"{value:.4f}" for value in (distance, period)),
            f"{figures['survival']:.0%}",
        )
    Console(width=120).print(table)
    if out is not None:
        body = None if arm is None else each.parameters.to_dict()
        settings = {"episodes": episodes, "steps": steps, "seed": seed, "push": push}
        write_json(
            out, {"settings": {**settings, "noise": noise, "arm": body, **drawn}, "rows": rows}
        )
        typer.echo(f"Wrote {out}.")
