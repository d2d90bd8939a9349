"""The comparison: everything trained, measured, and put beside each other."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from octoarm_agents.common.environment import TARGETS, inspect_env
from octoarm_agents.common.files import write_json, write_text
from octoarm_agents.common.progress import progress_bar
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.whole import whole_fields
from octoarm_agents.comparison.agents import (
    AGENTS,
    SLOW_FIRST,
    TEACHING_STEPS,
    TrainingRun,
    make_agent,
)
from octoarm_agents.comparison.measuring import (
    BODIES,
    BURSTS,
    NOISES,
    PUSHES,
    SHAKES,
    TestPlan,
    measure_agent,
)
from octoarm_agents.comparison.rows import REACHED, Outcome, make_rows
from octoarm_agents.comparison.shipping import ship
from octoarm_agents.policies.evaluation import TRIVIAL
from octoarm_env import OctoArmEnv, OctoArmVectorEnv

_PACKAGES = (
    *("octoarm-env", "octoarm-agents", "numpy", "scipy", "scikit-learn", "gymnasium"),
    *("stable-baselines3", "sb3-contrib", "torch", "cma"),
)


@dataclass(frozen=True)
class Comparison:
    """What is compared.

    Attributes:
        agents: some of `AGENTS`.
        targets: some of `TARGETS`.
        seeds: trainings of each agent on each target, with seeds 0, 1, …
        budget: factor of all trainings' environment steps.
        plan: how much is measured.
        jobs: processes; only timings depend on it.
        env: further arguments of the environment, as they read in JSON.
    """

    agents: tuple[str, ...] = AGENTS
    targets: tuple[str, ...] = TARGETS
    seeds: int = 5
    budget: float = 1.0
    plan: TestPlan = field(default_factory=TestPlan)
    jobs: int = 1
    env: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, given, known in (
            ("agents", self.agents, AGENTS),
            ("targets", self.targets, TARGETS),
        ):
            unknown = [each for each in given if each not in known]
            if unknown or not given:
                raise ValueError(f"{name} = {given}: expected some of {known}")
        whole_fields(self, seeds=1, jobs=1)

    @property
    def command(self) -> str:
        """What makes it, but for the processes."""
        given, usual = (
            {
                "agents": ",".join(each.agents),
                "targets": ",".join(each.targets),
                "seeds": each.seeds,
                "budget": f"{each.budget:g}",
                "episodes": each.plan.episodes,
                "seed": each.plan.seed,
            }
            for each in (self, Comparison())
        )
        words = [
            f"--{name} {value}"
            for name, value in (given | self.env).items()
            if name == "seeds" or value != usual.get(name)
        ]
        return " ".join(["octoarm compare", *words])


def compare(comparison: Comparison, out: Path, *, progress: bool | None = None) -> dict[str, Any]:
    """Train, measure and put side by side; write the results and ``trained/``.

    Every training and what was measured of it is kept in ``out/results``, a file each, as soon as
    it is finished, and what is there is not computed again: the same call goes on where it was
    interrupted, and one with more agents, targets or seeds lets the table grow. The trainings
    themselves are in ``out/runs``.

    Args:
        comparison: what to compare.
        out: folder.
        progress: as `shown` of `octoarm_agents.common.progress.progress_bar`.

    Returns:
        What ``compare.json`` holds.

    Raises:
        ValueError: the folder holds another comparison's trainings.
    """
    settings = {
        target: inspect_env(OctoArmEnv(target, **comparison.env))[1]
        for target in comparison.targets
    }
    groups = [
        [
            TrainingRun(agent, target, seed, comparison.budget, out / "runs", comparison.env)
            for seed in range(1 if agent in TRIVIAL else comparison.seeds)
        ]
        for target in comparison.targets
        for agent in AGENTS
        if agent in comparison.agents
    ]
    results = _results([run for runs in groups for run in runs], comparison, progress)
    outcomes = [
        Outcome(
            runs,
            [results[run]["training"] for run in runs],
            [results[run]["measures"] for run in runs],
        )
        for runs in groups
    ]
    result = {
        "command": comparison.command,
        "settings": asdict(comparison)
        | {
            "pushes": PUSHES,
            "shakes": SHAKES,
            "bursts": BURSTS,
            "noises": NOISES,
            "bodies": BODIES,
            "reached": REACHED,
            "teaching_steps": TEACHING_STEPS,
        },
        "environment": settings,
        "deviations": {target: _deviation(target, comparison.env) for target in comparison.targets},
        "rows": make_rows(outcomes),
        "machine": describe_machine(),
        "versions": package_versions(*_PACKAGES),
    }
    write_json(out / "compare.json", result)
    write_json(out / "summary.json", undisturbed(result))
    ship(outcomes, comparison.plan, out / "trained")
    return result


def undisturbed(result: dict[str, Any]) -> dict[str, Any]:
    """Give what ``summary.json`` holds: the undisturbed figures, without single trainings."""
    lists = ("transfer", "bodies", "pushes", "shakes", "bursts", "noises", "curves", "portrait")
    rows = [
        {
            name: {key: each for key, each in entry.items() if key != "values"}
            if isinstance(entry, dict)
            else entry
            for name, entry in row.items()
            if name not in (*lists, "training_seeds")
        }
        for row in result["rows"]
    ]
    kept = {name: result[name] for name in ("command", "settings", "machine", "versions")}
    return kept | {"rows": rows}


def _results(
    runs: list[TrainingRun], comparison: Comparison, progress: bool | None
) -> dict[TrainingRun, dict[str, Any]]:
    """Train and measure, the slow ones first."""
    from joblib import Parallel, delayed

    runs = sorted(runs, key=lambda run: SLOW_FIRST.index(run.agent))
    results: dict[TrainingRun, dict[str, Any]] = {}
    with progress_bar(len(runs), "agents", shown=progress) as bar:
        work = Parallel(n_jobs=comparison.jobs, return_as="generator_unordered")
        for run, result in work(delayed(_result)(run, comparison.plan) for run in runs):
            results[run] = result
            bar.set_postfix_str(f"{run.name}: {result['measures']['return']:.1f}")
            bar.update()
    return results


def _result(run: TrainingRun, plan: TestPlan) -> tuple[TrainingRun, dict[str, Any]]:
    """What `make_agent` and `measure_agent` give, or what an earlier call has kept of it."""
    from threadpoolctl import threadpool_limits

    file = run.folder.parent / "results" / f"{run.name}.json"
    wanted = {"budget": run.budget, "environment": run.arguments, "plan": asdict(plan)}
    if file.exists():
        try:
            kept: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        except ValueError as error:
            raise ValueError(f"{file} is damaged: {error}") from None
        if {name: kept.get(name) for name in wanted} != wanted:
            raise ValueError(f"{file} is of another comparison: choose another folder")
        return run, kept
    # Sums split over threads are rounded otherwise.
    with threadpool_limits(1):
        training = make_agent(run)
        policy = None if training is None else run.policy
        measures = measure_agent(run.agent, policy, run.arguments, plan)
    machine = {"machine": describe_machine(), "versions": package_versions(*_PACKAGES)}
    result = {**wanted, "training": training, "measures": measures, **machine}
    file.parent.mkdir(parents=True, exist_ok=True)
    write_text(file, json.dumps(result, allow_nan=False) + "\n")  # in a line: they are many
    return run, result


def _deviation(target: str, env: dict[str, Any]) -> float:
    """Median over the springs of their standard deviation on the clock's orbit [m]."""
    with closing(OctoArmVectorEnv(1, target, **env, threads=1)) as envs:
        lengths, _ = envs.reset(seed=0)
        rows = []
        for _ in range(500):
            rows.append(lengths[0])
            lengths, *_ = envs.step(envs.teacher_actions().astype(np.float32))
    return float(np.median(np.std(rows, axis=0)))
