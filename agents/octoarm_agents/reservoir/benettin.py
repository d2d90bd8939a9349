"""How fast deviations from a trajectory grow: Benettin's method, for all Lyapunov exponents."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from octoarm_env.arrays import Float


def stretch_factors(
    carry: Callable[[Float, int], Float],
    directions: Float,
    steps: int,
    *,
    transient: int = 0,
    every: int = 1,
    size: float = 1.0,
) -> Float:
    """Carry deviations along a trajectory, and make them small and orthogonal again now and then.

    Benettin, Galgani, Giorgilli and Strelcyn (1980, Meccanica 15:9-20). The means of the logarithms
    of what is given back are the leading Lyapunov exponents, by `every` steps.

    Args:
        carry: gives the deviations (n, count) after step number k = 0, 1, … from those before it.
        directions: (n, count), the first ones, orthonormal.
        steps: that count.
        transient: steps before them, in which the deviations turn to the directions that grow most.
        every: steps between two orthonormalisations; there is one at the end of the transient too.
        size: of the deviations after each orthonormalisation.

    Returns:
        By how much each deviation grew from one orthonormalisation to the next, (times, count).
    """
    factors = []
    deviations = size * directions
    for k in range(transient + steps):
        deviations = carry(deviations, k)
        if (k + 1 - transient) % every and k + 1 < transient + steps:
            continue
        if deviations.shape[1] == 1:
            sizes = np.array([np.linalg.norm(deviations)])
            directions = deviations / sizes
        else:
            directions, triangle = np.linalg.qr(deviations)
            sizes = np.abs(np.diag(triangle))
        deviations = size * directions
        if k >= transient:
            factors.append(sizes / size)
    return np.array(factors)
