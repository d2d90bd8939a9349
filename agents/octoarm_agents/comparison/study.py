"""The comparison: everything trained, measured, and put beside each other."""

from __future__ import annotations

import itertools
import shutil
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from octoarm_agents.common.environment import TARGETS, inspect_env
from octoarm_agents.common.files import write_json
from octoarm_agents.common.intervals import bootstrap_interval, interquartile_mean
from octoarm_agents.common.progress import progress_bar
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.trials import run_trials
from octoarm_agents.common.whole import whole_fields
from octoarm_agents.comparison.agents import (
    AGENTS,
    READOUTS,
    TEACHING_STEPS,
    TRAINED,
    TRIVIAL,
    Cell,
    make_agent,
)
from octoarm_agents.comparison.measuring import (
    BODIES,
    BURSTS,
    NOISES,
    PUSHES,
    Protocol,
    inference_time,
    measure_agent,
    phase_portrait,
)
from octoarm_agents.comparison.readout_map import ACTION_NOISES, RIDGE_NOISES, map_readout
from octoarm_agents.policies import load_policy
from octoarm_agents.policies.evaluation import acting
from octoarm_env import ArmParameters, OctoArmEnv, OctoArmVectorEnv

__all__ = ["Comparison", "compare"]

_SLOW_FIRST = ("tqc", "sac", "recurrent_ppo", "ppo", "linear_search")

_SHOWN = 200
"""Control periods of a phase portrait: about three turns."""

_REACHED = 0.97
"""Share of the readout's return that counts as reaching it."""


@dataclass(frozen=True)
class Comparison:
    """What is compared.

    Attributes:
        agents: some of `AGENTS`.
        targets: some of `TARGETS`.
        seeds: trainings of each agent on each target, with seeds 0, 1, …
        budget: factor of all trainings' environment steps.
        protocol: how much is measured.
        jobs: processes; only timings depend on it.
        readout_map: seeds of the map of readouts; 0 leaves it out.
    """

    agents: tuple[str, ...] = AGENTS
    targets: tuple[str, ...] = TARGETS
    seeds: int = 5
    budget: float = 1.0
    protocol: Protocol = field(default_factory=Protocol)
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


def compare(comparison: Comparison, out: Path, *, progress: bool | None = None) -> dict[str, Any]:
    """Train, measure and put side by side; write ``compare.json`` and ``trained/``.

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
    cells = [
        Cell(agent, target, seed, comparison.budget, out / "runs")
        for agent in sorted(
            (each for each in comparison.agents if each in TRAINED),
            key=lambda each: _SLOW_FIRST.index(each) if each in _SLOW_FIRST else len(_SLOW_FIRST),
        )
        for target in comparison.targets
        for seed in range(comparison.seeds)
    ]
    summaries = _train_all(cells, comparison.jobs, progress)
    settings = {target: _settings(target) for target in comparison.targets}
    measured = _measure_all(comparison, cells, settings, out, progress)
    rows = [
        _row(comparison, agent, target, cells, summaries, measured, settings[target])
        for target in comparison.targets
        for agent in AGENTS
        if agent in comparison.agents
    ]
    _add_reached(rows, cells, summaries)
    result = {
        "command": _command(comparison),
        "settings": {
            "agents": list(comparison.agents),
            "targets": list(comparison.targets),
            "seeds": comparison.seeds,
            "budget": comparison.budget,
            "protocol": asdict(comparison.protocol),
            "pushes": list(PUSHES),
            "bursts": list(BURSTS),
            "noises": list(NOISES),
            "bodies": [list(each) for each in BODIES],
            "reached": _REACHED,
            "teaching_steps": TEACHING_STEPS,
        },
        "environment": settings,
        "rows": rows,
        "readout_map": _map_readouts(comparison, out, progress),
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
    _ship(comparison, cells, summaries, measured, out / "trained")
    return result


def _command(comparison: Comparison) -> str:
    words = ["octoarm compare"]
    if comparison.agents != AGENTS:
        words += [f"--agents {','.join(comparison.agents)}"]
    if comparison.targets != TARGETS:
        words += [f"--targets {','.join(comparison.targets)}"]
    words += [f"--seeds {comparison.seeds}"]
    if comparison.budget != 1:
        words += [f"--budget {comparison.budget:g}"]
    if comparison.protocol != Protocol():
        words += [f"--episodes {comparison.protocol.episodes}"]
    return " ".join(words)


def _settings(target: str) -> dict[str, Any]:
    return inspect_env(OctoArmEnv(target))[1]


def _train_all(
    cells: Sequence[Cell], jobs: int, progress: bool | None
) -> dict[Cell, dict[str, Any]]:
    from joblib import Parallel, delayed

    summaries: dict[Cell, dict[str, Any]] = {}
    with progress_bar(len(cells), "trainings", shown=progress) as bar:
        run = Parallel(n_jobs=min(jobs, max(len(cells), 1)), return_as="generator_unordered")
        for cell, summary in run(delayed(_make)(cell) for cell in cells):
            summaries[cell] = summary
            bar.set_postfix_str(f"{cell.name}: {summary['best']['return']:.1f}")
            bar.update()
    return summaries


def _make(cell: Cell) -> tuple[Cell, dict[str, Any]]:
    return cell, make_agent(cell)


def _measure_all(
    comparison: Comparison,
    cells: Sequence[Cell],
    settings: Mapping[str, dict[str, Any]],
    out: Path,
    progress: bool | None,
) -> dict[Any, dict[str, Any]]:
    """Measurements by cell, and by (agent, target) for the trivial agents."""
    keys: list[Any] = list(cells)
    keys += itertools.product(
        (each for each in comparison.agents if each in TRIVIAL), comparison.targets
    )
    protocol = asdict(comparison.protocol)
    trials = [
        {
            "agent": key.agent,
            "settings": settings[key.target],
            "policy": str(key.policy),
            "digest": key.digest,
            "protocol": protocol,
        }
        if isinstance(key, Cell)
        else {
            "agent": key[0],
            "settings": settings[key[1]],
            "policy": None,
            "digest": None,
            "protocol": protocol,
        }
        for key in keys
    ]
    results = run_trials(
        measure_agent,
        ArmParameters(),
        trials,
        folder=out / ".measured",
        jobs=comparison.jobs,
        progress=progress,
        description="measurements",
    )
    return dict(zip(keys, results, strict=True))


def _row(
    comparison: Comparison,
    agent: str,
    target: str,
    cells: Sequence[Cell],
    summaries: Mapping[Cell, dict[str, Any]],
    measured: Mapping[Any, dict[str, Any]],
    settings: dict[str, Any],
) -> dict[str, Any]:
    """One agent on one target."""
    own = [cell for cell in cells if (cell.agent, cell.target) == (agent, target)]
    own.sort(key=lambda cell: cell.seed)
    results = [measured[cell] for cell in own] or [measured[agent, target]]
    trained = [summaries[cell] for cell in own]
    row: dict[str, Any] = {"agent": agent, "target": target, "training_seeds": len(own)}
    for name in ("return", "tracking_error", "orbit_distance", "period", "held", "survival"):
        row[name] = summary([result[name] for result in results])
    for name, keys in (
        ("pushes", ("recovered", "time", "return_after")),
        ("bursts", ("recovered", "time", "return_after")),
        ("noises", ("return", "orbit_distance")),
    ):
        row[name] = [
            {"size": first["size"]}
            | {key: summary([result[name][index][key] for result in results]) for key in keys}
            for index, first in enumerate(results[0][name])
        ]
    row["bodies"] = [
        {"stiffness": stiffness, "damping": damping}
        | {
            key: summary([result["bodies"][index][key] for result in results])
            for key in ("return", "orbit_distance", "period")
        }
        for index, (stiffness, damping) in enumerate(BODIES)
    ]
    row["transfer"] = {
        key: summary([_mean([body[key] for body in result["bodies"]]) for result in results])
        for key in ("return", "orbit_distance")
    }
    row["samples"] = trained[0]["final"]["steps"] if trained else 0
    row["training_seconds"] = summary([each["seconds"] for each in trained]) if trained else None
    row["parameters"] = trained[0]["parameters"] if trained else 0
    row["inference_us"] = _inference(agent, target, own)
    row["curves"] = [each["curve"] for each in trained] if agent not in READOUTS else []
    middle = sorted(own, key=lambda cell: measured[cell]["return"])[len(own) // 2 :][:1]
    row["portrait"] = _portrait(comparison, agent, target, middle, settings)
    return row


def summary(values: Sequence[float | None]) -> dict[str, Any]:
    """``iqm``, ``low``, ``high`` (95 % bootstrap) and the ``values`` themselves.

    A value that does not exist (None: no arm lasted, too few recovered) counts as worse than any
    number; the interquartile mean and its interval are then None where they would be infinite.
    """
    sample = np.array([np.inf if value is None else value for value in values])
    with np.errstate(invalid="ignore"):
        low, high = bootstrap_interval(sample.tolist(), interquartile_mean)
        middle = float(interquartile_mean(sample))
    return {
        "iqm": _finite(middle),
        "low": _finite(low),
        "high": _finite(high),
        "values": [_finite(value) for value in sample.tolist()],
    }


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return statistics.fmean(known) if len(known) == len(values) else None


def _inference(agent: str, target: str, own: Sequence[Cell]) -> float:
    """Microseconds of an action, alone on the machine."""
    env = OctoArmEnv(target)
    springs = env.observation_space.shape[0]  # type: ignore[index]
    if own:
        return inference_time(load_policy(own[0].policy), springs)
    envs = OctoArmVectorEnv(1, target)
    envs.reset(seed=0)
    return inference_time(acting(agent, envs), springs)  # type: ignore[arg-type]


def _portrait(
    comparison: Comparison,
    agent: str,
    target: str,
    own: Sequence[Cell],
    settings: dict[str, Any],
) -> list[list[float]]:
    """Base angles at the end of the first evaluated episode, by the training of middle return."""
    policy: Any = load_policy(own[0].policy) if own else agent
    angles = phase_portrait(
        policy,
        ArmParameters(),
        settings,
        seed=comparison.protocol.seed,
        steps=comparison.protocol.steps,
    )
    return [[round(value, 2) for value in row] for row in angles[-_SHOWN:].tolist()]


def _add_reached(
    rows: list[dict[str, Any]], cells: Sequence[Cell], summaries: Mapping[Cell, dict[str, Any]]
) -> None:
    """Environment steps after which trainings first earn 97 % of what the readout earns."""
    for row in rows:
        readouts = [
            each["return"]["iqm"]
            for each in rows
            if each["target"] == row["target"] and each["agent"] in READOUTS
        ]
        row["share_of_readout"] = None
        row["samples_to_reach"] = None
        if not readouts:
            continue
        best = max(readouts)
        row["share_of_readout"] = row["return"]["iqm"] / best
        own = [
            summaries[cell]
            for cell in cells
            if (cell.agent, cell.target) == (row["agent"], row["target"])
        ]
        if own:
            firsts: list[float | None] = [
                next(
                    (
                        float(point["steps"])
                        for point in each["curve"]
                        if point["return"] >= _REACHED * best
                    ),
                    None,
                )
                for each in own
            ]
            row["samples_to_reach"] = summary(firsts)


def _map_readouts(comparison: Comparison, out: Path, progress: bool | None) -> list[dict[str, Any]]:
    if not comparison.readout_map or not set(comparison.agents) & set(READOUTS):
        return []
    points = list(itertools.product(comparison.targets, ACTION_NOISES, RIDGE_NOISES))
    trials = [
        {
            "target": target,
            "action_noise": action_noise,
            "noise": noise,
            "steps": TEACHING_STEPS,
            "seed": seed,
            "episodes": comparison.protocol.episodes,
            "noises": list(NOISES),
            "push": PUSHES[1],
        }
        for target, action_noise, noise in points
        for seed in range(comparison.readout_map)
    ]
    results = run_trials(
        map_readout,
        ArmParameters(),
        trials,
        folder=out / ".measured",
        jobs=comparison.jobs,
        progress=progress,
        description="map of readouts",
    )
    count = comparison.readout_map
    return [
        {
            "target": target,
            "action_noise": action_noise,
            "noise": noise,
            **{
                key: summary([each[key] for each in results[count * k : count * (k + 1)]])
                for key in ("return", "held", "recovered")
            },
            "noises": [
                {"size": size}
                | summary([each["noises"][i] for each in results[count * k : count * (k + 1)]])
                for i, size in enumerate(NOISES)
            ],
        }
        for k, (target, action_noise, noise) in enumerate(points)
    ]


def _ship(
    comparison: Comparison,
    cells: Sequence[Cell],
    summaries: Mapping[Cell, dict[str, Any]],
    measured: Mapping[Any, dict[str, Any]],
    folder: Path,
) -> None:
    """Of every agent and target the training that the judging seeds favour, with its score."""
    entries = []
    for target, agent in itertools.product(comparison.targets, TRAINED):
        own = [cell for cell in cells if (cell.agent, cell.target) == (agent, target)]
        if not own:
            continue
        best = max(own, key=lambda cell: summaries[cell]["best"]["return"])
        file = folder / target / f"{agent}.npz"
        file.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(best.policy, file)
        entries.append(
            {
                "agent": agent,
                "target": target,
                "file": f"{target}/{file.name}",
                "seed": best.seed,
                "command": best.command,
                "samples": summaries[best]["best"]["steps"],
                "return": measured[best]["return"],
                "tracking_error": measured[best]["tracking_error"],
            }
        )
    protocol = comparison.protocol
    folder.mkdir(parents=True, exist_ok=True)
    write_json(
        folder / "trained.json",
        {
            "evaluation": {
                "episodes": protocol.episodes,
                "seed": protocol.seed,
                "steps": protocol.steps,
            },
            "agents": entries,
            "versions": package_versions("octoarm-env", "octoarm-agents"),
        },
    )
