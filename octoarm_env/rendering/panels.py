"""The flat parts of a picture: figures, phase portrait of the base, strain of the springs."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from octoarm_env.arrays import Float
from octoarm_env.rendering.colours import (
    BASE,
    FLESH,
    ORBIT,
    SPRINGS,
    STRAIN_SCALE,
    TARGET,
    Colour,
    faded_base,
    strain_colours,
)
from octoarm_env.rendering.history import History
from octoarm_env.rendering.toolkit import pygame

Line = tuple[str, Colour]

_TEXT: Colour = (236, 244, 248)
_FAINT: Colour = (156, 190, 204)
_ALARM: Colour = (255, 120, 100)
_AXIS: Colour = (60, 96, 116)
_PANEL = (4, 22, 40, 150)

_SMALLEST = 0.45
"""Least share of 640×480 at which there are panels; below, text cannot be read."""
_TRACE_POINTS = 120
_MOST_TEXTS = 200
"""How many drawn texts are kept."""


class Label(NamedTuple):
    """A text and where it goes, in pixels of the finished picture."""

    text: str
    x: float
    y: float
    colour: Colour = _TEXT
    size: int = 15
    anchor: Literal["left", "middle", "right"] = "left"


class Panels:
    """Draws the flat parts.

    Args:
        size: of the finished picture, (width, height) [pixels].
        oversampling: pixels of the canvas for each of them.
        orbit: the target, (K, 2) [degrees].
        reach: largest angle of the portrait [degrees].
        compartments: of the arm.

    Attributes:
        shown: whether there is room for them.
        bottom: height that they take at the bottom [pixels].
    """

    def __init__(
        self,
        size: tuple[int, int],
        oversampling: int,
        orbit: Float,
        reach: float,
        compartments: int,
    ) -> None:
        self._size, self._fine = size, oversampling
        self._reach, self._compartments = reach, compartments
        share = min(size[0] / 640, size[1] / 480)
        self.shown = share >= _SMALLEST
        self.unit = max(share, 0.65)
        """Of all lengths: 1 for a picture of 640×480."""
        self.bottom = 88.0 * self.unit if self.shown else 0.0
        step = max(1, len(orbit) // 256)
        self._orbit = np.concatenate((orbit[::step], orbit[:1]))
        pygame.font.init()
        self._cells: list[pygame.Rect] = []  # of the strains, row by row
        self._fonts: dict[int, pygame.font.Font] = {}
        self._texts: dict[tuple[str, Colour, int], pygame.Surface] = {}

    def draw(
        self, canvas: pygame.Surface, history: History, strains: Float, lines: list[Line]
    ) -> list[Label]:
        """Draw the shapes, and give the texts for :meth:`write`.

        Args:
            canvas: as large as the picture times the oversampling.
            history: what there is to say.
            strains: of the springs, (N, 4).
            lines: figures at the top left.
        """
        if not self.shown:
            return []
        if history.activations is None:
            labels = self._portrait(canvas, history)
        else:
            labels = self._muscles(canvas, history.activations)
        labels += self._strip(canvas, strains)
        return labels + self._figures(canvas, lines)

    def write(self, picture: pygame.Surface, labels: list[Label]) -> None:
        """Write texts onto the finished picture."""
        for text, x, y, colour, size, anchor in labels:
            image = self._letters(text, colour, size)
            shift = {"left": 0.0, "middle": 0.5, "right": 1.0}[anchor] * image.get_width()
            picture.blit(image, (round(x - shift), round(y)))

    def _width(self, text: str, size: int = 15) -> float:
        """Give how wide a text is [pixels]."""
        return self._letters(text, _TEXT, size).get_width()

    def _figures(self, canvas: pygame.Surface, lines: list[Line]) -> list[Label]:
        """Draw the panel at the top left for lines of text."""
        unit = self.unit
        # Mostly one width, so that the panel does not twitch.
        wide = max([self._width(text) + 16 * unit for text, _ in lines] + [150 * unit])
        self._panel(canvas, 8 * unit, 8 * unit, wide, (10 + 17 * len(lines)) * unit)
        return [
            Label(text, 16 * unit, (12 + 17 * row) * unit, colour)
            for row, (text, colour) in enumerate(lines)
        ]

    def _letters(self, text: str, colour: Colour, size: int) -> pygame.Surface:
        """Draw a text twice as large and shrink it: so small letters stand evenly."""
        key = (text, colour, size)
        if key not in self._texts:
            if len(self._texts) > _MOST_TEXTS:
                self._texts.clear()
            try:
                large = self._font(size).render(text, True, colour)
            except pygame.error:  # somebody has called pygame.quit(), after which fonts are dead
                pygame.font.init()
                self._fonts.clear()
                large = self._font(size).render(text, True, colour)
            half = (-(-large.get_width() // 2), -(-large.get_height() // 2))
            self._texts[key] = pygame.transform.smoothscale(large, half)
        return self._texts[key]

    def _font(self, size: int) -> pygame.font.Font:
        pixels = max(9, round(size * self.unit))
        if pixels not in self._fonts:
            self._fonts[pixels] = pygame.font.Font(None, round(2.6 * pixels))
        return self._fonts[pixels]

    def _panel(self, canvas: pygame.Surface, x: float, y: float, wide: float, high: float) -> None:
        place = self._on_canvas(x, y, wide, high)
        canvas.blit(_shade(*place.size, round(6 * self._fine)), place)

    def _on_canvas(self, x: float, y: float, wide: float, high: float) -> pygame.Rect:
        """Give where a rectangle of the picture lies on the canvas."""
        return pygame.Rect(*(round(each * self._fine) for each in (x, y, wide, high)))

    def _portrait(self, canvas: pygame.Surface, history: History) -> list[Label]:
        """θ to the right, φ upwards: orbit, late trace, base and target now."""
        unit, fine = self.unit, self._fine
        side, margin = 150 * unit, 8 * unit
        left, top = self._size[0] - side - margin, margin
        self._panel(canvas, left, top, side, side + 18 * unit)
        middle = np.array([left + side / 2, top + side / 2]) * fine
        scale = (side / 2 - 10 * unit) / self._reach * fine * np.array([1.0, -1.0])
        thin = max(1, round(unit * fine))
        clip = canvas.get_clip()
        canvas.set_clip(self._on_canvas(left, top, side, side))
        for arm in self._reach * np.eye(2) * scale:
            pygame.draw.line(canvas, _AXIS, (middle - arm).tolist(), (middle + arm).tolist(), thin)
        pygame.draw.lines(canvas, ORBIT, False, (self._orbit * scale + middle).tolist(), thin)
        trace = history.trace
        step = max(1, len(trace) // _TRACE_POINTS)
        points = (trace[::-step][::-1] * scale + middle).tolist()
        wide, draw_line = round(2 * unit * fine), pygame.draw.line
        count = len(points) - 1
        shades = faded_base(0.25 + 0.75 * np.arange(1, count + 1) / count, 30) if count else []
        for colour, (begin, end) in zip(shades, pairwise(points), strict=True):
            draw_line(canvas, colour, begin, end, wide)
        target = tuple(np.asarray(history.target) * scale + middle)
        pygame.draw.circle(canvas, TARGET, target, 6 * unit * fine, round(1.6 * unit * fine))
        pygame.draw.circle(canvas, BASE, points[-1], 3.6 * unit * fine)
        canvas.set_clip(clip)
        right, below = left + side, top + side
        return [
            Label("φ", left + side / 2 + 5 * unit, top + 3 * unit, _FAINT, 13),
            Label("θ", right - 6 * unit, top + side / 2 + 3 * unit, _FAINT, 13, "right"),
            Label("base", left + 8 * unit, below, BASE, 13),
            Label("target", left + side / 2 - 4 * unit, below, TARGET, 13, "middle"),
            Label(f"±{self._reach:.3g}°", right - 8 * unit, below, _FAINT, 13, "right"),
        ]

    def _muscles(self, canvas: pygame.Surface, activations: Float) -> list[Label]:
        """How active the muscles are: a row for each side and the transverse ones."""
        unit = self.unit
        wide, row, margin = 150 * unit, 12 * unit, 8 * unit
        left, top = self._size[0] - wide - margin, margin
        self._panel(canvas, left, top, wide, 5 * row + 30 * unit)
        first, begin = top + 22 * unit, left + 24 * unit
        cell = (wide - 32 * unit) / len(activations)
        ends = [*SPRINGS, FLESH[0]]
        for muscle, colour in enumerate(ends):
            for segment, active in enumerate(activations[:, muscle].tolist()):
                place = self._on_canvas(
                    begin + segment * cell, first + muscle * row, cell - unit, row - unit
                )
                shade = [round(30 + active * (each - 30)) for each in colour]
                canvas.fill(shade, place)
        names = ("1", "2", "3", "4", "t")
        return [
            Label("muscles", left + 8 * unit, top + 4 * unit, _FAINT, 13),
            *(
                Label(name, left + 12 * unit, first + row * index, colour, 13, "middle")
                for index, (name, colour) in enumerate(zip(names, ends, strict=True))
            ),
        ]

    def _strip(self, canvas: pygame.Surface, strains: Float) -> list[Label]:
        """Draw a row for each of the four springs, a cell for each compartment."""
        unit, fine = self.unit, self._fine
        margin, wide = 8 * unit, self._size[0] - 16 * unit
        top = self._size[1] - self.bottom + 2 * unit
        high = self.bottom - 2 * unit - margin
        self._panel(canvas, margin, top, wide, high)
        left, right = margin + 22 * unit, margin + wide - 10 * unit
        first, row = top + 20 * unit, (high - 26 * unit) / 4
        if not self._cells:
            columns = np.rint(np.linspace(left, right, self._compartments + 1) * fine).tolist()
            rows = np.rint((first + row * np.arange(5)) * fine).tolist()
            gap = fine if columns[1] - columns[0] > 6 * fine else 0
            self._cells = [
                pygame.Rect(left, top, max(right - left - gap, 1), max(bottom - top - fine, 1))
                for top, bottom in pairwise(rows)
                for left, right in pairwise(columns)
            ]
        colours = strain_colours(strains).swapaxes(0, 1).reshape(-1, 3).tolist()
        for colour, cell in zip(colours, self._cells, strict=True):
            canvas.fill(colour, cell)
        x = margin + 11 * unit
        return [
            *(
                Label(str(index + 1), x, first + (index - 0.15) * row, colour, 13, "middle")
                for index, colour in enumerate(SPRINGS)
            ),
            Label("base", left, top + 3 * unit, _FAINT, 13),
            Label("tip", right, top + 3 * unit, _FAINT, 13, "right"),
            *self._scale(canvas, top + 4 * unit),
        ]

    def _scale(self, canvas: pygame.Surface, top: float) -> list[Label]:
        """Draw what the colours mean."""
        unit, fine = self.unit, self._fine
        wide, high = 150 * unit, 10 * unit
        left = (self._size[0] - wide) / 2 + 30 * unit
        steps = 30
        shares = (np.arange(steps) + 0.5) / steps * 2 - 1
        colours = strain_colours(np.sign(shares) * shares**2 * STRAIN_SCALE).tolist()
        for index, colour in enumerate(colours):
            x = round((left + index * wide / steps) * fine)
            end = round((left + (index + 1) * wide / steps) * fine)
            canvas.fill(colour, (x, round(top * fine), end - x, round(high * fine)))
        most = 100 * STRAIN_SCALE
        words = f"spring strain  −{most:g} %"
        if left - 4 * unit - self._width(words, 13) < 36 * unit + self._width("base", 13):
            words = f"−{most:g} %"
        return [
            Label(words, left - 4 * unit, top - unit, _FAINT, 13, "right"),
            Label(f"+{most:g} %", left + wide + 4 * unit, top - unit, _FAINT, 13),
        ]


@functools.lru_cache(16)
def _shade(wide: int, high: int, radius: int) -> pygame.Surface:
    """Give what is behind the texts of a panel."""
    shade = pygame.Surface((wide, high), pygame.SRCALPHA, 32)
    pygame.draw.rect(shade, _PANEL, shade.get_rect(), border_radius=radius)
    return shade


def status_lines(title: str, history: History, notes: Sequence[str]) -> list[Line]:
    """Give the lines of figures of an episode."""
    lines: list[Line] = [(title, _TEXT), (f"{history.time:.2f} s", _TEXT)]
    lines += [(text, BASE if leads else _TEXT) for text, leads in history.figures()]
    if history.steps:
        lines.append((f"return {history.total:.1f} of {history.steps}", _TEXT))
    lines += [(each, _ALARM) for each in history.disturbances]
    if history.failure:
        lines.append(("left its domain", _ALARM))
    lines += [(note, _FAINT) for note in notes]
    return lines
