"""What is around the arm: water, seabed, what drifts in it."""

from __future__ import annotations

import math

import numpy as np

from octoarm_env.arrays import Float
from octoarm_env.rendering.camera import Stage, View
from octoarm_env.rendering.colours import Colour
from octoarm_env.rendering.toolkit import pygame

_SURFACE = np.array([72.0, 164.0, 188.0])
_DEEP = np.array([8.0, 42.0, 78.0])
_SAND = np.array([126.0, 146.0, 138.0])
HAZE = np.array([26.0, 88.0, 122.0])
"""Colour of the water half way down: what far things turn into."""

_RINGS = 14
_DRIFTING = 90


def draw_water(surface: pygame.Surface, view: View, stage: Stage) -> None:
    """Fill the surface with water, and with the seabed where it is seen from above."""
    width, height = surface.get_size()
    shades = pygame.Surface((1, 64), depth=32)
    for row, share in enumerate(np.linspace(0.0, 1.0, 64)):
        shades.set_at((0, row), _colour(_SURFACE + share**0.8 * (_DEEP - _SURFACE)))
    surface.blit(pygame.transform.smoothscale(shades, (width, height)), (0, 0))
    if view.back @ stage.up > 0.02:
        _draw_seabed(surface, view, stage)
    _draw_drifting(surface, view, stage)


def draw_shadow(surface: pygame.Surface, view: View, stage: Stage, rings: Float) -> None:
    """Draw the arm's shadow on the seabed, straight below it."""
    if view.back @ stage.up <= 0.02:
        return
    below = rings - (rings @ stage.up - stage.floor)[..., np.newaxis] * stage.up
    pixels, _ = view.project(below)
    for pair in np.concatenate((pixels[:-1], pixels[1:]), axis=1).tolist():
        pygame.draw.polygon(surface, (58, 92, 100), _hull(pair))


def _draw_seabed(surface: pygame.Surface, view: View, stage: Stage) -> None:
    middle = stage.at(0.5)
    middle = middle - (middle @ stage.up - stage.floor) * stage.up
    along, across = stage.level
    reach = 2.7 * stage.radius
    angles = np.linspace(0.0, 2 * np.pi, 72, endpoint=False)
    circle = np.outer(np.cos(angles), along) + np.outer(np.sin(angles), across)
    behind = middle - reach * 0.98 * view.back
    pixel = view.project(behind - (behind @ stage.up - stage.floor) * stage.up)[0]
    row = int(min(max(pixel[1], 0), surface.get_height() - 1))
    around = np.array(surface.get_at((0, row))[:3], dtype=np.float64)
    for share in np.linspace(1.0, 0.0, _RINGS, endpoint=False):
        clear = (1.0 - share) ** 1.2
        pixels, _ = view.project(middle + share * reach * circle)
        pygame.draw.polygon(
            surface, _colour(around + 0.75 * clear * (_SAND - around)), pixels.tolist()
        )
    spacing = 0.1 if stage.radius > 0.1 else 0.1 * stage.radius
    count = int(reach / spacing)
    pieces = np.linspace(-1.0, 1.0, 33)
    for index in range(-count, count + 1):
        offset = index * spacing
        half = math.sqrt(max(reach**2 - offset**2, 0.0))
        for first, second in ((along, across), (across, along)):
            line = middle + offset * first + half * pieces[:, np.newaxis] * second
            pixels, _ = view.project(line)
            far = np.hypot(offset, half * 0.5 * (pieces[:-1] + pieces[1:])) / reach
            points = pixels.tolist()
            for begin, end, share in zip(points[:-1], points[1:], far.tolist(), strict=True):
                at = (int(0.5 * (begin[0] + end[0])), int(0.5 * (begin[1] + end[1])))
                if not surface.get_rect().collidepoint(at):
                    continue
                shade = _lighter(surface, at, 0.22 * max(0.0, 1.0 - share))
                pygame.draw.line(surface, shade, begin, end)


def _draw_drifting(surface: pygame.Surface, view: View, stage: Stage) -> None:
    """Draw small things that drift in the water: they tell how the camera moves."""
    random = np.random.default_rng(7)
    box = 1.7 * stage.radius
    points = stage.at(0.5) + random.uniform(-box, box, (_DRIFTING, 3))
    points = points[points @ stage.up > stage.floor]
    pixels, depth = view.project(points)
    near = np.clip(1.6 - depth / view.distance * 0.8, 0.1, 1.0)
    frame = surface.get_rect()
    for (x, y), share in zip(pixels.tolist(), near.tolist(), strict=True):
        if not frame.collidepoint(x, y):
            continue
        radius = max(1.0, share * surface.get_height() / 420)
        shade = _lighter(surface, (int(x), int(y)), 0.3 * share)
        pygame.draw.circle(surface, shade, (x, y), radius)


def _hull(points: list[list[float]]) -> list[list[float]]:
    """Give the convex hull of points in the plane (Andrew's monotone chain)."""
    ordered = sorted(points)
    hull = []
    for sequence in (ordered, ordered[::-1]):
        half: list[list[float]] = []
        for point in sequence:
            x, y = point
            while len(half) > 1:
                (ax, ay), (bx, by) = half[-2], half[-1]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0:
                    break
                half.pop()
            half.append(point)
        hull += half[:-1]
    return hull


def _lighter(surface: pygame.Surface, at: tuple[int, int], share: float) -> Colour:
    """Give the colour of a pixel on its way to white."""
    under = np.array(surface.get_at(at)[:3], dtype=np.float64)
    return _colour(under + share * (255.0 - under))


def _colour(shade: Float) -> Colour:
    red, green, blue = np.clip(np.rint(shade), 0, 255).astype(int).tolist()
    return red, green, blue
