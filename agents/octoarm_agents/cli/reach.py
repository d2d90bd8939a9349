"""`octoarm reach`: muscles bring the tip to a goal."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from octoarm_agents.cli.options import (
    ClusterAddress,
    Seed,
    need_extra,
    number,
    output_folder,
    refused,
    result_file,
    result_folder,
)
from octoarm_agents.cli.tune import Minutes, TrialJobs, Trials, search, trial_steps
from octoarm_agents.common.progress import progress_bar

app = typer.Typer(
    help="Reaching with muscles, OctoArmReach-v0: goals, baselines, training.",
    no_args_is_help=True,
)

_OWN = "the algorithm's own"
_FILE = "YAML file of hyper-parameters, as octoarm reach tune writes it."
_STUDY = "Folder for study.json, with every trial, and reach_ALGORITHM.yml, the best."
_EVALUATIONS = "Evaluations, at equal intervals, each with a checkpoint."
_RESUME = "Go on from the folder's checkpoint where there is one."
ReachAlgorithm = Annotated[Literal["sac", "ppo"], typer.Argument(help="sac, with HER; or ppo.")]
PolicyArgument = Annotated[
    str, typer.Argument(help="still, random, wave, nearest; sac, which comes along; or policy.npz.")
]


@app.command()
def goals(
    out: Annotated[Path | None, result_file("File .npy for the goals.")] = None,
    samples: Annotated[int, number("Activations held.", 1, 1_000_000)] = 6144,
    seed: Seed = 0,
) -> None:
    """Sample where muscles can hold the tip.

    Activations, drawn at random, are held for five seconds from rest; one point is kept in every
    cube of 12 mm. The default call gives the goals that come with octoarm_env.
    """
    import numpy as np

    from octoarm_agents.common.files import write_atomically
    from octoarm_agents.policies.reaching import sample_reachable, thin

    with progress_bar(samples, "holding", unit=" arms") as bar:
        _, tips = sample_reachable(samples, seed, bar.update)
    kept = thin(tips)
    low, high = kept.min(axis=0), kept.max(axis=0)
    ranges = ", ".join(
        f"{axis} {1000 * a:.0f} to {1000 * b:.0f} mm"
        for axis, a, b in zip("xyz", low, high, strict=True)
    )
    typer.echo(f"{len(kept)} goals of {len(tips)} samples: {ranges}.")
    if out is not None:
        write_atomically(out, lambda file: np.save(file, kept))
        typer.echo(f"Wrote {out}.")


@app.command()
def train(
    algorithm: ReachAlgorithm,
    steps: Annotated[
        int | None, number("Environment steps.", 1_000, 1_000_000_000, show_default=_OWN)
    ] = None,
    seed: Seed = 0,
    out: Annotated[
        Path | None, typer.Option(help="Folder.", show_default="out/reach/ALGORITHM-SEED")
    ] = None,
    evaluations: Annotated[int, number(_EVALUATIONS, 1, 1000)] = 10,
    hyperparameters: Annotated[
        Path | None, typer.Option(help=_FILE, show_default="those tuned here")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help=_RESUME)] = False,
) -> None:
    """Train an agent to reach, on four fifths of the goals; it is judged on the others.

    policy.npz and training.json are written anew at every evaluation. The policy acts without
    PyTorch: octoarm reach evaluate out/reach/sac-0/policy.npz.

    The same call with --resume goes on where an interrupted training was last evaluated, and
    computes what it would have computed. The checkpoint holds all that this needs, of sac the
    replay buffer with its episodes too: 150 MB after 100,000 steps.
    """
    with need_extra("rl"):
        from octoarm_agents.rl.hyperparameters import REACH_ID, Hyperparameters
        from octoarm_agents.rl.reaching import train_reaching
    folder = output_folder(out or Path("out/reach") / f"{algorithm}-{seed}")
    with refused():
        given = Hyperparameters.load(algorithm, hyperparameters, REACH_ID)
        total = steps or given.steps
        with progress_bar(total, algorithm, unit="step", unit_scale=True) as bar:

            def progress(point: dict[str, float]) -> None:
                bar.update(min(int(point["steps"]), total) - bar.n)
                bar.set_postfix_str(f"{point['success']:.0%} reach")

            summary = train_reaching(
                algorithm,
                folder,
                steps=steps,
                seed=seed,
                evaluations=evaluations,
                hyperparameters=given,
                resume=resume,
                progress=progress,
            )
    last = summary["curve"][-1]
    typer.echo(
        f"Trained {last['steps']:,} steps in {last['seconds']:.0f} s: {last['success']:.1%} of the "
        f"held-out goals are reached, {last['held']:.1%} held for a second."
    )
    typer.echo(f"Wrote {folder / 'policy.npz'}.")


@app.command()
def tune(
    algorithm: ReachAlgorithm,
    trials: Trials = None,
    minutes: Minutes = 30.0,
    steps: Annotated[int | None, trial_steps("sac 30,000; ppo 192,000")] = None,
    seed: Seed = 0,
    cluster: ClusterAddress = None,
    jobs: TrialJobs = None,
    out: Annotated[
        Path | None, typer.Option(help=_STUDY, show_default="out/reach-tune/ALGORITHM")
    ] = None,
) -> None:
    """Search hyper-parameters (Optuna's TPE) by short trainings.

    A trial learns from four fifths of the goals to learn on and is judged on
    the rest of these; the held-out goals are not seen. Its value is the mean of
    the shares reached and held for a second. Trials behind the others are given
    up, as by octoarm tune. The first trial is what octoarm reach train uses now.
    The same call goes on where it was interrupted.

    Use the result with octoarm reach train ALGORITHM --hyperparameters FILE.
    """
    with need_extra("rl"):
        from octoarm_agents.rl.reach_tuning import tune_reaching

    folder = output_folder(out or Path("out/reach-tune") / algorithm)
    given: dict[str, Any] = {"trials": trials, "minutes": minutes, "steps": steps, "seed": seed}
    search(
        lambda **where: tune_reaching(algorithm, folder, **given, **where),
        f"study.json and reach_{algorithm}.yml into {folder}",
        "{:.1%}",
        cluster,
        jobs,
    )


@app.command()
def evaluate(
    policy: PolicyArgument,
    steps: Annotated[int, number("Steps of an episode.", 21, 100_000)] = 100,
) -> None:
    """Let a policy reach for every held-out goal once."""
    from octoarm_agents.policies.reaching import evaluate_reaching

    told = evaluate_reaching(_find(policy), steps=steps)
    typer.echo(
        f"{told['success']:.1%} of the held-out goals are reached at the end, {told['held']:.1%} "
        f"held for a second, {told['ever']:.1%} passed; median distance {told['distance']:.4f} m."
    )


@app.command()
def compare(
    folder: Annotated[Path, typer.Argument(help="Folder of trainings.")] = Path("out/reach"),
    out: Annotated[Path, result_folder("reaching.json and reaching.png")] = Path("out/reach"),
) -> None:
    """Compare finished trainings with the baselines, in a table, a JSON file and a picture.

    The trainings of an algorithm may differ in their seeds alone. One that the folder has no
    training of is kept as an earlier reaching.json has it.
    """
    from rich.console import Console

    from octoarm_agents.cli.printing import new_table
    from octoarm_agents.comparison.reaching import compare_reaching

    with refused(), progress_bar(4, "baselines") as bar:

        def progress(name: str) -> None:
            bar.set_postfix_str(name)
            bar.update(1)

        result = compare_reaching(folder, out, progress)
    table = new_table(
        f"Goals reached, {result['goals']} held out",
        *("", "at the end", "held for a second", "ever", "median distance"),
    )
    for name, told in result["baselines"].items():
        shares = (f"{told[key]:.1%}" for key in ("success", "held", "ever"))
        table.add_row(name, *shares, f"{1000 * told['distance']:.1f} mm")
    for name, agent in result["agents"].items():
        shares = (_spread(agent[key]) for key in ("success", "held", "ever"))
        distance = f"{1000 * agent['distance']['median']:.1f} mm"
        table.add_row(f"{name}, {len(agent['seeds'])} seeds", *shares, distance)
    console = Console()
    console.print(table)
    console.print(f"Wrote {out / 'reaching.png'} and {out / 'reaching.json'}.", soft_wrap=True)


def _spread(measure: dict[str, Any]) -> str:
    low, high = min(measure["values"]), max(measure["values"])
    return f"{measure['median']:.1%} ({low:.1%} to {high:.1%})"


@app.command()
def film(
    policy: PolicyArgument,
    out: Annotated[Path, result_file("Film .gif or .mp4.", show_default=True)] = Path(
        "out/reach/reach.gif"
    ),
    episodes: Annotated[int, number("Goals to reach for, one after the other.", 1, 1000)] = 4,
    seed: Seed = 0,
) -> None:
    """Film a policy that reaches for held-out goals, in the time that it takes."""
    import gymnasium as gym
    import numpy as np

    import octoarm_env  # noqa: F401, registers the environment
    from octoarm_agents.policies.reaching import held_out_goals
    from octoarm_agents.viewing.film import FILMS, check_film, write_film

    size, steps = (480, 360), 60
    if out.suffix.lower() not in FILMS:
        raise typer.BadParameter(f"{out}: expected a name that ends in .gif or .mp4.")
    env = gym.make(
        "OctoArmReach-v0",
        goals=held_out_goals(),
        render_mode="rgb_array",
        width=size[0],
        height=size[1],
    )
    acting = _find(policy, env)
    fps = float(env.metadata["render_fps"])
    with refused():
        check_film(out, size, fps, episodes * steps)

    def frames() -> Iterator[Any]:
        for episode in range(episodes):
            seen, _ = env.reset(seed=seed if episode == 0 else None)
            for _ in range(steps):
                rows = {key: np.asarray(value)[np.newaxis] for key, value in seen.items()}
                action, _ = acting.predict(seen if policy == "wave" else rows)
                seen, *_ = env.step(np.reshape(action, -1))
                yield env.render()
                bar.update(1)

    with need_extra("render"), progress_bar(episodes * steps, "drawing", unit=" frames") as bar:
        count = write_film(out, frames(), size, fps)
    typer.echo(f"Wrote {count} frames to {out}.")


def _find(policy: str, env: Any = None) -> Any:
    """A baseline by its name, for an environment where there is one; or a trained policy's file."""
    from octoarm_agents.policies.reaching import BASELINES, GoalPolicy, load_reaching

    if policy in BASELINES:
        make = BASELINES[policy]
        return make if env is None else make(env)
    if policy == "sac":
        return load_reaching()
    with refused(about=f"{policy}: "):
        return GoalPolicy.load(policy)
