"""The linear readout: 80 spring lengths times 80 weights an output, and nothing else."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

__all__ = ["Readout", "fit_readout"]

Float = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Readout:
    """A fitted linear readout without bias (Eq. 26).

    Attributes:
        weights: (springs, outputs) [degrees/m].
        noise: ν, the half width of the noise on the lengths that the fit allowed for [m].
        training_error: root mean square over rows of the residual's norm, without noise [degrees].
    """

    weights: Float
    noise: float
    training_error: float

    def predict(self, lengths: Float) -> Float:
        """Outputs (T, outputs) [degrees] of spring lengths (T, springs) [m]."""
        outputs: Float = lengths @ self.weights
        return outputs


def fit_readout(lengths: Float, targets: Float, noise: float = 0.0) -> Readout:
    """Fit weights by least squares as if the lengths carried white noise, uniform in [-ν, ν].

    The paper adds such noise to the M recorded rows before it takes the pseudo-inverse (section
    2.2.2). What that noise does to the normal equations, on average, is to add its variance ν²/3
    to every diagonal entry of each row's part: SᵀS becomes SᵀS + M ν²/3 · 1. This function uses
    that expectation, so nothing is drawn and the fit is the same each time. With ν = 0 it is the
    pseudo-inverse, with singular values below max(M, springs) · eps · σ_max taken as zero.

    Args:
        lengths: S, (M, springs) [m].
        targets: (M, outputs) [degrees]; row t is what the readout must give for row t of `lengths`.
        noise: ν [m], not negative.

    Raises:
        ValueError: shapes that do not fit together, too few rows, or a negative noise.
    """
    if lengths.ndim != 2 or targets.ndim != 2 or len(lengths) != len(targets):
        raise ValueError(
            "lengths (M, springs) and targets (M, outputs) must have the same number of rows, "
            f"got shapes {lengths.shape} and {targets.shape}"
        )
    rows, springs = lengths.shape
    if rows < springs:
        raise ValueError(f"{rows} rows cannot determine {springs} weights")
    if not (noise >= 0 and math.isfinite(noise)):
        raise ValueError(f"noise = {noise}: expected a number of metres, not negative")
    # Singular values of the triangular factor: SᵀS would lose everything below 1e-8 of the largest.
    # (NumPy's stubs know only the mode that returns a pair.)
    factor = cast("Float", np.linalg.qr(np.hstack((lengths, targets)), mode="r"))
    triangle = factor[:springs]
    left, singular, right = np.linalg.svd(triangle[:, :springs])
    if noise == 0.0:
        kept = singular > rows * np.finfo(np.float64).eps * singular[0]
        factors = np.divide(1.0, singular, out=np.zeros(springs), where=kept)
    else:
        factors = singular / (singular**2 + rows * noise**2 / 3)
    weights = right.T @ (factors[:, np.newaxis] * (left.T @ triangle[:, springs:]))
    residuals = targets - lengths @ weights
    error = math.sqrt(float(np.einsum("to,to->", residuals, residuals)) / rows)
    return Readout(weights, noise, error)
