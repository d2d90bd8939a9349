"""Does a closed loop come back? Floquet exponents about the orbit that the teacher forces.

The loop of Eqs. 24-26 can hold a cycle only if what pushes it off dies out. On the orbit that the
teacher forces, every small deviation x of the body's state (coordinates, rates, base) obeys a
linear equation with the orbit's period; its Floquet multipliers are the growth factors of x over a
turn, its Floquet exponents their logarithms divided by the period. One exponent, that of the phase,
is zero in a loop without a clock; all others must be negative.

The step of the body is linearised at points of the orbit (`octoarm_env.Arm.linearise`), once for
all readouts; a readout W closes the loop, and a deviation obeys

    x(t+1) = (A(t) + B(t) Wᵀ C(t)) x(t),

with the Jacobians A and B of a step by state and command, and C of the lengths by the state. The
exponents are the Lyapunov exponents of this map: a few deviations are propagated and
orthonormalised now and then (`octoarm_agents.reservoir.benettin`).
The loop's own stability is not needed: the body is forced by the teacher, only the deviations see
the readout. Deviations of 1e-8 of the state, carried through the arm itself for 3,000 steps, grow
at rates that differ by up to 0.1/s, mostly by less than 0.05/s.
"""

from __future__ import annotations

import math

import numpy as np

from octoarm_agents.common.whole import whole_number
from octoarm_agents.reservoir.benettin import stretch_factors
from octoarm_agents.reservoir.teacher import POINTS, TeacherRun
from octoarm_env.arrays import Float

_CHUNK = 5
"""Steps between two orthonormalisations."""


def floquet_exponents(
    run: TeacherRun,
    weights: Float,
    *,
    count: int = 5,
    steps: int = 3_000,
    skip: int = 1_000,
    begin: int = 5_000,
    seed: int = 0,
) -> Float:
    """Compute the leading Floquet exponents of the closed loop, linearised about a teacher's orbit.

    Args:
        run: the orbit.
        weights: (springs, 2), or (springs + 1, 2) with the bias last [degrees/m].
        count: how many exponents, at least 1.
        steps: physics steps over which growth is averaged; several turns of the cycle.
        skip: physics steps before that, in which the deviations turn to the leading directions.
        begin: first step of the run that is used; by then the cycle must be settled.
        seed: of the first deviations.

    Returns:
        (count,), largest first [1/s]; the phase's, about zero, is among them.

    Raises:
        ValueError: the run is too short, a count below 1, or a gain beyond all bounds.
        DomainError: the arm is at the edge of its domain.
    """
    count, steps = whole_number("count", count, 1), whole_number("steps", steps, 1)
    skip, begin = whole_number("skip", skip), whole_number("begin", begin)
    end = begin + skip + steps
    if end > len(run.lengths):
        raise ValueError(
            f"the teacher's run has {len(run.lengths)} steps, "
            f"begin + skip + steps = {end} are needed"
        )
    springs = run.lengths.shape[1]
    gains = weights[:springs].T
    with np.errstate(over="ignore", invalid="ignore"):
        maps = run.maps(begin, min(math.ceil((skip + steps) / run.turn * POINTS), POINTS))
        loop = [step.state + step.command @ (gains @ step.lengths) for step in maps]
        random = np.random.default_rng(seed)
        directions = np.linalg.qr(random.normal(size=(len(loop[0]), count)))[0]

        def carry(deviations: Float, time: int) -> Float:
            # Rounding may carry the end of a turn to the next part.
            part = min(int(time % run.turn * POINTS / run.turn), len(loop) - 1)
            carried: Float = loop[part] @ deviations
            if not np.isfinite(carried).all():
                raise ValueError("the gain of the loop is beyond all bounds")
            return carried

        factors = stretch_factors(carry, directions, steps, transient=skip, every=_CHUNK)
        sums = np.log(factors).sum(axis=0)
    exponents: Float = np.sort(sums / (steps * run.parameters.timestep))[::-1]
    return exponents
