"""An episode drawn as text: the base and its orbit, the arm from the side, its springs.

Functions from numbers to text that `rich` prints; none of them knows an environment or a terminal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rich.color import Color
from rich.style import Style
from rich.text import Text

__all__ = [
    "Canvas",
    "Moment",
    "Scene",
    "draw_frame",
    "phase_portrait",
    "round_up",
    "side_view",
    "strain_strip",
]

Float = NDArray[np.float64]

LARGEST = (160, 50)
"""Columns and lines that a frame takes at most, however large the terminal."""

_FRAME = "dim"
_ORBIT = "yellow"
_TRACE = ("rgb(20,90,100)", "rgb(40,150,165)", "bright_cyan")
_BASE = "bold bright_green"
_TARGET = "bold bright_yellow"
_ARM = "bright_magenta"
_SWAY = "rgb(110,70,120)"
_MOUNT = "bold"
_ALARM = "bold white on red"

_LEGEND = {"●": _BASE, "○": _TARGET, "∴": _ORBIT}

_NEUTRAL, _COMPRESSED, _STRETCHED = (48, 48, 54), (70, 150, 255), (255, 85, 70)
_LEVELS = "▁▂▃▄▅▆▇"
_SHADES = 20
"""Colours on either side of the neutral one."""

# Bits of the dots of a braille cell, by row and column; U+2800 is the cell without any.
_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], dtype=np.uint8)
_EMPTY = 0x2800


class Canvas:
    """A rectangle of cells with 2 x 4 dots each, braille characters, in coordinates of the data.

    A cell has one style and shows the dots of one style only: whatever is drawn in another style
    later covers what the cell held. What lies outside is left out.

    Args:
        width: in cells.
        height: in cells.
        left: x of the first column of dots.
        right: x of the last one.
        top: y of the first row of dots.
        bottom: y of the last one; above or below `top`.

    Raises:
        ValueError: no cells, or edges that coincide or are not finite.
    """

    def __init__(
        self, width: int, height: int, left: float, right: float, top: float, bottom: float
    ) -> None:
        if width < 1 or height < 1:
            raise ValueError(f"width, height = {width}, {height}: expected at least one cell")
        if not (math.isfinite(right - left) and math.isfinite(bottom - top)):
            raise ValueError(f"edges {left, right, top, bottom}: expected finite numbers")
        if left == right or top == bottom:
            raise ValueError(f"edges {left, right, top, bottom}: expected some distance between")
        self.width, self.height = width, height
        self._edges = left, right, top, bottom
        self._dots = np.zeros((height, width), dtype=np.uint8)
        self._styles = np.full((height, width), -1)
        self._names: list[str] = []
        self._marks: dict[tuple[int, int], tuple[str, str]] = {}

    @property
    def dot(self) -> tuple[float, float]:
        """Distance of neighbouring dots in x and in y, in units of the data."""
        left, right, top, bottom = self._edges
        return abs(right - left) / (2 * self.width - 1), abs(bottom - top) / (4 * self.height - 1)

    def points(self, x: ArrayLike, y: ArrayLike, style: str) -> None:
        """Set the dots nearest to points."""
        self._set(*self._to_dots(x, y), style)

    def line(self, x: ArrayLike, y: ArrayLike, style: str, *, every: int = 1) -> None:
        """Join points by a line, of which one dot in `every` is set."""
        columns, rows = self._to_dots(x, y)
        # A point far outside must not cost time without end.
        limit = 16 * max(2 * self.width, 4 * self.height)
        finite = np.isfinite(columns) & np.isfinite(rows)
        columns, rows = (np.clip(each[finite], -limit, limit) for each in (columns, rows))
        if columns.size == 0:
            return
        strides = np.maximum(np.abs(np.diff(columns)), np.abs(np.diff(rows)))
        ends = np.concatenate(([0.0], np.cumsum(strides)))
        at = np.arange(0.0, ends[-1] + 1e-9, every)
        self._set(np.interp(at, ends, columns), np.interp(at, ends, rows), style)

    def mark(self, x: float, y: float, symbol: str, style: str) -> None:
        """Put a character in place of the cell that a point lies in; the last one stays."""
        cell = self.cell(x, y)
        if cell is not None:
            self._marks[cell] = symbol, style

    def cell(self, x: float, y: float) -> tuple[int, int] | None:
        """Line and column of the cell that a point lies in; None if it lies outside."""
        columns, rows = self._to_dots(x, y)
        column, row = float(columns[0]), float(rows[0])
        if not (-0.5 <= column < 2 * self.width - 0.5 and -0.5 <= row < 4 * self.height - 0.5):
            return None
        return math.floor(row + 0.5) // 4, math.floor(column + 0.5) // 2

    def lines(self) -> list[Text]:
        """Give the picture, `height` lines of `width` characters."""
        return [self._line(row) for row in range(self.height)]

    def _to_dots(self, x: ArrayLike, y: ArrayLike) -> tuple[Float, Float]:
        left, right, top, bottom = self._edges
        columns = (np.atleast_1d(np.asarray(x, dtype=np.float64)) - left) / (right - left)
        rows = (np.atleast_1d(np.asarray(y, dtype=np.float64)) - top) / (bottom - top)
        return columns * (2 * self.width - 1), rows * (4 * self.height - 1)

    def _set(self, columns: Float, rows: Float, style: str) -> None:
        inside = (columns >= -0.5) & (columns < 2 * self.width - 0.5)
        inside &= (rows >= -0.5) & (rows < 4 * self.height - 0.5)
        column = np.floor(columns[inside] + 0.5).astype(np.intp)
        row = np.floor(rows[inside] + 0.5).astype(np.intp)
        if style not in self._names:
            self._names.append(style)
        number = self._names.index(style)
        cells = row // 4, column // 2
        covered = self._styles[cells] != number
        self._dots[cells[0][covered], cells[1][covered]] = 0
        self._styles[cells] = number
        np.bitwise_or.at(self._dots, cells, _BITS[row % 4, column % 2])

    def _line(self, row: int) -> Text:
        line = Text()
        for column in range(self.width):
            symbol, style = " ", ""
            if (row, column) in self._marks:
                symbol, style = self._marks[row, column]
            elif self._dots[row, column]:
                symbol = chr(_EMPTY + int(self._dots[row, column]))
                style = self._names[int(self._styles[row, column])]
            line.append(symbol, style)
        return line


@dataclass(frozen=True, eq=False)
class Scene:
    """What stays as it is during an episode.

    Attributes:
        title: whose episode this is.
        orbit: the target, (K, 2) [degrees].
        rest_length: of every spring [m].
        duration: of the episode, if the arm does not leave its domain [s].
        possible: the most that the episode can earn.
    """

    title: str
    orbit: Float
    rest_length: float
    duration: float
    possible: float


@dataclass(frozen=True, eq=False)
class Moment:
    """What is to be seen at one instant of an episode.

    Attributes:
        time: since the episode began [s].
        trace: θ and φ of the base of late, the last row is now, (n, 2) [degrees].
        target: θ and φ of the target now, (2,) [degrees].
        arm: centres of the planes now, base first, (N + 1, 3) [m].
        sway: least and largest x of each plane of late, (2, N + 1) [m].
        reach: largest |x| of a plane so far [m].
        lengths: of the springs now, compartment by compartment, (4 N,) [m].
        strain: what the scale of the strains has to hold so far; larger ones look like it.
        earned: sum of the rewards so far.
        possible: the most that it could be by now.
        error: distance of the base from the target now [degrees].
        distance: of the base from the orbit now [degrees].
        speed: of the show, in words.
        disturbance: what disturbs the agent now, in words; empty if nothing does.
    """

    time: float
    trace: Float
    target: Float
    arm: Float
    sway: Float
    reach: float
    lengths: Float
    strain: float
    earned: float
    possible: float
    error: float
    distance: float
    speed: str
    disturbance: str = ""


def draw_frame(
    scene: Scene, moment: Moment, width: int, height: int, *, colour: bool = True
) -> Text:
    """Draw one frame.

    Args:
        scene: what stays.
        moment: what changes.
        width: columns that there are.
        height: lines that there are.
        colour: whether colours will be seen; without them strains are drawn as bars.

    Returns:
        At most `height` lines of at most `width` columns, and no more than `LARGEST`.

    Raises:
        ValueError: no columns, or no lines.
    """
    if width < 1 or height < 1:
        raise ValueError(f"width, height = {width}, {height}: expected at least 1")
    width, height = min(width, LARGEST[0]), min(height, LARGEST[1])
    below = _status(scene, moment, width)
    rest = height - 1 - len(below)
    lines: list[Text] = [] if height < 2 else [_title(scene, moment, width)]
    if width >= 12 and rest >= 4:
        lines += _panels(scene, moment, width, rest, colour)
    lines = (lines + below)[:height]
    for line in lines:
        line.truncate(width, overflow="ellipsis")
    frame = Text("\n", no_wrap=True, overflow="crop").join(lines)
    frame.no_wrap, frame.overflow = True, "crop"
    return frame


def phase_portrait(scene: Scene, moment: Moment, width: int, height: int) -> Canvas:
    """Draw θ to the right and φ upwards, equally large: orbit, late trace, base and target now."""
    shown = np.vstack((moment.trace, moment.target))
    needed = np.maximum(1.15 * np.abs(scene.orbit).max(axis=0), 1.05 * np.abs(shown).max(axis=0))
    dots = np.array([2 * width - 1, 4 * height - 1]) / 2
    right, top = float((needed / dots).max() or 1.0) * dots
    canvas = Canvas(width, height, -right, right, top, -top)
    canvas.mark(0.0, 0.0, "+", _FRAME)
    closed = np.vstack((scene.orbit, scene.orbit[:1]))
    canvas.line(closed[:, 0], closed[:, 1], _ORBIT, every=3)
    parts = np.linspace(0, len(moment.trace), len(_TRACE) + 1).astype(int)
    for style, begin, end in zip(_TRACE, parts[:-1], parts[1:], strict=True):
        # From the last point of the older part on, so that no gap stays.
        part = moment.trace[max(begin - 1, 0) : end]
        canvas.line(part[:, 0], part[:, 1], style)
    base, target = tuple(moment.trace[-1]), tuple(moment.target)
    together = canvas.cell(*base) == canvas.cell(*target)
    canvas.mark(target[0], target[1], "○", _TARGET)
    canvas.mark(base[0], base[1], "◉" if together else "●", _BASE)
    return canvas


def side_view(scene: Scene, moment: Moment, width: int, height: int) -> Canvas:
    """Draw the arm, x to the right and depth downwards; x mostly far larger than depth.

    Beside it, dotted, how far each plane went to either side of late.
    """
    x, depth = moment.arm[:, 0], moment.arm[:, 2]
    right = round_up(max(1.05 * moment.reach, 1e-3))
    length = scene.rest_length * (len(depth) - 1)
    bottom = max(1.04 * length, float(depth.max()))
    canvas = Canvas(width, height, -right, right, min(0.0, float(depth.min())), bottom)
    for side in moment.sway:
        canvas.line(side, depth, _SWAY, every=3)
    taper = np.linspace(1.0, 0.0, len(x)) * canvas.dot[0]
    for shift in (-1, 1, 0):
        canvas.line(x + shift * taper, depth, _ARM)
    for shift, symbol in zip(range(-2, 3), "━━┳━━", strict=True):
        canvas.mark(2 * shift * canvas.dot[0], 0.0, symbol, _MOUNT)
    return canvas


def strain_strip(strains: Float, scale: float, width: int, *, colour: bool = True) -> list[Text]:
    """Draw strains as a line for each of the four springs and a cell for each compartment.

    Args:
        strains: (4 N,), compartment by compartment.
        scale: strain of the strongest colour, or of the highest bar.
        width: columns that there are. Where they are too few for all compartments, a cell stands
            for a few and shows the largest |strain| among them.
        colour: False: bars, in the middle where a spring has its rest length.
    """
    table = strains.reshape(-1, 4)
    if len(table) > width:
        groups = np.array_split(table, width)
        largest = [np.abs(group).argmax(axis=0) for group in groups]
        table = np.array([g[k, range(4)] for g, k in zip(groups, largest, strict=True)])
    size = max(1, width // len(table))
    values = np.clip(table.T / scale, -1.0, 1.0)
    return [_strip(row, size, colour) for row in values]


def round_up(value: float) -> float:
    """Give the next number of 1, 1.5, 2, 3, 5, 7.5, 10, … that is not smaller."""
    power = 10.0 ** math.floor(math.log10(value))
    steps = (1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0)
    return next((step * power for step in steps if step * power >= value), 10.0 * power)


def _panels(scene: Scene, moment: Moment, width: int, height: int, colour: bool) -> list[Text]:
    """Phase portrait and arm side by side, or where that is too narrow the portrait alone."""
    compartments = len(moment.arm) - 1
    if width < 36:
        return _portrait_panel(scene, moment, width, height)
    size = int(0.6 * width - 4) // compartments
    right = 4 + size * compartments if size else width // 2
    left = _portrait_panel(scene, moment, width - right, height)
    lines = _arm_panel(scene, moment, right, height, colour)
    return [Text.assemble(*pair) for pair in zip(left, lines, strict=True)]


def _portrait_panel(scene: Scene, moment: Moment, width: int, height: int) -> list[Text]:
    canvas = phase_portrait(scene, moment, width - 2, height - 2)
    right, top = (
        0.5 * dot * (count - 1)
        for dot, count in zip(canvas.dot, (2 * canvas.width, 4 * canvas.height), strict=True)
    )
    ranges = f"θ → ±{right:.0f}°  φ ↑ ±{top:.0f}°"
    heads = (f"base: {ranges}", ranges, "θ →, φ ↑")
    return _panel(
        canvas.lines(), width, heads, ("● base  ○ target  ◉ both  ∴ orbit", "● base  ○ target")
    )


def _arm_panel(scene: Scene, moment: Moment, width: int, height: int, colour: bool) -> list[Text]:
    inside = height - 2
    below: list[Text] = []
    if inside >= 11:
        scale = round_up(max(moment.strain, 1e-3))
        strains = moment.lengths / scene.rest_length - 1
        below.append(_sides("base", "spring lengths", "tip", width - 4, indent=2))
        strip = strain_strip(strains, scale, width - 4, colour=colour)
        below += [Text.assemble((f"{k} ", _FRAME), line) for k, line in enumerate(strip, 1)]
        below.append(_scale(scale, width - 2, colour))
    canvas = side_view(scene, moment, width - 2, inside - len(below))
    across, along = canvas.dot
    right = across * (2 * canvas.width - 1) / 2
    deep = f"depth ↓ {100 * along * (4 * canvas.height - 1):.0f} cm"
    wide = f"x → ±{1000 * right:.3g} mm"
    heads = (f"arm: {wide} ({along / across:.2g}×)  {deep}", f"{wide}  {deep}", wide)
    return _panel(canvas.lines() + below, width, heads, ())


def _panel(
    lines: Sequence[Text], width: int, heads: Sequence[str], feet: Sequence[str]
) -> list[Text]:
    """Put a frame around lines, with the first head and the first foot that fit."""
    panel = [_edge("╭", "╮", width, heads)]
    for line in lines:
        line.truncate(width - 2, pad=True)
        panel.append(Text.assemble(("│", _FRAME), line, ("│", _FRAME)))
    return [*panel, _edge("╰", "╯", width, feet)]


def _edge(begin: str, end: str, width: int, texts: Sequence[str]) -> Text:
    text = next((f" {text} " for text in texts if len(text) + 4 <= width), "")
    line = "─" * (width - 3 - len(text))
    edge = Text.assemble((f"{begin}─", _FRAME), text, (f"{line}{end}", _FRAME))
    for symbol, style in _LEGEND.items():
        edge.highlight_words([symbol], style)
    return edge


def _sides(begin: str, middle: str, end: str, width: int, *, indent: int) -> Text:
    gap = width - len(begin) - len(middle) - len(end)
    if gap < 2:
        return Text(f"{' ' * indent}{begin}{end:>{max(0, width - len(begin))}}", _FRAME)
    before, after = " " * (gap // 2), " " * (gap - gap // 2)
    return Text(f"{' ' * indent}{begin}{before}{middle}{after}{end}", _FRAME)


def _scale(scale: float, width: int, colour: bool) -> Text:
    bar = _strip(np.linspace(-1, 1, 7), 1, colour)
    text = Text.assemble(f"{-100 * scale:.3g}% ", bar, f" +{100 * scale:.3g}%")
    words = ("  shorter ", " longer") if len(text) + 17 <= width else ("  ", "")
    return Text.assemble((words[0], _FRAME), text, (words[1], _FRAME))


def _strip(values: Float, size: int, colour: bool) -> Text:
    line = Text()
    for value in values:
        if colour:
            line.append(" " * size, _shade(value))
        else:
            middle = len(_LEVELS) // 2
            line.append(_LEVELS[middle + round(middle * float(value))] * size)
    return line


def _shade(value: float) -> Style:
    """The colour of a strain from -1, blue, to 1, red."""
    strength = abs(round(_SHADES * float(value))) / _SHADES
    end = _STRETCHED if value > 0 else _COMPRESSED
    mixed = (a + strength * (b - a) for a, b in zip(_NEUTRAL, end, strict=True))
    return Style(bgcolor=Color.from_rgb(*(round(part) for part in mixed)))


def _title(scene: Scene, moment: Moment, width: int) -> Text:
    """Whose episode it is, and at the right what disturbs it."""
    alarm = f" {moment.disturbance} " if moment.disturbance else ""
    title = Text(scene.title, "bold")
    title.truncate(max(1, width - len(alarm)), overflow="ellipsis", pad=bool(alarm))
    return title.append(alarm, _ALARM)


def _status(scene: Scene, moment: Moment, width: int) -> list[Text]:
    """Give the figures, as many on a line as fit; their places do not depend on the moment."""
    share = f"{moment.earned / moment.possible:.2%}" if moment.possible else "-"
    seconds = f"{scene.duration:.2f}"
    most = f"{scene.possible:.0f}"
    earned = f"{moment.earned:{len(most) + 2}.1f} of {moment.possible:{len(most)}.0f}"
    items = [
        ("time", f"{moment.time:{len(seconds)}.2f} of {seconds} s"),
        ("return", f"{earned} ({share})".ljust(2 * len(most) + 16)),
        ("error", f"{moment.error:5.2f}°"),
        ("off the orbit" if width >= 60 else "orbit", f"{moment.distance:5.2f}°"),
        ("speed", f"{moment.speed:12}"),
    ]
    lines = [Text(" ")]
    for name, value in items:
        cell = Text.assemble((f"{name} ", _FRAME), (value, "bold"))
        if len(lines[-1]) > 1 and len(lines[-1]) + len(cell) > width:
            lines.append(Text(" "))
        lines[-1].append_text(cell)
        lines[-1].append("  ")
    for line in lines:
        line.rstrip()
    return lines
