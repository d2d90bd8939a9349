"""`octoarm train`."""

from __future__ import annotations

import math
import shlex
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from octoarm_agents.cli.options import (
    Algorithm,
    Amplitude,
    Bodies,
    Body,
    BodySeed,
    ClusterAddress,
    NoiseSize,
    Seed,
    Target,
    Vary,
    need_extra,
    number,
    output_folder,
    read_body,
    refused,
    varied,
    workers_of,
)
from octoarm_agents.common.progress import progress_bar

_STEPS = "Environment steps of all environments; more of them with --resume extend a training."
_OUT = "Folder for the policies, the model, the curve and the checkpoint."
_RESUME = "Go on from the folder's checkpoint where there is one."
_FILE = "YAML file in the format of rl-baselines3-zoo."
_EVALUATIONS = "Evaluations, at equal intervals, each with a checkpoint."
_OWN: dict[str, Any] = {"show_default": "the algorithm's own"}


def train(
    algorithm: Algorithm,
    target: Target = "quadratic",
    steps: Annotated[int | None, number(_STEPS, 1, 10_000_000_000, **_OWN)] = None,
    seed: Seed = 0,
    num_envs: Annotated[
        int | None, number("Environments stepped together.", 1, 65_536, **_OWN)
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help=_OUT, show_default="out/train/ALGORITHM-TARGET-SEED")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help=_RESUME)] = False,
    hyperparameters: Annotated[
        Path | None, typer.Option(help=_FILE, show_default="those tuned here")
    ] = None,
    evaluations: Annotated[int, number(_EVALUATIONS, 1, 10_000)] = 20,
    amplitude: Amplitude = None,
    arm: Body = None,
    noise: NoiseSize = 0.0,
    vary: Vary = None,
    bodies: Bodies = 64,
    body_seed: BodySeed = 0,
    tensorboard: Annotated[
        bool, typer.Option(help="Write logs for TensorBoard into the folder; with sb3.")
    ] = True,
    engine: Annotated[
        Literal["sb3", "rllib"],
        typer.Option(help="stable-baselines3, or Ray's RLlib, which knows ppo only."),
    ] = "sb3",
    workers: Annotated[
        int | None,
        number("Processes that step arms, with rllib.", 0, 1024, show_default="2"),
    ] = None,
    cluster: ClusterAddress = None,
) -> None:
    """Train an agent on the native batch of arms.

    The policy is evaluated on seeds that it is not trained on: best.npz is the
    best one, final.npz the last. Both act without PyTorch: octoarm evaluate,
    octoarm watch, octoarm_agents.policies.load_policy. final_model.zip and
    vecnormalize.pkl are stable-baselines3's own.

    The same seed gives the same curve. The same call with --resume goes on
    where an interrupted training was last saved, and computes what it would
    have computed; with more --steps it goes on for longer (docs/agents.md).

    With --vary the agent is trained, and judged, on many bodies, one of which
    each episode draws; other bodies have another --body-seed.

    With --engine rllib, --workers processes step the arms, here or on a Ray
    cluster; nothing then promises the same curve for the same seed, and a
    training may not be extended (docs/cluster.md).
    """
    if engine == "sb3" and (workers, cluster) != (None, None):
        raise typer.BadParameter("--workers and --cluster: only with --engine rllib.")
    with need_extra("rl"):
        from octoarm_agents.rl import Hyperparameters, Training
        from octoarm_agents.rl import train as run
    if engine == "rllib":
        with need_extra("ray,rllib"):
            from octoarm_agents.rl import rllib
        if cluster is not None:
            workers_of(None, cluster)

    folder = output_folder(out or Path("out/train") / f"{algorithm}-{target}-{seed}")
    env = {"amplitude": amplitude, "arm": None if arm is None else read_body(arm)}
    env |= varied(vary, bodies, body_seed)
    with refused():
        training = Training.make(
            algorithm,
            target,
            steps=steps,
            seed=seed,
            num_envs=num_envs,
            evaluations=evaluations,
            env={name: value for name, value in env.items() if value is not None},
            hyperparameters=Hyperparameters.load(algorithm, hyperparameters),
            noise=noise,
        )
        with progress_bar(
            training.steps, f"{algorithm}, {target}", unit="step", unit_scale=True
        ) as bar:

            def progress(done: int, value: float) -> None:
                bar.update(min(done, training.steps) - bar.n)
                if not math.isnan(value):
                    bar.set_postfix_str(f"return {value:.1f} of 500")

            given: dict[str, Any] = {"resume": resume, "progress": progress}
            given["command"] = shlex.join(["octoarm", *sys.argv[1:]])
            if engine == "rllib":
                workers = 2 if workers is None else workers
                summary = rllib.train(training, folder, workers=workers, **given)
            else:
                extend = resume and steps is not None
                summary = run(training, folder, extend=extend, tensorboard=tensorboard, **given)
    best, final = summary["best"], summary["final"]
    typer.echo(
        f"Trained {final['steps']:,} steps in {summary['seconds']:.0f} s. The last policy earns "
        f"{final['return']:.1f} of 500; the best, after {best['steps']:,} steps, "
        f"{best['return']:.1f}."
    )
    typer.echo(f"Look at it: octoarm watch {folder / 'best.npz'}")
