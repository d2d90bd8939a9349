"""`octoarm train`."""

from __future__ import annotations

import math
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from octoarm_agents.cli.options import need_extra, number_between, output_folder, read_body
from octoarm_agents.common.progress import progress_bar

if TYPE_CHECKING:
    from octoarm_agents.rl import Training

__all__ = ["train"]


def train(
    algorithm: Annotated[
        Literal["ppo", "sac", "tqc", "recurrent_ppo"],
        typer.Argument(help="What trains.", show_default=False),
    ],
    target: Annotated[
        Literal["quadratic", "van_der_pol", "lissajous"],
        typer.Option(help="Limit cycle (Eqs. 28, 27, 29)."),
    ] = "quadratic",
    steps: Annotated[
        int | None,
        typer.Option(
            help="Environment steps, over all environments. More of them with --resume extend a "
            "training, finished or not.",
            show_default="the algorithm's own",
            callback=number_between(1, 10_000_000_000),
        ),
    ] = None,
    seed: Annotated[
        int,
        typer.Option(
            help="Of networks, exploration, environments.",
            callback=number_between(0, 2**31 - 1),
        ),
    ] = 0,
    num_envs: Annotated[
        int | None,
        typer.Option(
            help="Environments stepped together.",
            show_default="the algorithm's own",
            callback=number_between(1, 65_536),
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the policies, the model, the curve and the checkpoint.",
            show_default="out/train/ALGORITHM-TARGET-SEED",
        ),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Go on from the folder's checkpoint where there is one."),
    ] = False,
    hyperparameters: Annotated[
        Path | None,
        typer.Option(
            help="YAML file in the format of rl-baselines3-zoo.", show_default="those tuned here"
        ),
    ] = None,
    evaluations: Annotated[
        int,
        typer.Option(
            help="Evaluations, at equal intervals, each with a checkpoint.",
            callback=number_between(1, 10_000),
        ),
    ] = 20,
    amplitude: Annotated[
        float | None,
        typer.Option(
            "--amplitude",
            "-R",
            help="R: largest angle of the target in degrees.",
            show_default="the paper's",
            callback=number_between(0.1, 360.0, "degrees"),
        ),
    ] = None,
    arm: Annotated[
        Path | None,
        typer.Option(
            "--arm",
            help="A body: nakajima2013, inertial, or a JSON file of parameters.",
            show_default="the default body",
        ),
    ] = None,
    tensorboard: Annotated[
        bool, typer.Option(help="Write logs for TensorBoard into the folder.")
    ] = True,
) -> None:
    """Train an agent with stable-baselines3 on the native batch of arms.

    Hyper-parameters were tuned on this environment (docs/comparison.md).
    During training the policy is evaluated on seeds that it is not trained on;
    best.npz is the best of these policies, final.npz the last one. Both act
    without PyTorch: octoarm evaluate, octoarm watch,
    octoarm_agents.policies.load_policy. final_model.zip and vecnormalize.pkl
    are stable-baselines3's own, to train on or to take apart.

    The same call with --resume goes on where an interrupted training was last
    saved, and then computes what it would have computed. The same seed gives
    the same curve: one thread computes. With more --steps as well, it goes on
    for longer, as one of so many steps would have: but for hyper-parameters
    that fall over the whole training, which a warning names.
    """
    with need_extra("rl"):
        from octoarm_agents.rl import Hyperparameters, Training
        from octoarm_agents.rl.training import CHECKPOINT

    folder = output_folder(out or Path("out/train") / f"{algorithm}-{target}-{seed}")
    if not resume and (folder / CHECKPOINT).exists():
        raise typer.BadParameter(
            f"{folder} holds a training: go on with --resume (and more --steps, to extend it), or "
            "choose another folder.",
            param_hint="'--out'",
        )
    env: dict[str, Any] = {}
    if amplitude is not None:
        env["amplitude"] = amplitude
    if arm is not None:
        env["arm"] = read_body(arm)
    try:
        training = Training.make(
            algorithm,
            target,
            steps=steps,
            seed=seed,
            num_envs=num_envs,
            evaluations=evaluations,
            env=env,
            hyperparameters=Hyperparameters.load(algorithm, hyperparameters),
        )
        summary = _train(training, folder, resume, resume and steps is not None, tensorboard)
    except (OSError, ValueError) as error:
        raise typer.BadParameter(f"{error}.") from None
    best, final = summary["best"], summary["final"]
    typer.echo(
        f"Trained {final['steps']:,} steps in {summary['seconds']:.0f} s. The last policy earns "
        f"{final['return']:.1f} of 500; the best, after {best['steps']:,} steps, "
        f"{best['return']:.1f}."
    )
    typer.echo(f"Look at it: octoarm watch {folder / 'best.npz'}")


def _train(
    training: Training, folder: Path, resume: bool, extend: bool, tensorboard: bool
) -> dict[str, Any]:
    from octoarm_agents.rl import train as run

    name = f"{training.algorithm}, {training.target}"
    with progress_bar(training.steps, name, unit="step", unit_scale=True) as bar:

        def progress(done: int, value: float) -> None:
            bar.update(min(done, training.steps) - bar.n)
            if not math.isnan(value):
                bar.set_postfix_str(f"return {value:.1f} of 500")

        return run(
            training,
            folder,
            resume=resume,
            extend=extend,
            tensorboard=tensorboard,
            progress=progress,
            command=shlex.join(["octoarm", *sys.argv[1:]]),
        )
