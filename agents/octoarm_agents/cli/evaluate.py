"""`octoarm evaluate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from octoarm_agents.cli.actors import find_policy
from octoarm_agents.cli.options import (
    EpisodeSeed,
    EpisodeSteps,
    NoiseSize,
    OtherArm,
    PushSize,
    number_between,
    output_file,
    read_body,
)

__all__ = ["evaluate"]


def evaluate(
    policies: Annotated[
        list[str],
        typer.Argument(
            help="Files of agents (.json, .npz), or AGENT/TARGET for those that come along.",
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
    """Let saved agents act in the environment they were trained in.

    Prints return, tracking error, distance from the orbit whatever the phase,
    period and survival, and beside them what holding still and the clock that
    knows the target earn. The same call gives the same figures.
    """
    from rich.console import Console
    from rich.table import Table

    from octoarm_agents.files import write_json
    from octoarm_agents.policies.evaluation import evaluate_policy
    from octoarm_agents.policies.rollout import Noise, Push

    agents = [(name, find_policy(name)) for name in policies]
    body = None if arm is None else read_body(arm)
    homes: list[Any] = []
    for _, policy in agents:
        if not any(policy.settings == home.settings for home in homes):
            homes.append(policy)
    rows: list[tuple[str, Any, Any]] = [(name, policy, policy) for name, policy in agents]
    rows += [(kind, kind, home) for home in homes for kind in ("hold", "clock")]
    table = Table()
    table.add_column("agent", overflow="fold")
    for heading in ("target", "return", "error (°)", "orbit distance", "period", "survival"):
        table.add_column(heading, justify="right")
    results = []
    for name, policy, home in rows:
        try:
            figures = evaluate_policy(
                policy,
                home,
                episodes=episodes,
                steps=steps,
                seed=seed,
                body=body,
                push=Push.after_a_second(push, home.settings["control_period"]) if push else None,
                noise=Noise(noise) if noise else None,
            )
        except ValueError as error:
            raise typer.BadParameter(f"{name}: {error}.") from None
        target = home.settings["target"]
        results.append({"agent": name, "target": target, **figures})
        table.add_row(
            name,
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
        settings |= {"noise": noise, "arm": None if body is None else body.to_dict()}
        write_json(out, {"settings": settings, "rows": results})
        typer.echo(f"Wrote {out}.")


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"
