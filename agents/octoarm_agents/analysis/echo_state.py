"""The echo state property (Jaeger 2001): the input washes the initial state out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from octoarm_agents.analysis.plain import plain
from octoarm_env.arrays import Float

FORGOTTEN = 1e-3
"""The initial states count as forgotten once their distance is this share of what it was."""

_FLOOR = 1e-9
"""Share of the first distance below which rounding, not the body, may decide."""


@dataclass(frozen=True, eq=False)
class EchoState:
    """Distance of two trajectories with different initial states and the same input.

    Attributes:
        distances: (samples,), the first before any input.
        interval_seconds: between two samples.
        decay_time_seconds: in which the distance falls by the factor e, from the fit; None if it
            does not fall. A mean over the whole fall: fast modes go first, and what is left goes at
            the rate of the largest Lyapunov exponent.
        fitted_samples: samples that the fit used, the first ones.
        verdict: "forgotten" if the distance ended below `FORGOTTEN` of what it was at first,
            "fading" if at least it fell by the factor e in the time there was, else "kept".
    """

    distances: Float
    interval_seconds: float
    decay_time_seconds: float | None
    fitted_samples: int
    verdict: Literal["forgotten", "fading", "kept"]

    def to_dict(self) -> dict[str, Any]:
        """All as plain numbers for a JSON file."""
        return plain(self) | {
            "final_over_first_distance": float(self.distances[-1] / self.distances[0])
        }


def fit_decay(distances: Float, interval: float) -> EchoState:
    """Fit an exponential to distances, least squares of their logarithms.

    Args:
        distances: (samples,), the first not zero.
        interval: between two samples [s].

    Raises:
        ValueError: trajectories that start together.
    """
    if not distances[0] > 0:
        raise ValueError("the two trajectories start from the same state")
    low = np.flatnonzero(distances <= _FLOOR * distances[0])
    count = int(low[0]) if len(low) else len(distances)
    slope = -math.inf
    if count >= 2:
        slope = float(np.polyfit(interval * np.arange(count), np.log(distances[:count]), 1)[0])
    decay = 0.0 if math.isinf(slope) else -1 / slope if slope < 0 else None
    verdict: Literal["forgotten", "fading", "kept"] = "kept"
    if distances[-1] < FORGOTTEN * distances[0]:
        verdict = "forgotten"
    elif decay is not None and decay <= interval * (len(distances) - 1):
        verdict = "fading"
    return EchoState(distances, interval, decay, count, verdict)
