"""The search for hyper-parameters: short trainings on all targets."""

from __future__ import annotations

import copy
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from octoarm_agents.common.environment import ENV_ID, TARGETS
from octoarm_agents.common.workers import Cluster
from octoarm_agents.rl.hyperparameters import Hyperparameters
from octoarm_agents.rl.study import Report, Search, Tell, run_study
from octoarm_agents.rl.task import Training
from octoarm_agents.rl.training import train

TRIAL_STEPS = {
    "ppo": 100_000,
    "recurrent_ppo": 60_000,
    "sac": 16_000,
    "tqc": 10_000,
}
"""Environment steps of a trial on each target: a quarter of a minute to a minute of one core."""

_ON_POLICY = ("ppo", "recurrent_ppo")


def sample(trial: Any, algorithm: str, start: Hyperparameters) -> Hyperparameters:
    """Draw hyper-parameters.

    Args:
        trial: of Optuna.
        algorithm: one of `ALGORITHMS`.
        start: what is not searched stays as it is there.
    """
    arguments = copy.deepcopy(start.arguments)
    kwargs = arguments["policy_kwargs"]
    rate = trial.suggest_float("learning_rate", 2e-4, 4e-3, log=True)
    arguments["learning_rate"] = f"lin_{rate:.3g}"
    for name, values in _choices(algorithm).items():
        value = trial.suggest_categorical(name, values)
        if name == "width":
            kwargs["net_arch"] = [value] * len(kwargs["net_arch"])
        else:
            (kwargs if name == "lstm_hidden_size" else arguments)[name] = value
    if algorithm in _ON_POLICY:
        kwargs["log_std_init"] = round(trial.suggest_float("log_std_init", -2.0, -0.5), 2)
    if algorithm == "tqc":
        dropped = trial.suggest_int("top_quantiles_to_drop_per_net", 0, 4)
        arguments["top_quantiles_to_drop_per_net"] = dropped
    limit = trial.suggest_categorical("max_episode_steps", [50, 100, 200, 500])
    return replace(start, env={**start.env, "max_episode_steps": limit}, arguments=arguments)


def _choices(algorithm: str) -> dict[str, list[Any]]:
    """Values that are tried, by name, in the order in which they are drawn."""
    # Larger ones, and more passes over the same data, take a memory too long here.
    recurrent = algorithm == "recurrent_ppo"
    choices: dict[str, list[Any]] = {
        "gamma": [0.8, 0.9, 0.95, 0.98],
        "width": [64, 128] if recurrent else [64, 128, 256],
        "batch_size": [128, 256, 512],
    }
    if recurrent:
        choices["lstm_hidden_size"] = [32, 64]
    if algorithm not in _ON_POLICY:
        return choices | {"tau": [0.005, 0.01, 0.02], "gradient_steps": [1, 2, 4]}
    return choices | {
        "n_steps": [128, 256, 512],
        "n_epochs": [5, 10] if recurrent else [5, 10, 20],
        "gae_lambda": [0.9, 0.95, 0.98],
        "clip_range": [0.1, 0.2, 0.3],
    }


def _present(algorithm: str, start: Hyperparameters) -> dict[str, Any]:
    """What the present file holds, by the names of `sample`."""
    kwargs = start.arguments["policy_kwargs"]
    given = {
        # What a file may leave out.
        "max_episode_steps": 500,
        "top_quantiles_to_drop_per_net": 2,
        **start.arguments,
        **kwargs,
        **start.env,
        "width": kwargs["net_arch"][0],
        "learning_rate": float(str(start.arguments["learning_rate"]).removeprefix("lin_")),
    }
    names = ["learning_rate", *_choices(algorithm), "max_episode_steps"]
    names += ["log_std_init"] * (algorithm in _ON_POLICY)
    names += ["top_quantiles_to_drop_per_net"] * (algorithm == "tqc")
    return {name: given[name] for name in names}


def tune_algorithm(
    algorithm: str,
    out: Path,
    *,
    trials: int | None = None,
    minutes: float | None = None,
    steps: int | None = None,
    seed: int = 0,
    cluster: Cluster | None = None,
    report: Report | None = None,
) -> dict[str, Any]:
    """Search hyper-parameters by short trainings, each on all three targets with one seed.

    A trial's value is the mean of the last evaluated returns over the targets; one that is behind
    after a target or two is given up. The first trial is what the present file holds.

    Args:
        algorithm: one of `ALGORITHMS`.
        out: folder for ``study.json``, with every trial, and ``ALGORITHM.yml``, the best.
        trials: as of `run_study`.
        minutes: as of `run_study`.
        steps: environment steps of a training; None: `TRIAL_STEPS`.
        seed: of the sampler and of every training.
        cluster: as of `run_study`.
        report: as of `run_study`.

    Raises:
        ValueError: neither trials nor minutes given, or one of them not positive.
    """
    start = Hyperparameters.load(algorithm)
    steps = TRIAL_STEPS[algorithm] if steps is None else steps
    search = Search(
        name=algorithm,
        algorithm=algorithm,
        env_id=ENV_ID,
        steps=steps,
        seed=seed,
        parts=len(TARGETS),
        present=_present(algorithm, start),
        sample=partial(sample, algorithm=algorithm, start=start),
        judge=partial(_judge, algorithm, steps, seed),
        details=_returns,
    )
    return run_study(search, out, trials=trials, minutes=minutes, cluster=cluster, report=report)


def _judge(algorithm: str, steps: int, seed: int, tried: Hyperparameters, tell: Tell) -> None:
    """Train on one target after the other; tell the mean of the returns so far."""
    values: list[float] = []
    for target in TARGETS:
        training = Training.make(
            algorithm, target, steps=steps, seed=seed, evaluations=1, hyperparameters=tried
        )
        with tempfile.TemporaryDirectory() as folder:
            values.append(train(training, Path(folder))["final"]["return"])
        tell(float(np.mean(values)))


def _returns(means: list[float]) -> dict[str, Any]:
    """The return on every target, None where a trial was given up before."""
    sums = [0.0, *(count * mean for count, mean in enumerate(means, 1))]
    returns = dict(zip(TARGETS, np.diff(sums).tolist(), strict=False))
    return {"returns": {name: returns.get(name) for name in TARGETS}}
