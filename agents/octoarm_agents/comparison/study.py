"""The comparison: everything trained, measured, and put beside each other."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from octoarm_agents.common.environment import TARGETS, inspect_env
from octoarm_agents.common.files import write_json
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.trials import run_trials
from octoarm_agents.common.whole import whole_fields
from octoarm_agents.comparison.agents import (
    AGENTS,
    READOUTS,
    TEACHING_STEPS,
    TRAINED,
    TrainingRun,
    train_all,
)
from octoarm_agents.comparison.measuring import (
    BODIES,
    BURSTS,
    NOISES,
    PUSHES,
    TestPlan,
    measure_agent,
)
from octoarm_agents.comparison.readout_map import map_readout, map_settings
from octoarm_agents.comparison.rows import REACHED, Outcome, combined, make_rows
from octoarm_agents.comparison.shipping import ship
from octoarm_env import ArmParameters, OctoArmEnv

Measure = Callable[..., list[dict[str, Any]]]
"""`run_trials` with all that trials of one comparison have in common."""


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
        readout_map: seeds of the map of readouts; 0 leaves it out.
    """

    agents: tuple[str, ...] = AGENTS
    targets: tuple[str, ...] = TARGETS
    seeds: int = 5
    budget: float = 1.0
    plan: TestPlan = field(default_factory=TestPlan)
    jobs: int = 1
    readout_map: int = 3

    def __post_init__(self) -> None:
        for name, given, known in (
            ("agents", self.agents, AGENTS),
            ("targets", self.targets, TARGETS),
        ):
            unknown = [each for each in given if each not in known]
            if unknown or not given:
                raise ValueError(f"{name} = {given}: expected some of {known}")
        whole_fields(self, seeds=1, jobs=1, readout_map=0)

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
            for name, value in given.items()
            if name == "seeds" or value != usual[name]
        ]
        return " ".join(["octoarm compare", *words])


def compare(comparison: Comparison, out: Path, *, progress: bool | None = None) -> dict[str, Any]:
    """Train, measure and put side by side; write the results and ``trained/``.

    Trainings are kept in ``out/runs`` and measurements in ``out/.measured``: the same call goes on
    where it was interrupted.

    Args:
        comparison: what to compare.
        out: folder.
        progress: as `shown` of `octoarm_agents.common.progress.progress_bar`.

    Returns:
        What ``compare.json`` holds.

    Raises:
        ValueError: the folder holds another comparison's trainings.
    """
    out.mkdir(parents=True, exist_ok=True)
    settings = {target: inspect_env(OctoArmEnv(target))[1] for target in comparison.targets}
    runs = {
        (agent, target): [
            TrainingRun(agent, target, seed, comparison.budget, out / "runs")
            for seed in range(comparison.seeds if agent in TRAINED else 0)
        ]
        for target in comparison.targets
        for agent in AGENTS
        if agent in comparison.agents
    }
    trainings = train_all([run for own in runs.values() for run in own], comparison.jobs, progress)
    measure = functools.partial(
        run_trials,
        parameters=ArmParameters(),
        folder=out / ".measured",
        jobs=comparison.jobs,
        progress=progress,
    )
    outcomes = _make_outcomes(comparison, settings, runs, trainings, measure)
    result = {
        "command": comparison.command,
        "settings": asdict(comparison)
        | {
            "pushes": PUSHES,
            "bursts": BURSTS,
            "noises": NOISES,
            "bodies": BODIES,
            "reached": REACHED,
            "teaching_steps": TEACHING_STEPS,
        },
        "environment": settings,
        "rows": make_rows(outcomes, comparison.plan),
        "readout_map": _map_readouts(comparison, measure),
        "machine": describe_machine(),
        "versions": package_versions(
            "octoarm-env",
            "octoarm-agents",
            "numpy",
            "scipy",
            "gymnasium",
            "stable-baselines3",
            "sb3-contrib",
            "torch",
            "cma",
        ),
    }
    write_json(out / "compare.json", result)
    write_json(out / "summary.json", undisturbed(result))
    ship(outcomes, comparison.plan, out / "trained")
    return result


def undisturbed(result: dict[str, Any]) -> dict[str, Any]:
    """Give what ``summary.json`` holds: the undisturbed figures, without single trainings."""
    lists = ("transfer", "bodies", "pushes", "bursts", "noises", "curves", "portrait")
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


def _make_outcomes(
    comparison: Comparison,
    settings: dict[str, dict[str, Any]],
    runs: dict[tuple[str, str], list[TrainingRun]],
    trainings: dict[TrainingRun, dict[str, Any]],
    measure: Measure,
) -> list[Outcome]:
    """Measure what was trained, and the agents that are not trained."""
    trials = [
        {
            "agent": agent,
            "settings": settings[target],
            "policy": None if run is None else str(run.policy),
            "digest": None if run is None else run.digest,
            "plan": asdict(comparison.plan),
        }
        for (agent, target), own in runs.items()
        for run in own or (None,)
    ]
    measures = iter(measure(measure_agent, settings=trials, description="measurements"))
    return [
        Outcome(
            agent,
            target,
            settings[target],
            own,
            [trainings[run] for run in own],
            [next(measures) for _ in own or (None,)],
        )
        for (agent, target), own in runs.items()
    ]


def _map_readouts(comparison: Comparison, measure: Measure) -> list[dict[str, Any]]:
    count = comparison.readout_map
    if not count or not set(comparison.agents) & set(READOUTS):
        return []
    points = map_settings(comparison.targets)
    trials = [
        {**point, "seed": seed, "plan": asdict(comparison.plan)}
        for point in points
        for seed in range(count)
    ]
    results = measure(map_readout, settings=trials, description="map of readouts")
    return [
        {**point, **combined(results[count * index : count * (index + 1)])}
        for index, point in enumerate(points)
    ]
