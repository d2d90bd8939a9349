"""From where the arm is looked at, and where a point of the world lands on the picture."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from octoarm_env.arguments import whole_number
from octoarm_env.arrays import Float

_FIELD_OF_VIEW = 30.0
"""Angle between the upper and the lower edge of the stage [degrees]."""

SMALLEST, LARGEST = 16, 4096
"""Sides of a picture [pixels]."""

_RANGES = {
    "azimuth": (-math.inf, math.inf),
    "elevation": (-89.0, 89.0),
    "zoom": (0.2, 20.0),
    "focus": (0.0, 1.0),
    "exaggeration": (1.0, 50.0),
}


@dataclasses.dataclass(frozen=True)
class Camera:
    """From where the arm is looked at. At a zoom of 1 the whole arm is seen from everywhere.

    Attributes:
        azimuth: around the vertical; 0 looks from the world's +x [degrees].
        elevation: above the horizon, -89 to 89 [degrees].
        zoom: 0.2 to 20.
        focus: what is in the middle, from 0, the base, to 1, the tip; 0.5 with a little room for
            the base's pointer.
        exaggeration: how many times as large as it is a plane's way to the side of the base is
            drawn, 1 to 50; the picture says so if it is not 1.

    Raises:
        ValueError, TypeError: a number outside its range, by name.
    """

    azimuth: float = 60.0
    elevation: float = 20.0
    zoom: float = 1.0
    focus: float = 0.5
    exaggeration: float = 1.0

    def __post_init__(self) -> None:
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float | np.number):
                raise TypeError(f"camera.{name} = {value!r}: expected a number")
            if not (math.isfinite(value) and low <= value <= high):
                allowed = f"in [{low:g}, {high:g}]" if math.isfinite(low) else "that is finite"
                raise ValueError(f"camera.{name} = {value}: expected a number {allowed}")

    def orbited(self, azimuth: float, elevation: float) -> Camera:
        """Give the camera moved around the arm by so many degrees, within its range."""
        low, high = _RANGES["elevation"]
        return dataclasses.replace(
            self,
            azimuth=(self.azimuth + azimuth + 180.0) % 360.0 - 180.0,
            elevation=min(max(self.elevation + elevation, low), high),
        )

    def zoomed(self, factor: float) -> Camera:
        """Give the camera with so many times the zoom, within its range."""
        low, high = _RANGES["zoom"]
        return dataclasses.replace(self, zoom=min(max(self.zoom * factor, low), high))


CAMERAS: dict[str, Camera] = {
    "perspective": Camera(),
    "front": Camera(azimuth=90.0, elevation=4.0),
    "side": Camera(azimuth=180.0, elevation=4.0),
    "top": Camera(azimuth=90.0, elevation=80.0),
    "base": Camera(zoom=3.0, focus=0.08),
}
"""Cameras by name. Of an arm that hangs: x runs to the right in "front" and "top", y to the right
in "side"."""


def find_camera(value: Any) -> Camera:
    """Give a camera: one by its name, or of a mapping of its fields; the default for None.

    Raises:
        ValueError: an unknown name or field, or a field outside its range.
        TypeError: something else.
    """
    if value is None:
        return CAMERAS["perspective"]
    if isinstance(value, Camera):
        return value
    if isinstance(value, Mapping):
        unknown = sorted(set(value) - set(_RANGES))
        if unknown:
            raise ValueError(f"camera has unknown fields {unknown}; known are {sorted(_RANGES)}")
        return Camera(**value)
    if isinstance(value, str) and value in CAMERAS:
        return CAMERAS[value]
    kind = ValueError if isinstance(value, str) else TypeError
    raise kind(
        f"camera = {value!r}: expected a Camera, a mapping of its fields, or one of "
        f"{tuple(CAMERAS)}"
    )


def picture_size(width: Any, height: Any) -> tuple[int, int]:
    """Check the size of a picture.

    Raises:
        ValueError, TypeError: not whole numbers from 16 to 4096, by name.
    """
    return (
        whole_number("width", width, SMALLEST, LARGEST),
        whole_number("height", height, SMALLEST, LARGEST),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Stage:
    """What must be in the picture.

    Attributes:
        up: away from gravity, (3,).
        top: the end of the base's pointer, (3,) [m].
        tip: of the arm at rest, (3,) [m].
        middle: of the ball that holds all, (3,) [m].
        radius: of that ball, which is seen at a zoom of 1 [m].
        floor: height of the seabed above the base, along `up` [m].
    """

    up: Float
    top: Float
    tip: Float
    middle: Float
    radius: float
    floor: float

    def at(self, focus: float) -> Float:
        """Give the point in the middle of the picture."""
        point: Float = self.middle + (focus - 0.5) * (self.tip - self.top)
        return point

    @cached_property
    def level(self) -> tuple[Float, Float]:
        """Two directions along the ground: x as far as it is level, or y where it hardly is."""
        some = np.array([1.0, 0.0, 0.0]) if abs(self.up[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
        along = some - (some @ self.up) * self.up
        along /= np.linalg.norm(along)
        return along, np.cross(self.up, along)


class View:
    """A camera in front of a stage: the projection of world points to pixels.

    Args:
        camera: from where.
        stage: at what.
        size: of the picture, (width, height) [pixels].
        bottom: height of what covers the picture below [pixels].
    """

    def __init__(
        self, camera: Camera, stage: Stage, size: tuple[int, int], bottom: float = 0.0
    ) -> None:
        up, (along, across) = stage.up, stage.level
        azimuth, elevation = math.radians(camera.azimuth), math.radians(camera.elevation)
        # Counted so that y, seen from above a hanging arm, lies where azimuth 90 looks from.
        around = math.cos(azimuth) * along - math.sin(azimuth) * across
        self.back = math.cos(elevation) * around + math.sin(elevation) * up
        """From the arm towards the camera, (3,)."""
        right = np.cross(up, self.back)
        self.right = right / np.linalg.norm(right)
        self.upwards = np.cross(self.back, self.right)
        half = math.tan(math.radians(_FIELD_OF_VIEW / 2))
        width, height = size[0], max(size[1] - bottom, 1.0)
        narrow = min(1.0, width / height)
        self.distance = stage.radius / math.sin(math.atan(half * narrow))
        # The lens zooms, the camera stays: nothing that is drawn is ever behind it.
        self.scale = 0.5 * height / half * camera.zoom
        self.middle = np.array([0.5 * width, 0.5 * height])
        self.origin = stage.at(camera.focus) + self.distance * self.back
        """Where the camera is, (3,) [m]."""
        self.nearest = 0.02 * self.distance
        """Least depth of what is drawn [m]."""
        self._axes = np.stack((self.right, -self.upwards, -self.back), axis=1)

    def project(self, points: Float) -> tuple[Float, Float]:
        """Give pixels (…, 2), y downwards, and depths (…,) [m] of points (…, 3) [m]."""
        seen = (points - self.origin) @ self._axes
        depth = np.maximum(seen[..., 2], self.nearest)
        pixels = seen[..., :2] * (self.scale / depth)[..., np.newaxis] + self.middle
        return pixels, depth

    def size_at(self, length: float, point: Float) -> float:
        """Give how many pixels long a length [m] looks at a point."""
        depth = max(float((self.origin - point) @ self.back), self.nearest)
        return length * self.scale / depth
