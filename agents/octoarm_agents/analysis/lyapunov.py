"""Largest Lyapunov exponent of any system that can be stepped from a given state.

With a driven system, both trajectories under the same input, it is the conditional exponent:
negative if the input alone decides where the system ends up, positive if small differences grow.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octoarm_agents.common.whole import whole_number

__all__ = ["LyapunovExponent", "largest_lyapunov_exponent"]

Float = NDArray[np.float64]
Step = Callable[[Float, int], Float]


@dataclass(frozen=True, eq=False)
class LyapunovExponent:
    """A rate of growth with its uncertainty.

    Attributes:
        value: mean over the blocks [1/s, or 1/step if the interval is 1].
        standard_error: of that mean, from the scatter of the blocks.
        blocks: (blocks,), mean rate of growth in equal stretches of time.
    """

    value: float
    standard_error: float
    blocks: Float

    def to_dict(self) -> dict[str, Any]:
        """All as plain numbers for a JSON file; units in the keys."""
        return {
            "exponent_per_second": self.value,
            "standard_error_per_second": self.standard_error,
            "blocks_per_second": self.blocks.tolist(),
        }


def largest_lyapunov_exponent(
    step: Step,
    state: Float,
    steps: int,
    *,
    interval: float = 1.0,
    transient: int = 100,
    size: float = 1e-7,
    blocks: int = 10,
    seed: int = 0,
) -> LyapunovExponent:
    """Follow two nearby trajectories; bring the second back to a small distance after each step.

    Benettin et al. (1980). Distances are Euclidean, so components should be of like magnitude.

    Args:
        step: gives the state after step number k = 0, 1, … from the state before it; must not
            change its argument.
        state: (n,), the first state.
        steps: steps that count, a multiple of `blocks` or cut to one.
        interval: time of a step.
        transient: steps before those that count, in which the difference turns to the direction
            that grows most.
        size: distance of the trajectories after each step.
        blocks: stretches of time for the standard error, at least 2.
        seed: of the first difference's direction.

    Raises:
        ValueError: a number out of its range, or trajectories that meet within one step.
    """
    blocks = whole_number("blocks", blocks, 2)
    # At least one for each block.
    steps, transient = whole_number("steps", steps, blocks), whole_number("transient", transient)
    if not (interval > 0 and size > 0):
        raise ValueError(f"interval = {interval}, size = {size}: expected positive numbers")
    direction = np.random.default_rng(seed).standard_normal(len(state))
    direction /= np.linalg.norm(direction)
    counted = steps - steps % blocks
    growth = np.empty(transient + counted)
    for k in range(len(growth)):
        neighbour = step(state + size * direction, k)
        state = step(state, k)
        difference = neighbour - state
        distance = float(np.linalg.norm(difference))
        if not distance > 0:
            raise ValueError(
                f"the trajectories met within step {k + 1}, size = {size}: "
                "expected a larger size or shorter steps"
            )
        growth[k] = math.log(distance / size)
        direction = difference / distance
    means = growth[transient:].reshape(blocks, -1).mean(axis=1) / interval
    error = float(means.std(ddof=1)) / math.sqrt(blocks)
    return LyapunovExponent(float(means.mean()), error, means)
