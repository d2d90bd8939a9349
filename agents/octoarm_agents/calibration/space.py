"""What the paper leaves open, and in which bounds it is searched; nothing else of a body moves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from octoarm_env import ArmParameters
from octoarm_env.arrays import Float


@dataclass(frozen=True)
class OpenNumber:
    """A number that the paper does not give.

    Attributes:
        low: smallest value that is tried.
        high: largest.
        logarithmic: whether factors count, and not differences.
        unit: in which the bounds are, empty for a plain number.
    """

    low: float
    high: float
    logarithmic: bool
    unit: str

    def value(self, coordinate: float) -> float:
        """The value at a coordinate from 0 (low) to 1 (high)."""
        if self.logarithmic:
            return self.low * math.exp(coordinate * math.log(self.high / self.low))
        return self.low + (self.high - self.low) * coordinate

    def coordinate(self, value: float) -> float:
        """The coordinate of a value, or of the bound that is nearest to it."""
        value = min(max(value, self.low), self.high)
        if self.logarithmic:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


OPEN_NUMBERS: dict[str, OpenNumber] = {
    # A rod that turns about its foot, and all of its mass at the joint.
    "longitudinal_mass_share": OpenNumber(1 / 3, 1.0, False, ""),
    "area_scale": OpenNumber(0.5, 50.0, True, ""),
    "plane_mass": OpenNumber(1e-4, 0.1, True, "kg"),
    "plane_inertia": OpenNumber(1e-8, 1e-5, True, "kg m²"),
    # An octopus' muscle (Yekutieli et al. 2005), and all masses of Table 1 by the rest volume.
    "arm_density": OpenNumber(1042.0, 1303.0, False, "kg/m³"),
}
"""By the field of `ArmParameters`."""

READINGS = ("lift_scale", "volume_force", "reference_area")
"""Sign and readings, in which the spaces of a search differ."""

OPEN_PARAMETERS = (*OPEN_NUMBERS, "gravity", *READINGS)
"""Every field that a search may change. (The servo is not part of Task 1.)"""

_TILT = math.pi
"""Largest tilt of gravity [rad]: an arm that stands on its base."""

_SPREAD, _TILT_SPREAD = 0.2, 0.05
"""Standard deviation of the first bodies, in coordinates; of the tilt 18 degrees, for most of the
bodies that are tilted far leave their domain."""


@dataclass(frozen=True)
class SearchSpace:
    """The unit cube of all bodies that one search may try.

    Attributes:
        base: gives all that is not open, and the strength of gravity.
        lift_scale: +1 or -1, the sign of the lift force.
        volume_force: reading of Eqs. 7-8.
        reference_area: reading of A_r.
        tilt: whether the direction of gravity is searched too; else it is that of `base`.
    """

    base: ArmParameters
    lift_scale: float
    volume_force: str
    reference_area: str
    tilt: bool = False

    @property
    def begin(self) -> list[float]:
        """Coordinates of the body with which a search begins: `base`, or what is nearest to it."""
        numbers = [
            number.coordinate(getattr(self.base, name)) for name, number in OPEN_NUMBERS.items()
        ]
        return numbers + [0.5] * (2 * self.tilt)

    @property
    def spreads(self) -> list[float]:
        """Standard deviation of the coordinates of a search's first bodies."""
        return [_SPREAD] * len(OPEN_NUMBERS) + [_TILT_SPREAD] * (2 * self.tilt)

    @property
    def readings(self) -> dict[str, Any]:
        """The space's own of `READINGS`."""
        return {name: getattr(self, name) for name in READINGS}

    def holds(self, changes: Mapping[str, Any]) -> bool:
        """Whether a body, told by its open parameters, has the readings of this space."""
        return all(changes[name] == reading for name, reading in self.readings.items())

    def changes(self, coordinates: Sequence[float] | Float) -> dict[str, Any]:
        """The open parameters of the body at coordinates from 0 to 1, by field."""
        values = [float(coordinate) for coordinate in coordinates]
        numbers = {
            name: number.value(value)
            for (name, number), value in zip(OPEN_NUMBERS.items(), values, strict=False)
        }
        gravity = self.base.gravity
        if self.tilt:
            # Tilt and azimuth as polar coordinates of a plane, so that nothing is singular at the
            # hanging arm, the middle of the cube.
            across = 2 * _TILT * (np.array(values[len(OPEN_NUMBERS) :]) - 0.5)
            tilt = min(math.hypot(*across), _TILT)
            azimuth = math.atan2(across[1], across[0])
            strength = math.hypot(*self.base.gravity)
            side = strength * math.sin(tilt)
            gravity = side * math.cos(azimuth), side * math.sin(azimuth), strength * math.cos(tilt)
        return numbers | {"gravity": list(gravity)} | self.readings


def tilt_gravity(gravity: Sequence[float], angle: float) -> list[float]:
    """Turn gravity about the y axis.

    Args:
        gravity: (3,), world frame [m/s²]; for a hanging arm it points along +z.
        angle: from +z towards +x [degrees].

    Returns:
        (3,) [m/s²].
    """
    x, y, z = gravity
    sine, cosine = math.sin(math.radians(angle)), math.cos(math.radians(angle))
    return [x * cosine + z * sine, y, z * cosine - x * sine]
