"""A search for hyper-parameters, whatever the task: Optuna's TPE over short trainings."""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from octoarm_agents.common.files import write_json, write_text
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.whole import whole_fields, whole_number
from octoarm_agents.common.workers import Cluster, check_installed, installed
from octoarm_agents.rl.hyperparameters import Hyperparameters

Tell = Callable[[float], None]
Report = Callable[[dict[str, Any], float], None]


@dataclass(frozen=True)
class Search:
    """What is searched, and by what: each task has its own.

    Attributes:
        name: of the file of the best, without its ending.
        algorithm: one of `ALGORITHMS`.
        env_id: of the environment, under which the best stand in their file.
        steps: environment steps of a training.
        seed: of the sampler and of every training.
        parts: values that a trial tells; the last of them is its own.
        present: what is tried first, by the names of `sample`.
        sample: draws hyper-parameters from a trial of Optuna; must pickle.
        judge: trains with hyper-parameters and tells a value after every part; must pickle.
        details: further entries of a trial in ``study.json``, from the values told.

    Raises:
        ValueError: steps or a seed out of their range.
    """

    name: str
    algorithm: str
    env_id: str
    steps: int
    seed: int
    parts: int
    present: dict[str, Any]
    sample: Callable[[Any], Hyperparameters]
    judge: Callable[[Hyperparameters, Tell], None]
    details: Callable[[list[float]], dict[str, Any]]

    def __post_init__(self) -> None:
        whole_fields(self, steps=1, seed=0)

    def tried(self, parameters: dict[str, Any]) -> Hyperparameters:
        """The hyper-parameters of a trial."""
        from optuna.trial import FixedTrial

        return self.sample(FixedTrial(parameters))


def run_study(
    search: Search,
    out: Path,
    *,
    trials: int | None = None,
    minutes: float | None = None,
    cluster: Cluster | None = None,
    report: Report | None = None,
) -> dict[str, Any]:
    """Search; a trial that is behind after some of its parts is given up.

    Here that is by the median (Optuna's MedianPruner), on a cluster by asynchronous successive
    halving (Ray Tune's ASHAScheduler). The study is kept in ``out/study.db`` and goes on where it
    ended, here or there.

    Args:
        search: what, and by what.
        out: folder for ``study.json``, with every trial, and ``NAME.yml``, the best.
        trials: number of trials, those kept from before included; None: as many as the time allows.
        minutes: stop beginning trials after this time.
        cluster: where trials are computed, several at once; None: here, one after the other.
        report: called after every trial with its entry in ``study.json`` and the best value so far.

    Returns:
        What ``study.json`` holds.

    Raises:
        ValueError: neither trials nor minutes given, or one of them not positive; no trial came to
            its end.
    """
    if trials is None and minutes is None:
        raise ValueError("trials = None and minutes = None: expected at least one of them")
    if minutes is not None and not minutes > 0:
        raise ValueError(f"minutes = {minutes}: expected a positive number")
    trials = None if trials is None else whole_number("trials", trials, 1)

    import optuna

    out.mkdir(parents=True, exist_ok=True)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    storage = optuna.storages.RDBStorage(f"sqlite:///{out / 'study.db'}")
    study = optuna.create_study(
        study_name=f"{search.name} {search.steps} {search.seed}",
        storage=storage,
        sampler=optuna.samplers.TPESampler(
            seed=search.seed,
            multivariate=True,
            n_startup_trials=5,
            constant_liar=cluster is not None,
        ),
        pruner=optuna.pruners.MedianPruner(n_startup_trials=3, n_warmup_steps=0),
        direction="maximize",
        load_if_exists=True,
    )
    if not study.trials:
        study.enqueue_trial(search.present)
    told = {row["number"] for row in _rows(study, search)}
    left = None if trials is None else max(trials - len(told), 0)
    seconds = None if minutes is None else 60 * minutes

    def ended() -> None:
        rows = _rows(study, search)
        values = [row["value"] for row in rows if row["value"] is not None]
        for row in rows:
            if report is not None and row["number"] not in told:
                report(row, max(values, default=math.nan))
            told.add(row["number"])

    if left == 0:
        pass
    elif cluster is None:
        _search_here(study, search, left, seconds, ended)
    else:
        _search_on_cluster(study, storage, search, left, seconds, ended, cluster.jobs)
    rows = _rows(study, search)
    best = _best(rows)
    entries = search.tried(best["parameters"]).entries()
    result = {
        "algorithm": search.algorithm,
        "steps": search.steps,
        "seed": search.seed,
        "trials": rows,
        "best": {"number": best["number"], "value": best["value"], "hyperparameters": entries},
        "seconds": sum(each["seconds"] or 0.0 for each in rows),
        "machine": describe_machine(),
        "versions": package_versions("optuna", "stable-baselines3", "sb3-contrib", "octoarm-env"),
    }
    write_json(out / "study.json", result)
    text = yaml.safe_dump({search.env_id: entries}, sort_keys=False, default_flow_style=None)
    write_text(out / f"{search.name}.yml", text)
    return result


def _search_here(
    study: Any,
    search: Search,
    trials: int | None,
    seconds: float | None,
    ended: Callable[[], None],
) -> None:
    import optuna

    def objective(trial: Any) -> float:
        values: list[float] = []

        def tell(value: float) -> None:
            trial.report(value, len(values))
            values.append(value)
            if len(values) < search.parts and trial.should_prune():
                raise optuna.TrialPruned

        search.judge(search.sample(trial), tell)
        return values[-1]

    study.optimize(
        objective, n_trials=trials, timeout=seconds, callbacks=[lambda study, trial: ended()]
    )


def _search_on_cluster(
    study: Any,
    storage: Any,
    search: Search,
    trials: int | None,
    seconds: float | None,
    ended: Callable[[], None],
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

    class Suggestions(OptunaSearch):  # type: ignore[misc]
        def suggest(self, trial_id: str) -> Any:
            late = seconds is not None and time.monotonic() - begun > seconds
            return Searcher.FINISHED if late else super().suggest(trial_id)

        def on_trial_complete(self, trial_id: str, result: Any = None, error: bool = False) -> None:
            # A trial's last result is given here alone.
            if result:
                self.on_trial_result(trial_id, result)
            super().on_trial_complete(trial_id, result, error)
            ended()

        def save(self, checkpoint_path: str) -> None:
            """Nothing: the study is in its own file."""

    expected = installed()

    def trial(parameters: dict[str, Any]) -> None:
        check_installed(expected)
        search.judge(search.tried(parameters), lambda value: tune.report({"value": value}))

    suggestions = Suggestions(
        lambda each: search.sample(each) and None,
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
                search_alg=suggestions,
                scheduler=ASHAScheduler(
                    metric="value",
                    mode="max",
                    grace_period=1,
                    max_t=search.parts,
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


def _rows(study: Any, search: Search) -> list[dict[str, Any]]:
    """The trials that have ended, as they stand in ``study.json``."""
    from optuna.trial import TrialState

    rows = []
    for each in study.get_trials(states=(TrialState.COMPLETE, TrialState.PRUNED)):
        values = [value for _, value in sorted(each.intermediate_values.items())]
        complete = len(values) == search.parts
        rows.append(
            {
                "number": each.number,
                "value": values[-1] if complete else None,
                "pruned": not complete,
                "parameters": each.params,
                **search.details(values),
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
