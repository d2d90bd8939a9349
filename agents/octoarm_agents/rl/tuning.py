"""The search for hyper-parameters: Optuna's TPE over short trainings on all targets."""

from __future__ import annotations

import copy
import json
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from octoarm_agents.common.environment import ENV_ID, TARGETS
from octoarm_agents.common.files import write_json, write_text
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.whole import whole_number
from octoarm_agents.rl.hyperparameters import Hyperparameters
from octoarm_agents.rl.training import Training, train

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
    report: Callable[[Any, Any], None] | None = None,
) -> dict[str, Any]:
    """Search hyper-parameters by short trainings, each on all three targets with one seed.

    A trial's value is the mean of the last evaluated returns over the targets; one that is behind
    the median after a target or two is given up (Optuna's MedianPruner). The first trial is what
    the present file holds. The study is kept in ``out/study.db`` and goes on where it ended.

    Args:
        algorithm: one of `ALGORITHMS`.
        out: folder for ``study.json``, with every trial, and ``ALGORITHM.yml``, the best.
        trials: number of trials, those kept from before included; None: as many as the time allows.
        minutes: stop beginning trials after this time.
        steps: environment steps of a training; None: `TRIAL_STEPS`.
        seed: of the sampler and of every training.
        report: called after every trial with Optuna's study and trial.

    Raises:
        ValueError: neither trials nor minutes given, or one of them not positive.
    """
    if trials is None and minutes is None:
        raise ValueError("trials = None and minutes = None: expected at least one of them")
    if minutes is not None and not minutes > 0:
        raise ValueError(f"minutes = {minutes}: expected a positive number")
    trials = None if trials is None else whole_number("trials", trials, 1)
    start = Hyperparameters.load(algorithm)
    steps = whole_number("steps", TRIAL_STEPS[algorithm] if steps is None else steps, 1)
    seed = whole_number("seed", seed)

    import optuna
    from optuna.trial import TrialState

    out.mkdir(parents=True, exist_ok=True)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(
        study_name=f"{algorithm} {steps} {seed}",
        storage=f"sqlite:///{out / 'study.db'}",
        sampler=optuna.samplers.TPESampler(seed=seed, multivariate=True, n_startup_trials=5),
        pruner=optuna.pruners.MedianPruner(n_startup_trials=3, n_warmup_steps=0),
        direction="maximize",
        load_if_exists=True,
    )
    if not study.trials:
        study.enqueue_trial(_present(algorithm, start))

    def objective(trial: Any) -> float:
        tried = sample(trial, algorithm, start)
        trial.set_user_attr("hyperparameters", json.dumps(tried.entries()))
        values: list[float] = []
        for index, target in enumerate(TARGETS):
            training = Training.make(
                algorithm, target, steps=steps, seed=seed, evaluations=1, hyperparameters=tried
            )
            with tempfile.TemporaryDirectory() as folder:
                values.append(train(training, Path(folder))["final"]["return"])
            trial.set_user_attr(target, values[-1])
            trial.report(float(np.mean(values)), index)
            if index + 1 < len(TARGETS) and trial.should_prune():
                raise optuna.TrialPruned
        return float(np.mean(values))

    def ended() -> list[Any]:
        return study.get_trials(states=(TrialState.COMPLETE, TrialState.PRUNED))

    left = None if trials is None else trials - len(ended())
    if left is None or left > 0:
        timeout = None if minutes is None else 60 * minutes
        study.optimize(
            objective, n_trials=left, timeout=timeout, callbacks=[] if report is None else [report]
        )
    trial_rows = [
        {
            "number": each.number,
            "value": each.value if each.state == TrialState.COMPLETE else None,
            "pruned": each.state == TrialState.PRUNED,
            "parameters": each.params,
            "returns": {name: each.user_attrs.get(name) for name in TARGETS},
            "seconds": None if each.duration is None else each.duration.total_seconds(),
        }
        for each in ended()
    ]
    best = study.best_trial
    entries = json.loads(best.user_attrs["hyperparameters"])
    result = {
        "algorithm": algorithm,
        "steps": steps,
        "seed": seed,
        "trials": trial_rows,
        "best": {"number": best.number, "value": best.value, "hyperparameters": entries},
        "seconds": sum(each["seconds"] or 0.0 for each in trial_rows),
        "machine": describe_machine(),
        "versions": package_versions("optuna", "stable-baselines3", "sb3-contrib", "octoarm-env"),
    }
    write_json(out / "study.json", result)
    text = yaml.safe_dump({ENV_ID: entries}, sort_keys=False, default_flow_style=None)
    write_text(out / f"{algorithm}.yml", text)
    return result
