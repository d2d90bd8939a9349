"""A search for ν and the κ_k: teach, close the loop, disturb it, look how close it comes back.

"The appropriate degree of ν is determined heuristically for each task" (section 2.2.2 of the
paper). Here CMA-ES (Hansen 2016, arXiv:1604.00772) determines it, and the sizes κ of the penalised
disturbances (`octoarm_agents.reservoir.teaching`) with it. A candidate is judged by what it is for:

- its loop is run from the switch-on, with noise on its outputs for half of the time. If it holds
  the cycle, the logarithm of the distance in the quiet end counts;
- if it does not, the leading Floquet exponents of the loop say how far from stability it is, the
  training error how far from the target, the steps until it was lost the rest.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from octoarm_agents.common.orbit import orbit_distance, turn_time
from octoarm_agents.common.whole import whole_number
from octoarm_agents.reservoir.closed_loop import FORCED_STEPS, ClosedLoop
from octoarm_agents.reservoir.teaching import ReadoutTrainer, Teaching
from octoarm_env import LIMIT_CYCLES, ArmParameters
from octoarm_env.arrays import Float

TRIAL_STEPS = 12_000
_CHUNK = 2_000
_NEAR_STEPS = 500
_LOST = 0.3
"""A trial ends early where the last steps of a chunk are farther from the orbit than that, in units
of the amplitude."""

_WINDOW_STEPS = 2_000
_PERIOD = 0.02
"""Steps at the end of a trial that are scored, and the part by which their period may be off."""

_START = (-5.5, -3.5, -2.5, -1.5, -1.5, -2.0, -2.0)
_SPREAD = 0.7
_LOWEST = (-9.0,) + (-5.0,) * 6
_HIGHEST = (-3.5,) + (0.3,) * 6
"""Decimal logarithms of ν [m] and the κ [degrees]: where the search begins, and its bounds."""

_LARGE_ERROR = 7e-4
"""Training error, in units of the amplitude, from which on a loop that is lost is marked down."""


@dataclass(frozen=True)
class Tuned:
    """What the search found.

    Attributes:
        teaching: the best one.
        distance: of its loop in the quiet end of its trial, mean plus a fifth of the maximum, in
            units of the amplitude; None if no candidate held the cycle.
        record: every candidate: noise, disturbances, score, distance (None: lost), steps held.
    """

    teaching: Teaching
    distance: float | None
    record: list[dict[str, Any]]


def tune(
    parameters: ArmParameters,
    teaching: Teaching,
    *,
    evaluations: int = 160,
    noise: float = 0.01,
    seed: int = 1,
    advance: Callable[[], None] = lambda: None,
) -> Tuned:
    """Find ν and κ with which the loop holds a cycle.

    Args:
        parameters: the body.
        teaching: target, amplitude, actuator, steps; its ν and κ are not used.
        evaluations: candidates tried, at least 8; a tenth of a second to half a second each.
        noise: half width of the white noise on the outputs in the first half of a trial [degrees].
        seed: of the search.
        advance: called once a candidate, for a progress bar.

    Raises:
        ValueError: too few evaluations, or noise that cannot be.
        DomainError: the arm cannot follow the teacher.
    """
    evaluations, seed = whole_number("evaluations", evaluations, 8), whole_number("seed", seed)
    if not (noise >= 0 and math.isfinite(noise)):
        raise ValueError(f"noise = {noise}: expected a number of degrees, not negative")
    import cma

    random = np.random.default_rng(seed)
    search = cma.CMAEvolutionStrategy(
        list(_START),
        _SPREAD,
        {
            # Its own generator: a seed would be NumPy's global one's.
            "seed": math.nan,
            "randn": lambda *shape: random.standard_normal(shape),
            "popsize": 8,
            "bounds": [list(_LOWEST), list(_HIGHEST)],
            "verbose": -9,
        },
    )
    record: list[dict[str, Any]] = []
    # Sums split over threads are rounded otherwise, and the search would take another way.
    with threadpool_limits(1):
        judge = _Judge(ReadoutTrainer(parameters, teaching), noise)
        while len(record) < evaluations:
            candidates = search.ask()
            results = []
            for candidate in candidates:
                results.append(judge.judge(10.0 ** np.asarray(candidate)))
                if len(record) + len(results) <= evaluations:
                    advance()
            record += results
            search.tell(candidates, [result["score"] for result in results])
    best = min(record[:evaluations], key=lambda result: float(result["score"]))
    found = replace(teaching, noise=best["noise"], disturbances=tuple(best["disturbances"]))
    return Tuned(found, best["distance"], record[:evaluations])


class _Judge:
    """Closes the loop of each candidate from the same start, under the same noise."""

    def __init__(self, trainer: ReadoutTrainer, noise: float) -> None:
        self._trainer, self._run = trainer, trainer.run
        self._start = self._run.arm_after(FORCED_STEPS)
        self._orbit = LIMIT_CYCLES[self._run.target].orbit(self._run.amplitude)
        drawn = np.random.default_rng(0).uniform(-noise, noise, (TRIAL_STEPS // 2, 2))
        self._noise = np.concatenate((drawn, np.zeros_like(drawn)))

    def judge(self, sizes: Float) -> dict[str, Any]:
        """A candidate (ν, κ...) with its score; the lower, the better."""
        weights, error = self._trainer.weights(float(sizes[0]), sizes[1:].tolist())
        steps, distance = self._trial(weights)
        if distance is not None:
            score = 0.3 * math.log10(distance)
        else:
            exponents = self._trainer.exponents(weights, steps=800)
            score = 2.0 - steps / TRIAL_STEPS + _instability(exponents)
            score += 0.7 * max(0.0, math.log10(error / self._run.amplitude / _LARGE_ERROR))
        return {
            "noise": float(sizes[0]),
            "disturbances": sizes[1:].tolist(),
            "score": score,
            "distance": distance,
            "steps": steps,
        }

    def _trial(self, weights: Float) -> tuple[int, float | None]:
        """Steps that the loop held the cycle, and its distance in the end if it did throughout."""
        loop = ClosedLoop(
            copy.deepcopy(self._start), weights, self._run.amplitude, jump=None, rest=None
        )
        for begin in range(0, TRIAL_STEPS, _CHUNK):
            outputs = loop.run(_CHUNK, self._noise[begin : begin + _CHUNK])
            if loop.failure is not None:
                return len(loop.outputs), None
            near = orbit_distance(outputs[-_NEAR_STEPS:], self._orbit).mean() / self._run.amplitude
            if near > _LOST:
                return len(loop.outputs), None
        window = outputs[-_WINDOW_STEPS:]
        if not abs(turn_time(window[:, 1]) / self._run.turn - 1) < _PERIOD:
            return TRIAL_STEPS, None
        distances = orbit_distance(window, self._orbit) / self._run.amplitude
        return TRIAL_STEPS, float(distances.mean() + 0.2 * distances.max())


def _instability(exponents: Float) -> float:
    """Grows with the exponents that should be negative; one, the phase's, may be zero."""
    if len(exponents) == 0:
        return 9.0
    unstable = max(float(exponents[0]), 0.0) + float(exponents[1])
    return math.log1p(unstable) if unstable > 0 else 0.3 * max(unstable, -1.0)
