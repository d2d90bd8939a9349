"""How many dimensions states have: effective rank, kernel rank, generalisation rank."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from octoarm_env.arrays import Float


def participation_ratio(singular_values: Float) -> float:
    """Effective number of dimensions, (Σ σ²)² / Σ σ⁴: n if all n are equal, 1 if one dominates."""
    # Squares of shares, not of the values themselves, which could underflow.
    shares = (singular_values / singular_values.max()) ** 2
    return float(shares.sum() ** 2 / (shares**2).sum())


def numerical_rank(singular_values: Float, tolerance: float) -> int:
    """Number of singular values above `tolerance` times the largest.

    Raises:
        ValueError: a tolerance that is not between 0 and 1.
    """
    if not 0 < tolerance < 1:
        raise ValueError(f"tolerance = {tolerance}: expected a number between 0 and 1")
    return int((singular_values > tolerance * singular_values.max()).sum())


@dataclass(frozen=True, eq=False)
class SeparationRanks:
    """Ranks of the final states after many streams (Legenstein and Maass 2007, Büsing et al. 2010).

    A good reservoir separates different streams (high kernel rank) and treats similar ones alike
    (low generalisation rank).

    Attributes:
        kernel_rank: after streams that have nothing in common.
        generalisation_rank: after streams that differ a little.
        kernel_singular_values: of the centred states after the different streams, descending.
        generalisation_singular_values: the same after the similar streams.
        tolerance: a singular value counts above this share of the largest one of the *different*
            streams, so that both ranks have the same resolution.
    """

    kernel_rank: int
    generalisation_rank: int
    kernel_singular_values: Float
    generalisation_singular_values: Float
    tolerance: float


def separation_ranks(different: Float, similar: Float, tolerance: float) -> SeparationRanks:
    """Compare the final states after different streams with those after similar ones.

    Args:
        different: (streams, n), the states at the end of each stream.
        similar: (streams, n), the same for streams that differ a little.
        tolerance: see :class:`SeparationRanks`.

    Raises:
        ValueError: a tolerance that is not between 0 and 1.
    """
    kernel, generalisation = (
        np.linalg.svd(states - states.mean(axis=0), compute_uv=False)
        for states in (different, similar)
    )
    return SeparationRanks(
        kernel_rank=numerical_rank(kernel, tolerance),
        generalisation_rank=int((generalisation > tolerance * kernel[0]).sum()),
        kernel_singular_values=kernel,
        generalisation_singular_values=generalisation,
        tolerance=tolerance,
    )
