"""The limit cycles of the paper (Nakajima et al. 2013, section 2.2.2) as signals in degrees."""

from __future__ import annotations

import dataclasses
from typing import Literal

from octoarm_env import _core
from octoarm_env.arguments import positive, whole_number
from octoarm_env.arrays import Float

TargetName = Literal["quadratic", "van_der_pol", "lissajous"]

TARGET_NAMES: tuple[TargetName, ...] = ("quadratic", "van_der_pol", "lissajous")
"""Names that ``gym.make("OctoArm-v0", target=...)`` knows."""


@dataclasses.dataclass(frozen=True)
class LimitCycle:
    """A planar limit cycle x1(τ), x2(τ) whose own time τ advances by 0.01 a step of 1 ms.

    Scaled so that the variable with the larger range reaches ±R degrees; x1 is θ, x2 is φ.

    Attributes:
        name: ``"quadratic"`` (Eq. 28), ``"van_der_pol"`` (Eq. 27) or ``"lissajous"`` (Eq. 29 with
            f_1 = 2, f_2 = 1).
    """

    name: TargetName

    def __post_init__(self) -> None:
        if self.name not in TARGET_NAMES:
            raise ValueError(f"name = {self.name!r}: expected one of {TARGET_NAMES}")

    def signal(self, steps: int, amplitude: float) -> Float:
        """Give the signal that a teacher forces a resting arm with, one row a step of 1 ms.

        The oscillators start at (0.01, 0.01) before scaling, spiral out to their cycle within about
        a second and are integrated by the Runge-Kutta method at 0.01 a step; the Lissajous curve
        starts at the origin. A start on the cycle would throw the base by R degrees in 1 ms.

        Args:
            steps: number of rows T, at least 1.
            amplitude: R, the largest angle on the settled cycle [degrees].

        Returns:
            (T, 2), θ and φ [degrees].

        Raises:
            ValueError, TypeError: another number of steps or amplitude.
            MemoryError: so many steps do not fit into memory.
        """
        steps = whole_number("steps", steps, 1, 2**63 - 1)
        amplitude = positive("amplitude", amplitude, "number of degrees")
        return _core.limit_cycle_signal(self.name, amplitude, steps)

    def orbit(self, amplitude: float) -> Float:
        """Give one turn of the settled cycle at equal intervals of time.

        Args:
            amplitude: R, the largest angle [degrees].

        Returns:
            (K, 2) [degrees], K = 2048; the curve closes from the last row to the first.
        """
        amplitude = positive("amplitude", amplitude, "number of degrees")
        return _core.limit_cycle_orbit(self.name, amplitude)[0]

    @property
    def period(self) -> float:
        """Time of one turn of the settled cycle [s]."""
        return _core.limit_cycle_orbit(self.name, 1.0)[1]


LIMIT_CYCLES: dict[str, LimitCycle] = {name: LimitCycle(name) for name in TARGET_NAMES}
"""All by name."""
