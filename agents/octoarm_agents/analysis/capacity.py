"""What part of a target a linear readout of the states can give: the estimator and its bias.

The capacity for a target z is the share of its variance that the readout explains (Dambre et al.
2012). From T samples, with the readout fitted to the same samples, a target that has nothing to do
with n states still gets something, by chance. If target and states were independent that would be
n / T on average, and T times the capacity would follow a chi-square distribution with n degrees of
freedom. But the states are made by the same input as the target: where a high-degree function of
the input is large, so are the states' rarest movements, and then chance explains up to three times
as much (measured on one arm: an uncorrected n / T made the sum of all capacities 63 from 3,000
samples, where 30,000 samples say 50).

So the bias is estimated for each target from its own samples, by leaving each one out of the fit
(Kline, Saggio and Sølvsten 2020, "Leave-out estimation of variance components"): with the leverage
h of a sample, the prediction ŷ for it becomes (ŷ - h z) / (1 - h) when the fit has not seen it, and
the mean product of that with z is a capacity without bias. There it gives 52.6 from 3,000
samples and 50.1 from 10,000 or 30,000.

A capacity counts if it is too large a multiple of its target's bias to be chance; as multiples of
the mean the chi-square distribution's quantiles stay what they are.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from octoarm_env.arrays import Float


class Capacities(NamedTuple):
    """Capacities for m targets.

    Attributes:
        uncorrected: (m,), as the fit gives them, from 0 to 1.
        corrected: (m,), without bias, cut to the range from 0 to 1.
        multiples: (m,), the uncorrected capacities as multiples of their bias.
        signed: (m,), without bias and not cut: on average right, also for a target of nothing.
    """

    uncorrected: Float
    corrected: Float
    multiples: Float
    signed: Float

    def significant(self, threshold: float) -> Float:
        """Corrected capacities, zero where the multiple of the bias is not above `threshold`."""
        result: Float = np.where(self.multiples > threshold, self.corrected, 0.0)
        return result


class StateBasis:
    """The directions that centred states span over time, and how well each can be read.

    One singular value decomposition of the states serves any number of targets. Centring is the
    same as a readout with bias.

    Args:
        states: (T, n).
        noise: ν, the half width of white noise, uniform in [-ν, ν], that each state's sensor adds,
            in the states' unit. The capacities are those expected with it: SᵀS becomes
            SᵀS + T ν²/3 · 1 in fit and evaluation, nothing is drawn. With ν = 0 the readout is the
            pseudo-inverse, with singular values below max(T, n) · eps · σ_max taken as zero.

    Attributes:
        singular_values: (n,), of the centred states, descending.
        rank: number of singular values that count as not zero.
        gains: (rank,), σ² / (σ² + T ν²/3), the share of each direction that the noise leaves.

    Raises:
        ValueError: a negative noise.
    """

    def __init__(self, states: Float, noise: float = 0.0) -> None:
        if not (noise >= 0 and math.isfinite(noise)):
            raise ValueError(
                f"noise = {noise}: expected a number in the states' unit, not negative"
            )
        self.samples = len(states)
        self.means = states.mean(axis=0)
        # The triangular factor first: it leaves a small matrix to decompose.
        orthonormal, triangle = np.linalg.qr(states - self.means)
        left, self.singular_values, self._right = np.linalg.svd(triangle)
        tolerance = max(states.shape) * float(np.finfo(np.float64).eps)
        kept = self.singular_values > tolerance * self.singular_values[0]
        self.rank = int(kept.sum())
        squares = self.singular_values[: self.rank] ** 2
        self.gains: Float = squares / (squares + self.samples * noise**2 / 3)
        self.directions: Float = orthonormal @ left[:, : self.rank]
        self._leverages = self.directions**2 @ self.gains

    @property
    def bias(self) -> float:
        """Mean uncorrected capacity for a target that is independent of the states, n / T."""
        return float(self.gains.sum()) / self.samples

    def threshold(self, significance: float) -> float:
        """The multiple of its bias that a capacity of nothing exceeds so often.

        With noise the distribution is a weighted sum of chi-squares; the scaled chi-square with its
        mean and variance stands for it.

        Raises:
            ValueError: a significance that is not between 0 and 1.
        """
        from scipy.stats import chi2

        if not 0 < significance < 1:
            raise ValueError(
                f"significance = {significance}: expected a probability between 0 and 1"
            )
        freedom = float(self.gains.sum()) ** 2 / float((self.gains**2).sum())
        return float(chi2.isf(significance, freedom)) / freedom

    def capacities(self, targets: Float) -> Capacities:
        """Capacities for targets (m, T), one a row; nothing for one that is constant."""
        centred = targets - targets.mean(axis=1, keepdims=True)
        powers = np.maximum(np.einsum("mt,mt->m", centred, centred), np.finfo(np.float64).tiny)
        projections = centred @ self.directions
        explained = np.einsum("mr,r,mr->m", projections, self.gains, projections)
        predictions = (projections * self.gains) @ self.directions.T
        # A sample that alone decides a direction has leverage 1: the others predict nothing for it.
        rest = 1 - self._leverages
        weights = np.divide(1.0, rest, out=np.zeros(len(rest)), where=rest > 1e-9)
        left_out = np.einsum("mt,mt,t->m", centred, predictions, weights)
        left_out -= np.einsum("mt,mt,t->m", centred, centred, weights * self._leverages)
        uncorrected, corrected = explained / powers, left_out / powers
        # The bias is itself an estimate; below that of independence it is not believed.
        biases = np.maximum(uncorrected - corrected, (1 - uncorrected) * self.bias)
        multiples = uncorrected / np.maximum(biases, np.finfo(np.float64).tiny)
        return Capacities(uncorrected, np.clip(corrected, 0.0, 1.0), multiples, corrected)

    def predict(self, targets: Float, states: Float) -> Float:
        """What the readout fitted to `targets` (m, T) gives for other states (T', n): (T', m)."""
        means = targets.mean(axis=1, keepdims=True)
        projections = self.directions.T @ (targets - means).T
        factors = self.gains / self.singular_values[: self.rank]
        weights = self._right[: self.rank].T @ (factors[:, np.newaxis] * projections)
        predictions: Float = (states - self.means) @ weights + means.T
        return predictions
