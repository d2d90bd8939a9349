"""The rows of the comparison: every agent on every target, over its trainings."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from octoarm_agents.common.intervals import bootstrap_interval, interquartile_mean
from octoarm_agents.comparison.agents import READOUTS, TrainingRun
from octoarm_agents.comparison.measuring import AgentTest, TestPlan, inference_time
from octoarm_agents.policies import load_policy
from octoarm_agents.policies.evaluation import acting
from octoarm_env import ArmParameters, OctoArmVectorEnv

REACHED = 0.97
"""Share of the readout's return that counts as reaching it."""

_SHOWN = 200
"""Control periods of a phase portrait: about three turns."""

_GIVEN = ("size", "stiffness", "damping")
"""What was set, and not measured."""


@dataclass(frozen=True)
class Outcome:
    """An agent on a target.

    Attributes:
        agent: its name.
        target: of the environment.
        settings: of the environment.
        runs: its trainings, by seed; none of an agent that is not trained.
        trainings: their summaries.
        measures: what `measure_agent` gave for each, or for the agent that is not trained.
    """

    agent: str
    target: str
    settings: dict[str, Any]
    runs: Sequence[TrainingRun]
    trainings: Sequence[dict[str, Any]]
    measures: Sequence[dict[str, Any]]


def make_rows(outcomes: Sequence[Outcome], plan: TestPlan) -> list[dict[str, Any]]:
    """Sum up trainings and measures, and compare them with what the readouts earn."""
    rows = [_row(outcome, plan) for outcome in outcomes]
    for row, outcome in zip(rows, outcomes, strict=True):
        readouts = [
            each["return"]["iqm"]
            for each in rows
            if each["target"] == row["target"] and each["agent"] in READOUTS
        ]
        best = max(readouts, default=None)
        row["share_of_readout"] = None if best is None else row["return"]["iqm"] / best
        row["samples_to_reach"] = (
            None
            if best is None or not outcome.trainings
            else summary([_reached(each["curve"], REACHED * best) for each in outcome.trainings])
        )
    return rows


def _row(outcome: Outcome, plan: TestPlan) -> dict[str, Any]:
    runs, trainings, measures = outcome.runs, outcome.trainings, outcome.measures
    by_return = sorted(range(len(measures)), key=lambda index: measures[index]["return"])
    middle = by_return[len(measures) // 2]
    envs = OctoArmVectorEnv(1, outcome.target)
    envs.reset(seed=0)
    first, shown = (
        load_policy(runs[index].policy) if runs else outcome.agent for index in (0, middle)
    )
    alone = replace(plan, episodes=1)
    test = AgentTest(shown, ArmParameters(), outcome.settings, alone)  # type: ignore[arg-type]
    angles = test.run(plan.steps).angles[-_SHOWN:, 0]
    return {
        "agent": outcome.agent,
        "target": outcome.target,
        "training_seeds": len(runs),
        **combined(measures),
        "transfer": {
            key: summary([_mean([body[key] for body in each["bodies"]]) for each in measures])
            for key in ("return", "orbit_distance")
        },
        "samples": trainings[0]["final"]["steps"] if trainings else 0,
        "training_seconds": summary([each["seconds"] for each in trainings]) if trainings else None,
        "parameters": trainings[0]["parameters"] if trainings else 0,
        # Alone on the machine.
        "inference_us": inference_time(acting(first, envs), envs.single_observation_space.shape[0]),  # type: ignore[arg-type, index]
        "curves": [each["curve"] for each in trainings] if outcome.agent not in READOUTS else [],
        # The base's angles at the end of the first episode of the training of middle return.
        "portrait": [[round(value, 2) for value in pair] for pair in angles.tolist()],
    }


def combined(results: Sequence[Any]) -> Any:
    """Give `summary` wherever the results, all of one form, have a number that was measured."""
    if isinstance(results[0], dict):
        return {
            key: value if key in _GIVEN else combined([each[key] for each in results])
            for key, value in results[0].items()
        }
    if isinstance(results[0], list):
        return [combined(each) for each in zip(*results, strict=True)]
    return summary(results)


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


def _reached(curve: Sequence[dict[str, float]], least: float) -> float | None:
    """Environment steps after which a training first earns so much."""
    return next((float(point["steps"]) for point in curve if point["return"] >= least), None)
