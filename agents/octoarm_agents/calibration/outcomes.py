"""What the paper's own training makes of a body: which limit cycles it holds (section 3.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from threadpoolctl import threadpool_limits

from octoarm_agents.reservoir.closed_loop import (
    FORCED_STEPS,
    WINDOW_STEPS,
    ClosedLoop,
    score_window,
)
from octoarm_agents.reservoir.cycles import CYCLES
from octoarm_agents.reservoir.teaching import ReadoutTrainer
from octoarm_env import LIMIT_CYCLES, ArmParameters, DomainError

CLOSED_STEPS = 30_000
"""Steps of each closed loop: 23 to 48 turns. (The paper's run for 1,000,000.)"""

PAPER_OUTCOMES = {"quadratic": "held", "van_der_pol": "irregular", "lissajous": "held"}
"""What section 3.2 reports of the paper's own R and ν."""


def plain_outcomes(parameters: ArmParameters, seeds: int) -> dict[str, list[str]]:
    """Teach a body every cycle as the paper does, and let it go.

    Args:
        parameters: the body.
        seeds: of the noise on the lengths; each is a training of its own.

    Returns:
        By cycle an outcome a seed: ``"held"``; ``"irregular"``, it goes on but does not hold the
        cycle; ``"lost"``, it came to rest or left its domain, which may be under the teacher.
    """
    with threadpool_limits(limits=1):  # sums split over threads are rounded otherwise
        return {target: _outcomes(parameters, target, seeds) for target in CYCLES}


def _outcomes(parameters: ArmParameters, target: str, seeds: int) -> list[str]:
    teaching = CYCLES[target]["plain"]
    try:
        trainer = ReadoutTrainer(parameters, teaching)
    except DomainError:
        return ["lost"] * seeds
    orbit, found = LIMIT_CYCLES[target].orbit(teaching.amplitude), []
    for seed in range(seeds):
        weights = trainer.fit(replace(teaching, seed=seed)).weights_
        start = trainer.run.arm_after(FORCED_STEPS)
        loop = ClosedLoop(start, weights, teaching.amplitude, jump=None)
        loop.run(CLOSED_STEPS)
        if loop.failure is not None:
            found.append("lost")
            continue
        scores = score_window(loop.outputs[-WINDOW_STEPS:], orbit, trainer.run.turn)
        found.append("held" if scores["held"] else "irregular")
    return found


def count_contradictions(outcomes: Mapping[str, Sequence[str]]) -> float:
    """Cycles whose outcome is not the paper's; one that depends on the seed counts in part."""
    return sum(
        sum(outcome != PAPER_OUTCOMES[target] for outcome in found) / len(found)
        for target, found in outcomes.items()
    )


def describe_outcomes(outcomes: Mapping[str, Any]) -> str:
    """In a few words: how many of the seeds gave the paper's outcome, by cycle."""
    return ", ".join(
        f"{target} {found.count(PAPER_OUTCOMES[target])} of {len(found)}"
        for target, found in outcomes.items()
    )
