"""The arm, its springs and its base: pieces that are drawn from the farthest on."""

from __future__ import annotations

import operator
from collections.abc import Iterable, Sequence
from itertools import pairwise, repeat
from typing import Any

import numpy as np

from octoarm_env.arm import Arm
from octoarm_env.arrays import Float
from octoarm_env.parameters import ArmParameters
from octoarm_env.rendering import mesh
from octoarm_env.rendering.camera import Stage, View
from octoarm_env.rendering.colours import (
    BASE,
    FLESH,
    ORBIT,
    SPRINGS,
    TARGET,
    Colour,
    faded_base,
    muscle_colours,
)
from octoarm_env.rendering.history import History
from octoarm_env.rendering.toolkit import pygame
from octoarm_env.rendering.water import HAZE, draw_shadow

Pieces = list[tuple[Any, ...]]
"""Nearness, colour, corners, and the width of a line or 0 for a polygon."""

_METAL = np.array([168.0, 178.0, 186.0])
_RING: Colour = (120, 150, 164)
_RING_RADIUS = 2.3
"""Of the ring around the base, as a share of the arm's base radius."""
_POINTER = (0.2, 3.0)
"""Least lengths of the base's pointer as shares of the arm's length and base radius."""
_ROOM = 1.08
"""Radius of what is seen as a share of what an arm at rest needs: it swings, and grows longer."""
_PLATE = (1.55, 0.5)
"""Radius and thickness of the plate as shares of the arm's base radius."""
_TRACE_PIECES = 100
"""How finely the pointer's past is drawn."""
_ORBIT_PIECES = 96


class Body:
    """Draws an arm on its base, with what the base is to do.

    Args:
        parameters: the arm.
        orbit: the target, (K, 2) [degrees].
        action_range: largest angle of the base [degrees].
        fine: pixels of the canvas for one of the picture; springs and rims are not thinner.
    """

    def __init__(
        self, parameters: ArmParameters, orbit: Float, action_range: float, fine: int
    ) -> None:
        self._parameters, self._fine = parameters, fine
        count = parameters.compartments
        rows = np.arange(count + 3) % 2
        rows[count:] = rows[count - 1]
        self._flesh = np.repeat(np.array(FLESH, dtype=np.float64)[rows], mesh.SIDES, axis=0)
        length = parameters.rest_length * count
        self._pointer = max(_POINTER[0] * length, _POINTER[1] * parameters.base_radius)
        step = max(1, len(orbit) // _ORBIT_PIECES)
        self.path = self._pointed(np.concatenate((orbit[::step], orbit[:1])))
        """Where the end of the pointer is to pass, (n, 3) [m]."""
        try:
            at_rest = Arm(parameters).joints
        except ValueError:  # no static equilibrium: with its springs at rest
            at_rest = Arm(parameters, undeformed=True).joints
        self._rest = mesh.centres(at_rest)
        self.stage = self._stage(at_rest, action_range)
        self._view: View | None = None
        self._standing: Pieces = []

    def draw(
        self, canvas: pygame.Surface, view: View, joints: Float, history: History, factor: float
    ) -> None:
        """Draw it.

        Args:
            canvas: on which.
            view: from where.
            joints: `OctoArmEnv.arm_joints`, (N + 1, 4, 3) [m].
            history: of the episode, which has begun.
            factor: how many times as large the planes' ways to the side are drawn.
        """
        if view is not self._view:
            self._view, wide = view, _thin(view)
            self._standing = [
                *self._line(view, self._ring(), repeat(_RING), wide),
                *self._line(view, self.path, repeat(ORBIT), wide),
            ]
        joints = mesh.exaggerate(joints, self._rest, factor)
        rings = mesh.skin(joints)
        draw_shadow(canvas, view, self.stage, rings[::2, ::2])
        trace = history.trace
        points = self._pointed(trace[:: -max(1, len(trace) // _TRACE_PIECES)][::-1])
        # The past lies in front of the curve, the newest piece last.
        ages = np.linspace(0.35, 1.0, max(len(points) - 1, 1))[: len(points) - 1]
        nearer = self._parameters.base_radius * (1.0 + ages)
        pieces = self._solids(view, rings, points[-1])
        pieces += self._springs(view, joints, history.activations)
        pieces += self._standing
        if history.goal is None:
            pieces += self._line(view, points, faded_base(ages), 2 * _thin(view), nearer)
        pieces.sort(key=operator.itemgetter(0))
        draw_polygon, draw_line = pygame.draw.polygon, pygame.draw.line
        for _, colour, corners, wide in pieces:
            if wide:
                draw_line(canvas, colour, corners[0], corners[1], wide)
            else:
                draw_polygon(canvas, colour, corners)
        if history.goal is not None:
            self._draw_goal(canvas, view, joints, history.goal)
            return
        # The end of the pointer, and where it should be.
        radius = max(view.size_at(0.28 * self._parameters.base_radius, points[-1]), 2.0)
        rim = max(self._fine, round(0.3 * radius))
        end, target = self._pointed(np.stack((trace[-1], history.target)))
        (end, target), _ = view.project(np.stack((end, target)))
        pygame.draw.circle(canvas, BASE, end, radius)
        pygame.draw.circle(canvas, TARGET, target, 1.6 * radius, rim)

    def _draw_goal(self, canvas: pygame.Surface, view: View, joints: Float, goal: Float) -> None:
        """Where the tip should be, and its way there."""
        points = np.stack((joints[-1].mean(axis=0), goal))
        (tip, place), _ = view.project(points)
        wide = max(self._fine, _thin(view))
        pygame.draw.line(canvas, ORBIT, tip, place, wide)
        radius = max(view.size_at(0.6 * self._parameters.base_radius, goal), 3.0)
        pygame.draw.circle(canvas, BASE, place, radius)
        pygame.draw.circle(canvas, TARGET, place, radius, wide)

    def _pointed(self, angles: Float) -> Float:
        """Where the end of the pointer is for base angles (n, 2) [degrees], (n, 3) [m]."""
        theta, phi = np.radians(angles).T
        normal = np.stack(
            (np.sin(phi), -np.sin(theta) * np.cos(phi), np.cos(theta) * np.cos(phi)), axis=1
        )
        points: Float = -self._pointer * normal
        return points

    def _solids(self, view: View, rings: Float, end: Float) -> Pieces:
        """The skin, the plate that leans, and its pointer."""
        radius, normal = self._parameters.base_radius, -end / self._pointer
        wide, thick = radius * _PLATE[0], radius * _PLATE[1]
        plate = mesh.tube(-thick * normal, -1e-4 * normal, (wide, wide))
        rod = mesh.tube(-thick * normal, end, (0.16 * radius, 0.1 * radius), 8)
        parts = [mesh.facets(part) for part in (rings, plate, rod)]
        corners, normals = (np.concatenate(each) for each in zip(*parts, strict=True))
        metal = np.tile(_METAL, (len(corners) - len(self._flesh), 1))
        pieces = self._shaded(view, corners, normals, np.concatenate((self._flesh, metal)))
        lids = np.stack((_METAL, 0.7 * _METAL))
        return pieces + self._shaded(view, plate, np.stack((-normal, normal)), lids)

    def _shaded(self, view: View, corners: Float, normals: Float, colours: Float) -> Pieces:
        """Facets (n, corners, 3) that are seen, in the light."""
        middles = corners.mean(axis=1)
        seen = ((view.origin - middles) * normals).sum(axis=1) > 0
        corners, normals, colours = corners[seen], normals[seen], colours[seen]
        pixels, depth = view.project(corners)
        light = 0.8 * self.stage.up + 0.45 * view.back - 0.4 * view.right
        light /= np.linalg.norm(light)
        shaded = mesh.lit(colours, normals, light, view.back, HAZE)
        depths = depth.mean(axis=1)
        far = np.clip((depths / view.distance - 0.9) * 0.5, 0.0, 0.6)[:, np.newaxis]
        shaded = np.rint(shaded + far * (HAZE - shaded)).astype(int)
        return list(zip((-depths).tolist(), shaded.tolist(), pixels.tolist(), repeat(0)))

    def _springs(self, view: View, joints: Float, activations: Float | None) -> Pieces:
        """The springs that lie on this side of the arm."""
        middles = 0.5 * (joints[:-1] + joints[1:])
        outwards = middles - middles.mean(axis=1, keepdims=True)
        towards = view.origin - middles
        # A little beyond the edge too, where half of a spring's width is still seen.
        size = np.linalg.norm(outwards, axis=2) * np.linalg.norm(towards, axis=2)
        seen = (outwards * towards).sum(axis=2) > -0.12 * size
        bias = np.linalg.norm(outwards, axis=2)
        pixels = view.project(joints)[0].tolist()
        depth = -view.project(middles)[1] + 0.7 * bias
        thick = 0.13 * float(self._parameters.tip_radius + self._parameters.base_radius)
        wide = max(self._fine, round(view.size_at(thick, middles[0, 0])))
        count = len(middles)
        colours: Sequence[Sequence[Any]] = [SPRINGS] * count
        if activations is not None:
            segments = np.arange(count) * len(activations) // count
            colours = muscle_colours(activations[segments, :4]).tolist()
        pieces = []
        for j, i in np.argwhere(seen).tolist():
            line = (pixels[j][i], pixels[j + 1][i])
            pieces.append((float(depth[j, i]), colours[j][i], line, wide))
        return pieces

    def _ring(self) -> Float:
        """The edge of the plate when it does not lean, only wider, (n, 3) [m]."""
        axis, radius = np.array([0.0, 0.0, 1.0]), _RING_RADIUS * self._parameters.base_radius
        ring = mesh.tube(np.zeros(3), axis, (radius, 1.0), 48)[0]
        return np.concatenate((ring, ring[:1]))

    def _stage(self, at_rest: Float, action_range: float) -> Stage:
        """Give what must be in the picture: arm, ring, and the pointer wherever it leans."""
        gravity = np.array(self._parameters.gravity, dtype=np.float64)
        strength = float(np.linalg.norm(gravity))
        up = -gravity / strength if strength > 0 else np.array([0.0, 0.0, -1.0])
        turns = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
        leaning = action_range * np.stack((np.cos(turns), np.sin(turns)), axis=1)
        ends = 1.1 * self._pointed(np.concatenate((leaning, np.zeros((1, 2)))))
        skin = mesh.skin(at_rest).reshape(-1, 3)
        points = np.concatenate((skin, self._ring(), ends, self.path))
        if self._parameters.base_coupling == "gravity":
            points = np.concatenate((points, _turned(skin, action_range)))
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        radius = _ROOM * float(np.linalg.norm(points - middle, axis=1).max())
        floor = float((points @ up).min()) - 0.2 * radius
        return Stage(up, ends[-1], self._rest[-1], middle, radius, floor)

    def _line(
        self,
        view: View,
        points: Float,
        colours: Iterable[Colour],
        wide: int,
        nearer: Float | float = 0.0,
    ) -> Pieces:
        """A line piece by piece, each drawn as if it were so many metres nearer."""
        pixels, depth = view.project(points)
        depths = (nearer - 0.5 * (depth[:-1] + depth[1:])).tolist()
        return list(zip(depths, colours, pairwise(pixels.tolist()), repeat(wide)))


def _thin(view: View) -> int:
    """Pixels of a thin line at the base."""
    return max(1, round(view.size_at(0.0012, np.zeros(3))))


def _turned(points: Float, action_range: float) -> Float:
    """Points (P, 3) turned by R_0 = R_x(θ) R_y(φ), for angles all over the action range."""
    reach = np.radians(min(action_range, 180.0)) * np.linspace(-1.0, 1.0, 9)
    theta, phi = np.stack(np.meshgrid(reach, reach), axis=-1).reshape(-1, 2).T[..., np.newaxis]
    x, y, z = points.T
    x, z = np.cos(phi) * x + np.sin(phi) * z, np.cos(phi) * z - np.sin(phi) * x
    y, z = np.cos(theta) * y - np.sin(theta) * z, np.sin(theta) * y + np.cos(theta) * z
    return np.stack((x, y, z), axis=-1).reshape(-1, 3)
