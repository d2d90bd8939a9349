"""The search for hyper-parameters: Optuna's TPE over short trainings on all targets."""

from __future__ import annotations

import copy
import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from octoarm_agents.common.environment import ENV_ID, TARGETS
from octoarm_agents.common.files import write_json, write_text
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.whole import whole_number
from octoarm_agents.common.workers import Cluster, check_installed, installed
from octoarm_agents.rl.hyperparameters import Hyperparameters
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

Means = Callable[[dict[str, Any]], Iterator[float]]


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
    report: Callable[[dict[str, Any], float], None] | None = None,
) -> dict[str, Any]:
    """Search hyper-parameters by short trainings, each on all three targets with one seed.

    A trial's value is the mean of the last evaluated returns over the targets; one that is behind
    after a target or two is given up: here by the median (Optuna's MedianPruner), on a cluster by
    asynchronous successive halving (Ray Tune's ASHAScheduler). The first trial is what the present
    file holds. The study is kept in ``out/study.db`` and goes on where it ended, here or there.

    Args:
        algorithm: one of `ALGORITHMS`.
        out: folder for ``study.json``, with every trial, and ``ALGORITHM.yml``, the best.
        trials: number of trials, those kept from before included; None: as many as the time allows.
        minutes: stop beginning trials after this time.
        steps: environment steps of a training; None: `TRIAL_STEPS`.
        seed: of the sampler and of every training.
        cluster: where trials are computed, several at once; None: here, one after the other.
        report: called after every trial with its entry in ``study.json`` and the best value so far.

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

    out.mkdir(parents=True, exist_ok=True)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    storage = optuna.storages.RDBStorage(f"sqlite:///{out / 'study.db'}")
    study = optuna.create_study(
        study_name=f"{algorithm} {steps} {seed}",
        storage=storage,
        sampler=optuna.samplers.TPESampler(
            seed=seed, multivariate=True, n_startup_trials=5, constant_liar=cluster is not None
        ),
        pruner=optuna.pruners.MedianPruner(n_startup_trials=3, n_warmup_steps=0),
        direction="maximize",
        load_if_exists=True,
    )
    if not study.trials:
        study.enqueue_trial(_present(algorithm, start))
    told = {row["number"] for row in _rows(study)}
    left = None if trials is None else max(trials - len(told), 0)
    seconds = None if minutes is None else 60 * minutes

    def tell() -> None:
        rows = _rows(study)
        values = [row["value"] for row in rows if row["value"] is not None]
        for row in rows:
            if report is not None and row["number"] not in told:
                report(row, max(values, default=math.nan))
            told.add(row["number"])

    draw = partial(sample, algorithm=algorithm, start=start)
    means = partial(_running_means, algorithm, steps, seed)
    if left == 0:
        pass
    elif cluster is None:
        _search_here(study, draw, means, left, seconds, tell)
    else:
        _search_on_cluster(study, storage, draw, means, left, seconds, tell, cluster.jobs)
    rows = _rows(study)
    best = _best(rows)
    entries = sample(optuna.trial.FixedTrial(best["parameters"]), algorithm, start).entries()
    result = {
        "algorithm": algorithm,
        "steps": steps,
        "seed": seed,
        "trials": rows,
        "best": {"number": best["number"], "value": best["value"], "hyperparameters": entries},
        "seconds": sum(each["seconds"] or 0.0 for each in rows),
        "machine": describe_machine(),
        "versions": package_versions("optuna", "stable-baselines3", "sb3-contrib", "octoarm-env"),
    }
    write_json(out / "study.json", result)
    text = yaml.safe_dump({ENV_ID: entries}, sort_keys=False, default_flow_style=None)
    write_text(out / f"{algorithm}.yml", text)
    return result


def _running_means(
    algorithm: str, steps: int, seed: int, parameters: dict[str, Any]
) -> Iterator[float]:
    """Train on one target after the other; give the mean of the returns so far."""
    from optuna.trial import FixedTrial

    tried = sample(FixedTrial(parameters), algorithm, Hyperparameters.load(algorithm))
    values: list[float] = []
    for target in TARGETS:
        training = Training.make(
            algorithm, target, steps=steps, seed=seed, evaluations=1, hyperparameters=tried
        )
        with tempfile.TemporaryDirectory() as folder:
            values.append(train(training, Path(folder))["final"]["return"])
        yield float(np.mean(values))


def _search_here(
    study: Any,
    draw: Callable[[Any], object],
    means: Means,
    trials: int | None,
    seconds: float | None,
    tell: Callable[[], None],
) -> None:
    import optuna

    def objective(trial: Any) -> float:
        draw(trial)
        value = 0.0
        for index, value in enumerate(means(trial.params)):
            trial.report(value, index)
            if index + 1 < len(TARGETS) and trial.should_prune():
                raise optuna.TrialPruned
        return value

    study.optimize(
        objective, n_trials=trials, timeout=seconds, callbacks=[lambda study, trial: tell()]
    )


def _search_on_cluster(
    study: Any,
    storage: Any,
    draw: Callable[[Any], object],
    means: Means,
    trials: int | None,
    seconds: float | None,
    tell: Callable[[], None],
    jobs: int,
) -> None:
    """Let Ray Tune compute trials of the same study, several at once."""
    import ray
    from ray import tune
    from ray.tune.schedulers import ASHAScheduler
    from ray.tune.search import Searcher
    from ray.tune.search.optuna import OptunaSearch

    if ray.util.client.ray.is_connected():
        raise ValueError("cluster = 'ray://…': Ray Tune needs HOST:PORT, within the cluster")
    # Its files of every trial, when nothing is kept but the study.
    os.environ.setdefault("TUNE_DISABLE_AUTO_CALLBACK_LOGGERS", "1")
    begun = time.monotonic()

    class Search(OptunaSearch):  # type: ignore[misc]
        def suggest(self, trial_id: str) -> Any:
            late = seconds is not None and time.monotonic() - begun > seconds
            return Searcher.FINISHED if late else super().suggest(trial_id)

        def on_trial_complete(self, trial_id: str, result: Any = None, error: bool = False) -> None:
            # A trial's last result is given here alone.
            if result:
                self.on_trial_result(trial_id, result)
            super().on_trial_complete(trial_id, result, error)
            tell()

        def save(self, checkpoint_path: str) -> None:
            """Nothing: the study is in its own file."""

    expected = installed()

    def trial(parameters: dict[str, Any]) -> None:
        check_installed(expected)
        for value in means(parameters):
            tune.report({"value": value})

    search = Search(
        lambda each: draw(each) and None,
        metric="value",
        mode="max",
        sampler=study.sampler,
        study_name=study.study_name,
        storage=storage,
    )
    with tempfile.TemporaryDirectory() as folder:
        results = tune.Tuner(
            tune.with_resources(trial, {"cpu": 1}),
            tune_config=tune.TuneConfig(
                search_alg=search,
                scheduler=ASHAScheduler(
                    metric="value",
                    mode="max",
                    grace_period=1,
                    max_t=len(TARGETS),
                    reduction_factor=2,
                ),
                num_samples=-1 if trials is None else trials,
                max_concurrent_trials=jobs,
            ),
            run_config=tune.RunConfig(
                storage_path=folder,
                verbose=0,
                failure_config=tune.FailureConfig(max_failures=3),
            ),
        ).fit()
    if results.errors:
        raise results.errors[0]


def _rows(study: Any) -> list[dict[str, Any]]:
    """The trials that have ended, as they stand in ``study.json``."""
    from optuna.trial import TrialState

    rows = []
    for each in study.get_trials(states=(TrialState.COMPLETE, TrialState.PRUNED)):
        means = [mean for _, mean in sorted(each.intermediate_values.items())]
        sums = [0.0, *(count * mean for count, mean in enumerate(means, 1))]
        returns = dict(zip(TARGETS, np.diff(sums).tolist(), strict=False))
        complete = len(means) == len(TARGETS)
        rows.append(
            {
                "number": each.number,
                "value": means[-1] if complete else None,
                "pruned": not complete,
                "parameters": each.params,
                "returns": {name: returns.get(name) for name in TARGETS},
                "seconds": None if each.duration is None else each.duration.total_seconds(),
            }
        )
    return rows


def _best(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The first of the trials with the highest value.

    Raises:
        ValueError: none has one.
    """
    valued = [row for row in rows if row["value"] is not None]
    if not valued:
        raise ValueError("no trial was trained to its end")
    return max(valued, key=lambda row: float(row["value"]))
