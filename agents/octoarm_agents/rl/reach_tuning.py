"""The search for hyper-parameters of reaching: short trainings, judged on goals of their own."""

from __future__ import annotations

import copy
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from octoarm_agents.common.workers import Cluster
from octoarm_agents.rl.hyperparameters import REACH_ID, Hyperparameters
from octoarm_agents.rl.reaching import Algorithm, train_reaching
from octoarm_agents.rl.study import Report, Search, Tell, run_study

TRIAL_STEPS: dict[Algorithm, int] = {"sac": 30_000, "ppo": 192_000}
"""Environment steps of a trial: two to five minutes of one core."""

EVALUATIONS = 3
"""Of a trial, at equal intervals."""


def sample(trial: Any, algorithm: Algorithm, start: Hyperparameters) -> Hyperparameters:
    """Draw hyper-parameters.

    Args:
        trial: of Optuna.
        algorithm: ``"sac"`` or ``"ppo"``.
        start: what is not searched stays as it is there.
    """
    arguments = copy.deepcopy(start.arguments)
    kwargs = arguments["policy_kwargs"]
    rate = float(f"{trial.suggest_float('learning_rate', 2e-4, 4e-3, log=True):.3g}")
    falls = trial.suggest_categorical("schedule", ["constant", "linear"]) == "linear"
    arguments["learning_rate"] = f"lin_{rate}" if falls else rate
    for name, values in _choices(algorithm).items():
        value = trial.suggest_categorical(name, values)
        if name == "width":
            kwargs["net_arch"] = [value] * len(kwargs["net_arch"])
        elif name == "n_sampled_goal":
            arguments["replay_buffer_kwargs"][name] = value
        else:
            arguments[name] = value
    if algorithm == "ppo":
        kwargs["log_std_init"] = round(trial.suggest_float("log_std_init", -2.0, -0.5), 2)
    return replace(start, arguments=arguments)


def _choices(algorithm: Algorithm) -> dict[str, list[Any]]:
    """Values that are tried, by name, in the order in which they are drawn."""
    if algorithm == "sac":
        # Larger batches make a training take twice as long.
        return {
            "gamma": [0.9, 0.95, 0.98],
            "tau": [0.005, 0.01, 0.02, 0.05],
            "batch_size": [128, 256],
            "gradient_steps": [2, 4, 8],
            "width": [128, 256],
            "n_sampled_goal": [2, 4, 8],
            "ent_coef": ["auto", "auto_0.1", "auto_0.01"],
        }
    return {
        "gamma": [0.9, 0.95, 0.97, 0.99],
        "n_steps": [25, 50, 100],
        "batch_size": [200, 400, 800],
        "n_epochs": [5, 10, 20],
        "gae_lambda": [0.9, 0.95, 0.98],
        "clip_range": [0.1, 0.2, 0.3],
        "width": [64, 128, 256],
    }


def _present(algorithm: Algorithm, start: Hyperparameters) -> dict[str, Any]:
    """What the present file holds, by the names of `sample`."""
    kwargs = start.arguments["policy_kwargs"]
    rate = start.arguments["learning_rate"]
    given = {
        **start.arguments.get("replay_buffer_kwargs", {}),
        **start.arguments,
        **kwargs,
        "width": kwargs["net_arch"][0],
        "learning_rate": float(str(rate).removeprefix("lin_")),
        "schedule": "linear" if "learning_rate" in start.schedules else "constant",
    }
    names = ["learning_rate", "schedule", *_choices(algorithm)]
    names += ["log_std_init"] * (algorithm == "ppo")
    return {name: given[name] for name in names}


def tune_reaching(
    algorithm: Algorithm,
    out: Path,
    *,
    trials: int | None = None,
    minutes: float | None = None,
    steps: int | None = None,
    seed: int = 0,
    cluster: Cluster | None = None,
    report: Report | None = None,
) -> dict[str, Any]:
    """Search hyper-parameters by short trainings, each with one seed.

    A trial learns from `search_goals` and is judged on `validation_goals`: no held-out goal is
    seen. Its value is the mean of the shares of goals reached and held at its last evaluation; one
    that is behind at an earlier evaluation is given up. The first trial is what the present file
    holds.

    Args:
        algorithm: ``"sac"`` or ``"ppo"``.
        out: folder for ``study.json``, with every trial, and ``reach_ALGORITHM.yml``, the best.
        trials: as of `run_study`.
        minutes: as of `run_study`.
        steps: environment steps of a training; None: `TRIAL_STEPS`.
        seed: of the sampler and of every training.
        cluster: as of `run_study`.
        report: as of `run_study`.

    Raises:
        ValueError: neither trials nor minutes given, or one of them not positive.
    """
    start = Hyperparameters.load(algorithm, env_id=REACH_ID)
    steps = TRIAL_STEPS[algorithm] if steps is None else steps
    search = Search(
        name=f"reach_{algorithm}",
        algorithm=algorithm,
        env_id=REACH_ID,
        steps=steps,
        seed=seed,
        parts=EVALUATIONS,
        present=_present(algorithm, start),
        sample=partial(sample, algorithm=algorithm, start=start),
        judge=partial(_judge, algorithm, steps, seed),
        details=_values,
    )
    return run_study(search, out, trials=trials, minutes=minutes, cluster=cluster, report=report)


def _judge(algorithm: Algorithm, steps: int, seed: int, tried: Hyperparameters, tell: Tell) -> None:
    """Train; tell how well the policy of every evaluation reaches and holds."""
    with tempfile.TemporaryDirectory() as folder:
        train_reaching(
            algorithm,
            Path(folder),
            steps=steps,
            seed=seed,
            evaluations=EVALUATIONS,
            hyperparameters=tried,
            validation=True,
            progress=lambda point: tell((point["success"] + point["held"]) / 2),
        )


def _values(values: list[float]) -> dict[str, Any]:
    """The value at every evaluation until a trial was given up."""
    return {"values": values}
