"""Episodes in the terminal: the picture of the window, in half blocks."""

from __future__ import annotations

import functools
import sys
import time
from collections import deque
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from rich.color import Color
from rich.console import Console, Group
from rich.live import Live
from rich.segment import Segment, Segments
from rich.style import Style
from rich.text import Text

from octoarm_agents.viewing.episode import Episode

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from octoarm_env.rendering import Camera
    from octoarm_env.rendering.renderer import Renderer


UPPER_HALF = "▀"

_LARGEST = (160, 50)
"""Columns and lines that a frame takes at most, however large the terminal."""
_SMALLEST = (16, 8)
"""Columns and lines that a picture needs; below there are figures alone."""
_SHARPNESS = 4
"""Pixels of the picture for one of the terminal, along a side."""
_CLOSER = 1.7
"""Times the zoom of the window."""
_FRAME_TIME = 0.04
"""Least time between frames [s]."""


@functools.lru_cache(maxsize=1 << 14)
def _style(upper: tuple[int, int, int], lower: tuple[int, int, int]) -> Style:
    return Style(color=Color.from_rgb(*upper), bgcolor=Color.from_rgb(*lower))


def half_blocks(picture: NDArray[np.uint8]) -> Segments:
    """Give a picture as characters, whose colour is the upper half of a cell, and ground the lower.

    Args:
        picture: (2 lines, columns, 3).
    """
    # Fewer colours than eyes tell apart, so that styles are found again.
    coarse = (picture // 8 * 8).tolist()
    segments: list[Segment] = []
    for upper, lower in zip(coarse[::2], coarse[1::2], strict=True):
        for pair in zip(upper, lower, strict=True):
            segments.append(Segment(UPPER_HALF, _style(tuple(pair[0]), tuple(pair[1]))))
        segments.append(Segment.line())
    return Segments(segments)


class _Picture:
    """Draws an episode in whatever room there is.

    Args:
        episode: that is shown.
        camera: from where; in few pixels the arm is drawn larger, to fill them.
    """

    def __init__(self, episode: Episode, camera: Camera) -> None:
        self._episode, self._camera = episode, camera.zoomed(_CLOSER)
        self._renderer: Renderer | None = None

    def frame(self, width: int, height: int, speed: str) -> Group:
        """Draw what is to be seen now, in so many columns and lines."""
        episode, columns, lines = self._episode, min(width, _LARGEST[0]), min(height, _LARGEST[1])
        status = _status(episode, speed)
        status.truncate(max(columns, 1), overflow="ellipsis")
        lines -= 1
        if columns < _SMALLEST[0] or lines < _SMALLEST[1]:
            return Group(status)
        size = (_SHARPNESS * columns, _SHARPNESS * 2 * lines)
        if self._renderer is None or self._renderer.size != size:
            self._renderer = episode.renderer(size, self._camera, overlay=False)
        picture = self._renderer.frame(episode.joints, episode.history)
        blocks = picture.reshape(2 * lines, _SHARPNESS, columns, _SHARPNESS, 3)
        return Group(half_blocks(blocks.mean(axis=(1, 3)).astype(np.uint8)), status)


def _status(episode: Episode, speed: str) -> Text:
    history = episode.history
    alarms = [*history.disturbances, *(["left its domain"] if history.failure else [])]
    figures = (
        f"{history.time:.2f} of {episode.steps * episode.control_period:.2f} s  "
        f"return {history.total:.1f} of {history.steps}  "
        f"error {history.tracking_error:.2f}°  {speed}"
    )
    alarm = f" {' + '.join(alarms).upper()} " if alarms else ""
    return Text.assemble(figures, "  ", (alarm, "bold white on red"), no_wrap=True)


def show_in_terminal(
    console: Console, episodes: Iterable[Episode], camera: Camera, speed: float
) -> None:
    """Show episodes one after the other, live; into a pipe their figures alone.

    Args:
        console: where to.
        episodes: made one by one.
        camera: from where.
        speed: times real time.
    """
    # FORCE_COLOR and the like make a terminal of a pipe in the eyes of rich.
    live = sys.stdout.isatty() and console.is_terminal and not console.is_dumb_terminal
    if live and console.color_system is not None:
        _show_live(console, episodes, camera, speed)
        return
    for episode in episodes:
        while not episode.ended:
            episode.step()
        print(episode.report())


class _Pace:
    """Keeps the time of the show to the clock on the wall.

    Args:
        speed: seconds of the show in a second.
        period: seconds of the show in a step.
    """

    def __init__(self, speed: float, period: float) -> None:
        self._speed, self._period = speed, period
        self._due = time.monotonic()
        self._steps: deque[float] = deque([self._due])

    def wait(self) -> None:
        """Wait until a step more is due."""
        self._due += self._period / self._speed
        while (left := self._due - time.monotonic()) > 0:
            time.sleep(min(left, 0.1))
        now = time.monotonic()
        if now - self._due > 0.2:  # too slow, or stopped for a while: what is lost is lost
            self._due = now
        self._steps.append(now)
        while len(self._steps) > 2 and self._steps[0] < now - 1:
            self._steps.popleft()

    def __str__(self) -> str:
        wanted, passed = f"{self._speed:g}×", self._steps[-1] - self._steps[0]
        if passed < 0.5:
            return wanted
        reached = (len(self._steps) - 1) * self._period / passed
        return wanted if reached > 0.95 * self._speed else f"{reached:.2g}× of {wanted}"


def _show_live(console: Console, episodes: Iterable[Episode], camera: Camera, speed: float) -> None:
    reports: list[str] = []
    picture: _Picture | None = None
    words = f"{speed:g}×"
    try:
        with Live(console=console, screen=True, auto_refresh=False) as live:
            for episode in episodes:
                picture, pace = _Picture(episode, camera), _Pace(speed, episode.control_period)
                next_frame = time.monotonic()
                while not episode.ended:
                    pace.wait()
                    episode.step()
                    now = time.monotonic()
                    if now < next_frame and not episode.ended:
                        continue
                    words = str(pace)
                    live.update(picture.frame(console.width, console.height, words), refresh=True)
                    # At most half of the time goes into drawing.
                    next_frame = now + max(_FRAME_TIME, 2 * (time.monotonic() - now))
                reports.append(episode.report())
    except KeyboardInterrupt:
        reports.append("Stopped.")
    # The screen of before is back; what was seen last stays on it.
    if picture is not None:
        console.print(picture.frame(console.width, console.height - 2 - len(reports), words))
    print("\n".join(reports))
