"""`octoarm dataset`."""

from __future__ import annotations

from typing import Annotated

import typer

from octoarm_agents.cli.options import (
    EpisodeSeed,
    EpisodeSteps,
    OtherBody,
    need_extra,
    number,
    refused,
)
from octoarm_agents.cli.policy_names import PolicyName, find_policy
from octoarm_agents.common.progress import progress_bar

_NOISE = "Half width of white noise added to the base's command, in degrees."


def dataset(
    policy: PolicyName,
    name: Annotated[
        str | None,
        typer.Option(
            help="Name of the data set, ending in -v and a number.",
            show_default="octoarm/TARGET/AGENT-v0",
        ),
    ] = None,
    episodes: Annotated[int, number("Episodes to record.", 1, 1_000_000)] = 100,
    steps: EpisodeSteps = 500,
    seed: EpisodeSeed = 0,
    action_noise: Annotated[float, number(_NOISE, 0.0, 360.0, "degrees")] = 0.0,
    arm: OtherBody = None,
) -> None:
    """Record episodes of a policy as a Minari data set, to learn from offline.

    It is kept where Minari looks for it, in MINARI_DATASETS_PATH or ~/.minari/datasets, and is
    loaded by its name: minari.load_dataset(NAME). It appears whole or not at all: an interrupted
    run leaves nothing behind. The same call records the same.
    """
    with need_extra("dataset"):
        from octoarm_agents.policies.dataset import DatasetSettings, record_dataset

    named = find_policy(policy, arm)
    if name is None:
        agent, _, target = policy.removesuffix(".npz").rpartition("/")
        if target != named.settings["target"]:
            raise typer.BadParameter(
                f"a data set of the file {policy} needs a name.", param_hint="'--name'"
            )
        name = f"octoarm/{target}/{agent}-v0"
    settings = DatasetSettings(episodes, steps, seed, action_noise)
    try:
        with (
            need_extra("dataset"),
            refused(),
            progress_bar(episodes * steps, "recording", unit=" steps") as bar,
        ):
            data = record_dataset(
                name, named.policy, named, settings, algorithm=policy, progress=bar.update
            )
    except KeyboardInterrupt:
        typer.echo("Stopped; nothing was written.", err=True)
        raise typer.Exit(130) from None
    size = data.storage.metadata["dataset_size"]
    typer.echo(f"Wrote {data.total_episodes} episodes, {data.total_steps} steps, {size} MB, to")
    typer.echo(f"{data.storage.data_path}; load them with")
    typer.echo(f'minari.load_dataset("{name}")')
