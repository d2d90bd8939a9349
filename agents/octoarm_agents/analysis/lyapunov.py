"""Largest Lyapunov exponent of any system that can be stepped from a given state.

With a driven system, both trajectories under the same input, it is the conditional exponent:
negative if the input alone decides where the system ends up, positive if small differences grow.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from octoarm_agents.common.whole import whole_number
from octoarm_agents.reservoir.benettin import stretch_factors
from octoarm_env.arrays import Float

Step = Callable[[Float, int], Float]


@dataclass(frozen=True, eq=False)
class LyapunovExponent:
    """A rate of growth with its uncertainty.

    Attributes:
        exponent_per_second: mean over the blocks [1/s, or 1/step if the interval is 1].
        standard_error_per_second: of that mean, from the scatter of the blocks.
        blocks_per_second: (blocks,), mean rate of growth in equal stretches of time.
    """

    exponent_per_second: float
    standard_error_per_second: float
    blocks_per_second: Float

    def __str__(self) -> str:
        return f"{self.exponent_per_second:.3f} ± {self.standard_error_per_second:.3f}"


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

    Distances are Euclidean, so components should be of like magnitude.

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
    direction = np.random.default_rng(seed).standard_normal((len(state), 1))

    def carry(deviations: Float, k: int) -> Float:
        nonlocal state
        neighbour = step(state + deviations[:, 0], k)
        state = step(state, k)
        difference: Float = neighbour - state
        if not np.linalg.norm(difference) > 0:
            raise ValueError(
                f"the trajectories met within step {k + 1}, size = {size}: "
                "expected a larger size or shorter steps"
            )
        return difference[:, np.newaxis]

    factors = stretch_factors(
        carry,
        direction / np.linalg.norm(direction),
        steps - steps % blocks,
        transient=transient,
        size=size,
    )
    means = np.log(factors).reshape(blocks, -1).mean(axis=1) / interval
    error = float(means.std(ddof=1)) / math.sqrt(blocks)
    return LyapunovExponent(float(means.mean()), error, means)
