"""`octoarm evaluate`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from octoarm_agents.cli.actors import ACTOR_HELP, find_actor
from octoarm_agents.cli.options import (
    EpisodeSeed,
    EpisodeSteps,
    NoiseSize,
    OtherArm,
    PushSize,
    number_between,
    output_file,
)

__all__ = ["evaluate"]


def evaluate(
    policies: Annotated[
        list[str],
        typer.Argument(
            help=ACTOR_HELP,
            show_default=False,
        ),
    ],
    episodes: Annotated[
        int, typer.Option(help="Episodes of each.", callback=number_between(1, 4096))
    ] = 32,
    steps: EpisodeSteps = 500,
    seed: EpisodeSeed = 10_000,
    push: PushSize = 0.0,
    noise: NoiseSize = 0.0,
    arm: OtherArm = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="JSON file for the figures.", callback=output_file, show_default="no file"
        ),
    ] = None,
) -> None:
    """Let agents act, each in the environment it was trained in.

    Prints return, tracking error, distance from the orbit whatever the phase,
    period and survival, and beside them what holding still and the clock that
    knows the target earn. The same call gives the same figures.
    """
    from rich.console import Console
    from rich.table import Table

    from octoarm_agents.common.environment import inspect_env
    from octoarm_agents.common.files import write_json
    from octoarm_agents.policies.evaluation import TRIVIAL, evaluate_policy
    from octoarm_agents.policies.rollout import Noise, Push

    actors = [find_actor(name, arm) for name in policies]
    for index, actor in enumerate(actors):
        if isinstance(actor.policy, str):
            # It is at home wherever its target is; what the environment makes of the rest counts.
            env = actor.make_env(steps)
            actors[index] = replace(actor, settings=inspect_env(env)[1])
            env.close()
    # Beside the agents of each home the trivial ones, unless they are among them.
    for home in list(actors):
        for kind in TRIVIAL:
            beside = replace(home, name=kind, policy=kind)
            if not any(replace(each, name=kind) == beside for each in actors):
                actors.append(beside)
    table = Table()
    table.add_column("agent", overflow="fold")
    for heading in ("target", "return", "error (°)", "orbit distance", "period", "survival"):
        table.add_column(heading, justify="right")
    results = []
    for actor in actors:
        assert actor.policy is not None
        try:
            figures = evaluate_policy(
                actor.policy,
                actor,
                episodes=episodes,
                steps=steps,
                seed=seed,
                push=Push.after_a_second(push, actor.settings["control_period"]) if push else None,
                noise=Noise(noise) if noise else None,
            )
        except ValueError as error:
            raise typer.BadParameter(f"{actor.name}: {error}.") from None
        target = actor.settings["target"]
        results.append({"agent": actor.name, "target": target, **figures})
        table.add_row(
            actor.name,
            target if isinstance(target, str) else "own",
            f"{figures['return']:.1f}",
            f"{figures['tracking_error']:.3f}",
            *(_cell(figures[key]) for key in ("orbit_distance", "period")),
            f"{figures['survival']:.0%}",
        )
    Console(width=120).print(table)
    if out is not None:
        settings: dict[str, Any] = {
            "episodes": episodes,
            "steps": steps,
            "seed": seed,
            "push": push,
        }
        settings |= {"noise": noise, "arm": None if arm is None else actor.parameters.to_dict()}
        write_json(out, {"settings": settings, "rows": results})
        typer.echo(f"Wrote {out}.")


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"
