"""What an environment needs of the episode behind it, wherever that is computed."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["EpisodeCore"]

Float = NDArray[np.float64]


class EpisodeCore(Protocol):
    """An episode: the compiled one, or one on a server.

    Errors are a ValueError or TypeError that names the argument, its value and what is allowed;
    nothing is changed then.
    """

    def seed(self, seed: int) -> None:
        """Start the generator of phases anew, with a seed in [0, 2**64)."""

    def reset(self, phase: float | None = None) -> tuple[Float, dict[str, Any]]:
        """Begin an episode, at a phase in turns or a random one; the lengths [m] and the info."""
        ...

    def step(self, action: ArrayLike) -> tuple[Float, float, bool, dict[str, Any]]:
        """Go on for a control period; lengths [m], reward, whether the arm failed, info."""
        ...

    def teacher_action(self) -> Float:
        """Give the lead-compensated clock's action now, (2,)."""
        ...

    def save(self) -> str:
        """Give all that the episode needs to go on, as JSON text."""
        ...

    def load(self, state: str) -> None:
        """Go on exactly where an episode of the same settings was saved."""

    @property
    def action_range(self) -> float:
        """Degrees of base rotation at an action of 1."""
        ...

    @property
    def observation_len(self) -> int:
        """Number of spring lengths."""
        ...

    @property
    def observation_bounds(self) -> tuple[float, float]:
        """Bounds of the spring lengths [m]."""
        ...

    @property
    def amplitude(self) -> float:
        """Largest |angle| of the target [degrees]."""
        ...

    @property
    def period(self) -> float:
        """Time of one turn of the target [s]."""
        ...

    @property
    def orbit(self) -> Float:
        """The target over one period, (K, 2) [degrees]."""
        ...

    @property
    def joints(self) -> Float:
        """Ends of the longitudinal springs, (N + 1, 4, 3) [m]."""
        ...

    @property
    def positions(self) -> Float:
        """Centres of the planes, (N + 1, 3) [m]."""
        ...
