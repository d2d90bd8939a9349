"""The comparison: everything trained, measured, and put beside each other."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from octoarm_agents.common.environment import TARGETS, inspect_env
from octoarm_agents.common.files import read_folder, write_folder, write_json, write_text
from octoarm_agents.common.progress import progress_bar
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.whole import whole_fields
from octoarm_agents.common.workers import Cluster, Jobs, map_unordered, number_of
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
from octoarm_env import ArmParameters, OctoArmEnv, OctoArmVectorEnv

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
        jobs: processes, or a cluster; only timings depend on it.
        kept: compare what is kept from earlier calls alone, and train nothing: every agent that
            has a training on each target, however many.
        env: further arguments of the environment, as they read in JSON.
    """

    agents: tuple[str, ...] = AGENTS
    targets: tuple[str, ...] = TARGETS
    seeds: int = 5
    budget: float = 1.0
    plan: TestPlan = field(default_factory=TestPlan)
    jobs: Jobs = 1
    kept: bool = False
    env: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, given, known in (
            ("agents", self.agents, AGENTS),
            ("targets", self.targets, TARGETS),
        ):
            unknown = [each for each in given if each not in known]
            if unknown or not given:
                raise ValueError(f"{name} = {given}: expected some of {known}")
        whole_fields(self, seeds=1)
        number_of(self.jobs)

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
        words += ["--kept"] * self.kept
        return " ".join(["octoarm compare", *words])


def compare(comparison: Comparison, out: Path, *, progress: bool | None = None) -> dict[str, Any]:
    """Train, measure and put side by side; write the results and ``trained/``.

    Every training and what was measured of it is kept in ``out/results``, a file each, as soon as
    it is finished, and what is there is not computed again: the same call goes on where it was
    interrupted, and one with more agents, targets or seeds lets the table grow. The trainings
    themselves are in ``out/runs``; from a cluster they arrive there when they are finished.

    Args:
        comparison: what to compare.
        out: folder.
        progress: as `shown` of `octoarm_agents.common.progress.progress_bar`.

    Returns:
        What ``compare.json`` holds.

    Raises:
        ValueError: the folder holds another comparison's trainings, or, where only these are
            wanted, none.
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
    if comparison.kept:
        lacking = {runs[0].agent for runs in groups if not any(_file(run).exists() for run in runs)}
        groups = [
            [run for run in runs if _file(run).exists()]
            for runs in groups
            if runs[0].agent not in lacking
        ]
        if not groups:
            raise ValueError(f"kept = True: {out / 'results'} holds nothing of this comparison")
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
            "jobs": number_of(comparison.jobs),
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
            if name not in lists
        }
        for row in result["rows"]
    ]
    kept = {name: result[name] for name in ("command", "settings", "machine", "versions")}
    return kept | {"rows": rows}


def _results(
    runs: list[TrainingRun], comparison: Comparison, progress: bool | None
) -> dict[TrainingRun, dict[str, Any]]:
    """Train and measure what no earlier call has kept, the slow ones first."""
    plan = comparison.plan
    runs = sorted(runs, key=lambda run: SLOW_FIRST.index(run.agent))
    kept = {run: _read(run, plan) for run in runs}
    results = {run: result for run, result in kept.items() if result is not None}
    missing = [run for run in runs if run not in results]
    on_cluster = isinstance(comparison.jobs, Cluster)
    calls = [_sent(run, plan) if on_cluster else (run, plan) for run in missing]
    with progress_bar(len(runs), "agents", initial=len(results), shown=progress) as bar:
        for index, (made, files) in map_unordered(_make, calls, comparison.jobs):
            run = missing[index]
            if on_cluster:
                write_folder(run.policy.parent, files)
                _keep(run, plan, made)
            results[run] = made
            bar.set_postfix_str(f"{run.name}: {made['measures']['return']:.1f}")
            bar.update()
    return results


def _make(
    run: TrainingRun, plan: TestPlan, begun: Mapping[str, bytes] | None = None
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """What `make_agent` and `measure_agent` give, and with what; kept at once.

    On a node of a cluster, whose disk is another, `begun` is what an interrupted training has left
    in its folder; then nothing is kept, and all files of the training are given too.
    """
    from threadpoolctl import threadpool_limits

    with ExitStack() as stack:
        # Sums split over threads are rounded otherwise.
        stack.enter_context(threadpool_limits(1))
        if begun is not None:
            run = replace(run, folder=Path(stack.enter_context(TemporaryDirectory())))
            write_folder(run.policy.parent, begun)
        training = make_agent(run)
        policy = None if training is None else run.policy
        made = {
            "training": training,
            "measures": measure_agent(run.agent, policy, run.arguments, plan),
            "machine": describe_machine(),
            "versions": package_versions(*_PACKAGES),
        }
        if begun is not None:
            return made, read_folder(run.policy.parent)
        _keep(run, plan, made)
    return made, {}


def _sent(run: TrainingRun, plan: TestPlan) -> tuple[TrainingRun, TestPlan, dict[str, bytes]]:
    """The arguments of `_make` on a node: the files that it cannot read, read."""
    begun = read_folder(run.policy.parent)
    if Path(run.env.get("arm", "")).is_file():
        run = replace(run, env=run.env | {"arm": ArmParameters.of(run.env["arm"])})
    return run, plan, begun


def _file(run: TrainingRun) -> Path:
    return run.folder.parent / "results" / f"{run.name}.json"


def _wanted(run: TrainingRun, plan: TestPlan) -> dict[str, Any]:
    """What a result depends on, beside the run's name."""
    return {"budget": run.budget, "environment": run.arguments, "plan": asdict(plan)}


def _keep(run: TrainingRun, plan: TestPlan, made: dict[str, Any]) -> None:
    file = _file(run)
    file.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(_wanted(run, plan) | made, allow_nan=False)
    write_text(file, text + "\n")  # in a line: they are many


def _read(run: TrainingRun, plan: TestPlan) -> dict[str, Any] | None:
    """What an earlier call has kept; None if nothing.

    Raises:
        ValueError: the file is damaged, or of another comparison.
    """
    file, wanted = _file(run), _wanted(run, plan)
    if not file.exists():
        return None
    try:
        kept: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{file} is damaged: {error}") from None
    if {name: kept.get(name) for name in wanted} != wanted:
        raise ValueError(f"{file} is of another comparison: choose another folder")
    return kept


def _deviation(target: str, env: dict[str, Any]) -> float:
    """Median over the springs of their standard deviation on the clock's orbit [m]."""
    with closing(OctoArmVectorEnv(1, target, **env, threads=1)) as envs:
        lengths, _ = envs.reset(seed=0)
        rows = []
        for _ in range(500):
            rows.append(lengths[0])
            lengths, *_ = envs.step(envs.teacher_actions().astype(np.float32))
    return float(np.median(np.std(rows, axis=0)))
