"""The rows of the comparison: every agent on every target, over its trainings."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from octoarm_agents.common.intervals import bootstrap_interval, interquartile_mean
from octoarm_agents.comparison.agents import READOUTS, TrainingRun

REACHED = 0.97
"""Share of the readout's return that counts as reaching it."""

_GIVEN = ("size", "stiffness", "damping")
"""What was set, and not measured."""

_OWN = ("inference_us", "portrait")
"""What is not summed up."""


@dataclass(frozen=True)
class Outcome:
    """An agent on a target.

    Attributes:
        runs: its trainings, by seed; one of an agent that is not trained.
        trainings: what `make_agent` gave for each.
        measures: what `measure_agent` gave for each.
    """

    runs: Sequence[TrainingRun]
    trainings: Sequence[dict[str, Any] | None]
    measures: Sequence[dict[str, Any]]


def make_rows(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Sum up trainings and measures, and compare them with what the readouts earn."""
    rows = [_row(outcome) for outcome in outcomes]
    for row, outcome in zip(rows, outcomes, strict=True):
        readouts = [
            each["return"]["iqm"]
            for each in rows
            if each["target"] == row["target"] and each["agent"] in READOUTS
        ]
        best = max(readouts, default=None)
        row["share_of_readout"] = None if best is None else row["return"]["iqm"] / best
        trainings = [each for each in outcome.trainings if each is not None]
        row["samples_to_reach"] = (
            None
            if best is None or not trainings
            else summary([_reached(each["curve"], REACHED * best) for each in trainings])
        )
    return rows


def _row(outcome: Outcome) -> dict[str, Any]:
    run, measures = outcome.runs[0], outcome.measures
    trainings = [each for each in outcome.trainings if each is not None]
    by_return = sorted(measures, key=lambda each: float(each["return"]))
    return {
        "agent": run.agent,
        "target": run.target,
        "training_seeds": len(trainings),
        **combined([{k: each[k] for k in each if k not in _OWN} for each in measures]),
        "transfer": {
            key: summary([_mean([body[key] for body in each["bodies"]]) for each in measures])
            for key in ("return", "orbit_distance")
        },
        "samples": trainings[0]["final"]["steps"] if trainings else 0,
        "training_seconds": summary([each["seconds"] for each in trainings]) if trainings else None,
        "parameters": trainings[0]["parameters"] if trainings else 0,
        "inference_us": statistics.median(each["inference_us"] for each in measures),
        "curves": [each["curve"] for each in trainings] if run.agent not in READOUTS else [],
        # Of the training of middle return.
        "portrait": by_return[len(measures) // 2]["portrait"],
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
