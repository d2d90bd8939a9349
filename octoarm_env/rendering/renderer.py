"""Pictures of an arm in an episode."""

from __future__ import annotations

import operator
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octoarm_env.parameters import ArmParameters
from octoarm_env.rendering import mesh
from octoarm_env.rendering.camera import Camera, Stage, View, find_camera, picture_size
from octoarm_env.rendering.colours import BASE, FLESH, ORBIT, SPRINGS, TARGET
from octoarm_env.rendering.history import History
from octoarm_env.rendering.panels import Panels, status_lines
from octoarm_env.rendering.toolkit import pygame
from octoarm_env.rendering.water import HAZE, draw_shadow, draw_water

__all__ = ["Renderer"]

Float = NDArray[np.float64]
Frame = NDArray[np.uint8]

_METAL = np.array([168.0, 178.0, 186.0])
_RING = (120, 150, 164)
_POINTER = 0.2
"""Length of the base's pointer as a share of the arm's."""
_PLATE = (1.55, 0.5)
"""Radius and thickness of the plate as shares of the arm's base radius."""
_TRACE_PIECES = 100
"""How finely the pointer's past is drawn."""
_FINEST = 2048
"""Largest side that is drawn twice as large first, for smooth edges [pixels]."""


class Renderer:
    """Draws the arm in three dimensions, in water, on its base, with what it is doing beside it.

    The pointer above the base leans as the base does, against the arm; the curve that its end is to
    follow is the target. The arm's four rows of springs have four colours. At the bottom the strain
    of every spring, a cell each; the scale of colours is that of a square root.

    Args:
        parameters: the body.
        orbit: the target, (K, 2) [degrees].
        action_range: largest angle of the base [degrees].
        title: whose picture this is.
        size: (width, height) [pixels], 16 to 4096.
        camera: from where, a `Camera` or a name in `CAMERAS`; it may be changed.
        overlay: figures, phase portrait and strains as well; there must be room for them, 288×216
            at least.

    A picture depends on the arguments of `draw` and the camera alone. It needs no display.
    """

    def __init__(
        self,
        parameters: ArmParameters,
        orbit: Float,
        action_range: float,
        title: str = "",
        *,
        size: tuple[int, int] = (640, 480),
        camera: Camera | str | None = None,
        overlay: bool = True,
    ) -> None:
        self.camera = find_camera(camera)
        self.size = picture_size(*size)
        self.title, self.overlay = title, overlay
        self.notes: tuple[str, ...] = ()
        """More lines among the figures."""
        self._parameters, self._orbit, self._range = parameters, orbit, action_range
        self._stage = _stage(parameters)
        self._fine = 2 if max(self.size) <= _FINEST else 1
        count = parameters.compartments
        self._panels = Panels(self.size, self._fine, orbit, 1.06 * action_range, count)
        self._canvas = self._surface(self._fine)
        self._water = self._surface(self._fine)
        self._picture = self._surface(1)
        self._view: View | None = None
        self._drawn_for: tuple[Camera, bool] | None = None
        rows = np.arange(count + 3) % 2
        rows[count:] = rows[count - 1]
        self._flesh = np.repeat(np.array(FLESH, dtype=np.float64)[rows], mesh.SIDES, axis=0)
        self._pointer = _POINTER * parameters.rest_length * count
        self._path = self._pointed(np.concatenate((orbit[:: max(1, len(orbit) // 96)], orbit[:1])))

    def resized(self, width: int, height: int) -> Renderer:
        """Give a renderer of the same for another size."""
        renderer = Renderer(
            self._parameters,
            self._orbit,
            self._range,
            self.title,
            size=(width, height),
            camera=self.camera,
            overlay=self.overlay,
        )
        renderer.notes = self.notes
        return renderer

    def draw(self, joints: Float, history: History) -> pygame.Surface:
        """Draw a picture.

        Args:
            joints: `OctoArmEnv.arm_joints`, (N + 1, 4, 3) [m].
            history: of the episode, which has begun.

        Returns:
            The picture; it is drawn over by the next one.
        """
        view = self._look()
        self._canvas.blit(self._water, (0, 0))
        self._draw_arm(view, joints, history)
        if self.overlay:
            lengths = np.linalg.norm(np.diff(joints, axis=0), axis=2)
            strains = lengths / self._parameters.rest_length - 1.0
            labels = self._panels.draw(self._canvas, history, strains)
            labels += self._panels.figures(self._canvas, self._lines(history))
        if self._fine == 1:
            self._picture.blit(self._canvas, (0, 0))
        else:
            pygame.transform.smoothscale(self._canvas, self.size, self._picture)
        if self.overlay:
            self._panels.write(self._picture, labels)
        return self._picture

    def frame(self, joints: Float, history: History) -> Frame:
        """Draw a picture as an array of its own, (height, width, 3), 0 to 255."""
        pixels = pygame.image.tobytes(self.draw(joints, history), "RGB")
        width, height = self.size
        return np.frombuffer(pixels, np.uint8).reshape(height, width, 3).copy()

    def tilt_towards(self, right: float, upwards: float) -> Float:
        """Give base angles that lean the arm towards a side of the picture, (2,) [degrees].

        Args:
            right: to the right, in parts of the action range.
            upwards: away from the viewer, in parts of the action range.
        """
        view = self._look()
        up = self._stage.up
        away = -view.back + (view.back @ up) * up
        away /= np.linalg.norm(away)
        size = min(float(np.hypot(right, upwards)), 1.0)
        if size == 0.0:
            return np.zeros(2)
        lean = (right * view.right + upwards * away) / np.hypot(right, upwards)
        # The plane's normal R e_z is (sin φ, -sin θ cos φ, cos θ cos φ).
        angles = np.array([-lean[1], lean[0]])
        longest = float(np.abs(angles).max()) or 1.0
        return size * self._range * angles / longest

    def _lines(self, history: History) -> list[Any]:
        factor = self.camera.exaggeration
        notes = (f"sideways ×{factor:.3g}", *self.notes) if factor != 1.0 else self.notes
        return status_lines(self.title, history, notes)

    def _surface(self, times: int) -> pygame.Surface:
        return pygame.Surface((self.size[0] * times, self.size[1] * times), depth=32)

    def _look(self) -> View:
        """Give the view of the camera as it stands now, with the water drawn for it."""
        key = (self.camera, self.overlay)
        if self._view is None or self._drawn_for != key:
            bottom = self._panels.bottom * self._fine if self.overlay else 0.0
            self._view = View(self.camera, self._stage, self._canvas.get_size(), bottom)
            draw_water(self._water, self._view, self._stage)
            self._drawn_for = key
        return self._view

    def _pointed(self, angles: Float) -> Float:
        """Where the end of the pointer is for base angles (n, 2) [degrees], (n, 3) [m]."""
        theta, phi = np.radians(angles).T
        normal = np.stack(
            (np.sin(phi), -np.sin(theta) * np.cos(phi), np.cos(theta) * np.cos(phi)), axis=1
        )
        points: Float = -self._pointer * normal
        return points

    def _draw_arm(self, view: View, joints: Float, history: History) -> None:
        joints = mesh.exaggerate(joints, self._stage.up, self.camera.exaggeration)
        rings = mesh.skin(joints)
        draw_shadow(self._canvas, view, self._stage, rings[::2, ::2])
        items = self._skin(view, rings)
        items += self._springs(view, joints)
        items += self._base(view, history)
        items.sort(key=operator.itemgetter(0))
        draw_polygon, draw_line = pygame.draw.polygon, pygame.draw.line
        for _, colour, points, wide in items:
            if wide:
                draw_line(self._canvas, colour, points[0], points[1], wide)
            else:
                draw_polygon(self._canvas, colour, points)
        self._knobs(view, history)

    def _shaded(
        self, view: View, corners: Float, normals: Float, colours: Float
    ) -> list[tuple[Any, ...]]:
        """Facets that are seen, with their colours, to be drawn from the farthest on."""
        middles = corners.mean(axis=1)
        seen = ((view.origin - middles) * normals).sum(axis=1) > 0
        corners, normals, colours = corners[seen], normals[seen], colours[seen]
        pixels, depth = view.project(corners)
        light = 0.8 * self._stage.up + 0.45 * view.back - 0.4 * view.right
        light /= np.linalg.norm(light)
        shaded = mesh.lit(colours, normals, light, view.back, HAZE)
        depths = depth.mean(axis=1)
        far = np.clip((depths / view.distance - 0.9) * 0.5, 0.0, 0.6)[:, np.newaxis]
        shaded = np.rint(shaded + far * (HAZE - shaded)).astype(int)
        zeros = [0] * len(depths)
        return list(zip((-depths).tolist(), shaded.tolist(), pixels.tolist(), zeros, strict=True))

    def _skin(self, view: View, rings: Float) -> list[tuple[Any, ...]]:
        return self._shaded(view, *mesh.facets(rings), self._flesh)

    def _springs(self, view: View, joints: Float) -> list[tuple[Any, ...]]:
        """The springs that lie on this side of the arm."""
        middles = 0.5 * (joints[:-1] + joints[1:])
        outwards = middles - middles.mean(axis=1, keepdims=True)
        towards = view.origin - middles
        # A little beyond the edge too, where half of a spring's width is still seen.
        size = np.linalg.norm(outwards, axis=2) * np.linalg.norm(towards, axis=2)
        seen = (outwards * towards).sum(axis=2) > -0.12 * size
        bias = np.linalg.norm(outwards, axis=2)
        begins, _ = view.project(joints[:-1])
        ends, _ = view.project(joints[1:])
        depth = -view.project(middles)[1] + 0.7 * bias
        thick = 0.13 * float(self._parameters.tip_radius + self._parameters.base_radius)
        wide = max(self._fine, round(view.size_at(thick, middles[0, 0])))
        items = []
        for j, i in np.argwhere(seen).tolist():
            line = (begins[j, i].tolist(), ends[j, i].tolist())
            items.append((float(depth[j, i]), SPRINGS[i], line, wide))
        return items

    def _base(self, view: View, history: History) -> list[tuple[Any, ...]]:
        """The plate that leans, its pointer, the ring that does not, the curve to be followed."""
        radius = self._parameters.base_radius
        trace = history.trace
        trace = trace[:: -max(1, len(trace) // _TRACE_PIECES)][::-1]
        points = self._pointed(trace)
        normal = -points[-1] / self._pointer
        wide, thick = radius * _PLATE[0], radius * _PLATE[1]
        plate = mesh.tube(-thick * normal, -1e-4 * normal, (wide, wide))
        rod = mesh.tube(-thick * normal, points[-1], (0.16 * radius, 0.1 * radius), 8)
        items: list[tuple[Any, ...]] = []
        for rings in (plate, rod):
            corners, normals = mesh.facets(rings)
            items += self._shaded(view, corners, normals, np.tile(_METAL, (len(corners), 1)))
        for ring, side, colour in ((plate[0], -normal, _METAL), (plate[1], normal, 0.7 * _METAL)):
            flat = self._shaded(view, ring[np.newaxis], side[np.newaxis], colour[np.newaxis])
            items += flat
        up = self._stage.up
        level = mesh.tube(np.zeros(3), up, (2.3 * radius, 1.0), 48)[0]
        level = np.concatenate((level, level[:1]))
        fine = max(1, round(view.size_at(0.0012, np.zeros(3))))
        items += self._line(view, level, [_RING] * (len(level) - 1), fine)
        items += self._line(view, self._path, [ORBIT] * (len(self._path) - 1), fine)
        shares = np.linspace(0.35, 1.0, max(len(points) - 1, 1))
        shades = [tuple(round(share * part) for part in BASE) for share in shares]
        # Before the curve where it lies on it, the newest last.
        nearer = radius * (1.0 + shares)[: len(points) - 1]
        return items + self._line(view, points, shades[: len(points) - 1], 2 * fine, nearer)

    def _line(
        self,
        view: View,
        points: Float,
        colours: list[Any],
        wide: int,
        nearer: Float | float = 0.0,
    ) -> list[tuple[Any, ...]]:
        """A line piece by piece, each drawn as if it were so many metres nearer."""
        pixels, depth = view.project(points)
        depths = (nearer - 0.5 * (depth[:-1] + depth[1:])).tolist()
        corners = pixels.tolist()
        return [
            (d, c, pair, wide)
            for d, c, pair in zip(depths, colours, pairwise(corners), strict=True)
        ]

    def _knobs(self, view: View, history: History) -> None:
        """The end of the pointer, and where it should be."""
        pair = self._pointed(np.stack((history.trace[-1], history.target)))
        pixels, _ = view.project(pair)
        radius = max(view.size_at(0.28 * self._parameters.base_radius, pair[0]), 2.0)
        pygame.draw.circle(self._canvas, BASE, tuple(pixels[0]), radius)
        rim = max(self._fine, round(0.3 * radius))
        pygame.draw.circle(self._canvas, TARGET, tuple(pixels[1]), 1.6 * radius, rim)


def _stage(parameters: ArmParameters) -> Stage:
    gravity = np.array(parameters.gravity, dtype=np.float64)
    strength = float(np.linalg.norm(gravity))
    up = -gravity / strength if strength > 0 else np.array([0.0, 0.0, -1.0])
    length = parameters.rest_length * parameters.compartments
    axis = np.array([0.0, 0.0, 1.0])
    top = -(_POINTER + 0.02) * length * axis
    tip = length * axis
    middle = 0.5 * (top + tip)
    low = min(float(top @ up), float(tip @ up), float(middle @ up) - 0.5 * length)
    return Stage(up, top, tip, low - 0.06 * length)
