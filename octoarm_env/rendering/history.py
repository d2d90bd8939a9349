"""What a picture shows beside the arm itself: where the base was, what was earned."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octoarm_env.arrays import Float

Flags = NDArray[np.bool_]

LATE = 2.0
"""How much of the past is drawn [s]."""


def _length(control_period: float) -> int:
    return max(2, round(LATE / control_period))


class History:
    """The past of an episode.

    Args:
        control_period: seconds of a step.

    Attributes:
        steps: made in this episode.
        total: sum of the rewards.
        target: θ and φ of the target now [degrees].
        tracking_error: distance of the base from it now [degrees].
        failure: why the episode ended, if the arm left its domain; else empty.
        disturbances: what disturbs the arm now, in words.
    """

    goal: Float | None = None
    """Where the tip should be, (3,) [m], where that is the task."""
    activations: Float | None = None
    """How active the muscles are, (segments, 5), where there are any."""

    def __init__(self, control_period: float) -> None:
        self.disturbances: tuple[str, ...] = ()
        self.control_period = control_period
        self._trace: deque[Float] = deque(maxlen=_length(control_period))
        self.steps, self.total = 0, 0.0
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

    def figures(self) -> list[tuple[str, bool]]:
        """Give what is to be said of now, and whether it is of what the agent moves."""
        theta, phi = self._trace[-1]
        angles = f"θ {theta:+.1f}°   φ {phi:+.1f}°".replace("-", "−")
        return [(angles, True), (f"error {self.tracking_error:.2f}°", False)]

    def begin(self, info: Mapping[str, Any]) -> None:
        """Forget all: an episode has begun with this info."""
        self._trace.clear()
        self.steps, self.total, self.failure = 0, 0.0, ""
        self._see(info)

    def add(self, info: Mapping[str, Any], reward: float) -> None:
        """A step brought this info and reward."""
        self.steps += 1
        self.total += float(reward)
        self.failure = str(info.get("failure", ""))
        self._see(info)

    def _see(self, info: Mapping[str, Any]) -> None:
        # Copies: an info belongs to the caller.
        self._trace.append(info["base_angles"].copy())
        self.target, self.tracking_error = info["target"].copy(), float(info["tracking_error"])


class BatchHistory:
    """The pasts of episodes side by side, kept for little until one of them is asked for.

    Args:
        control_period: seconds of a step.
        count: number of environments N.
    """

    def __init__(self, control_period: float, count: int) -> None:
        self._period = control_period
        self._bases: deque[Float] = deque(maxlen=_length(control_period))
        self._steps = np.full(count, -1)  # before the first episode
        self._totals, self._errors = np.zeros((2, count))
        self._targets = np.zeros((count, 2))
        self._failures = np.full(count, "", dtype=np.object_)

    def begin(self, mask: Flags, infos: Mapping[str, Any]) -> None:
        """Episodes have begun with these infos, where the mask (N,) is True."""
        bases = self._bases.pop() if self._bases else np.zeros_like(self._targets)
        self._bases.append(np.where(mask[:, np.newaxis], infos["base_angles"], bases))
        self._targets = np.where(mask[:, np.newaxis], infos["target"], self._targets)
        self._errors = np.where(mask, infos["tracking_error"], self._errors)
        self._forget(mask)

    def add(self, infos: Mapping[str, Any], rewards: Float, begun: Flags) -> None:
        """A step brought these infos and rewards; where `begun` is True it began an episode."""
        self._bases.append(infos["base_angles"].copy())
        self._targets, self._errors = infos["target"].copy(), infos["tracking_error"].copy()
        self._steps += 1
        self._totals += rewards
        self._forget(begun)
        if "failure" in infos:
            failed = infos["_failure"]
            self._failures[failed] = infos["failure"][failed]

    def of(self, index: int) -> History:
        """Give the past of one environment."""
        history = History(self._period)
        history.steps = int(self._steps[index])
        history.total = float(self._totals[index])
        history.target = self._targets[index].copy()
        history.tracking_error = float(self._errors[index])
        history.failure = self._failures[index]
        first = max(len(self._bases) - history.steps - 1, 0)
        history._trace.extend(bases[index].copy() for bases in islice(self._bases, first, None))
        return history

    def _forget(self, mask: Flags) -> None:
        self._steps[mask], self._totals[mask], self._failures[mask] = 0, 0.0, ""


class ReachHistory(History):
    """The past of an episode of reaching; the base stands still.

    Attributes:
        distance: from tip to goal [m].
    """

    distance = 0.0

    def figures(self) -> list[tuple[str, bool]]:
        """Give what is to be said of now, and whether it is of what the agent moves."""
        return [(f"{100 * self.distance:.1f} cm to the goal", True)]

    def _see(self, info: Mapping[str, Any]) -> None:
        self._trace.append(np.zeros(2))
        self.distance = float(info["distance"])


class ReachHistories:
    """The pasts of episodes of reaching, side by side.

    Args:
        control_period: seconds of a step.
        count: number of environments N.
    """

    def __init__(self, control_period: float, count: int) -> None:
        self._pasts = [ReachHistory(control_period) for _ in range(count)]

    def begin(self, mask: Flags, infos: Mapping[str, Any]) -> None:
        """Episodes have begun with these infos, where the mask (N,) is True."""
        for index in np.flatnonzero(mask).tolist():
            self._pasts[index].begin(_info_of(infos, index))

    def add(self, infos: Mapping[str, Any], rewards: Float, begun: Flags) -> None:
        """A step brought these infos and rewards; where `begun` is True it began an episode."""
        for index, past in enumerate(self._pasts):
            info = _info_of(infos, index)
            if begun[index]:
                past.begin(info)
            else:
                past.add(info, float(rewards[index]))

    def of(self, index: int) -> ReachHistory:
        """Give the past of one environment."""
        return self._pasts[index]


def _info_of(infos: Mapping[str, Any], index: int) -> dict[str, Any]:
    info = {"distance": infos["distance"][index]}
    failed = "failure" in infos and infos["_failure"][index]
    return info | ({"failure": infos["failure"][index]} if failed else {})
