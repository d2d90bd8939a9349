"""What a picture shows beside the arm itself: where the base was, what was earned."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["LATE", "History"]

Float = NDArray[np.float64]

LATE = 2.0
"""How much of the past is drawn [s]."""


class History:
    """The past of an episode, kept from step to step.

    Args:
        control_period: seconds of a step.

    Attributes:
        steps: made in this episode.
        reward: of the last step; None before the first.
        total: sum of the rewards.
        target: θ and φ of the target now [degrees].
        tracking_error: distance of the base from it now [degrees].
        failure: why the episode ended, if the arm left its domain; else empty.
    """

    def __init__(self, control_period: float) -> None:
        self.control_period = control_period
        self._trace: deque[Float] = deque(maxlen=max(2, round(LATE / control_period)))
        self.steps, self.total = 0, 0.0
        self.reward: float | None = None
        self.target: Float = np.zeros(2)
        self.tracking_error = 0.0
        self.failure = ""

    @property
    def began(self) -> bool:
        """Whether there was an episode."""
        return bool(self._trace)

    @property
    def time(self) -> float:
        """Since the episode began [s]."""
        return self.steps * self.control_period

    @property
    def trace(self) -> Float:
        """Base angles of late, the last row is now, (n, 2) [degrees]."""
        return np.array(self._trace)

    def begin(self, info: Mapping[str, Any]) -> None:
        """Forget all: an episode has begun with this info."""
        self._trace.clear()
        self.steps, self.total, self.reward, self.failure = 0, 0.0, None, ""
        self._see(info)

    def add(self, info: Mapping[str, Any], reward: float) -> None:
        """A step brought this info and reward."""
        self.steps += 1
        self.reward = float(reward)
        self.total += self.reward
        self.failure = str(info.get("failure", ""))
        self._see(info)

    def _see(self, info: Mapping[str, Any]) -> None:
        # Copies: an info belongs to the caller.
        self._trace.append(info["base_angles"].copy())
        self.target, self.tracking_error = info["target"].copy(), float(info["tracking_error"])
