"""The show of `octoarm watch` in the terminal: the picture of the window, in half blocks."""

from __future__ import annotations

import functools
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
import typer
from rich.color import Color
from rich.console import Console, Group
from rich.live import Live
from rich.segment import Segment, Segments
from rich.style import Style
from rich.text import Text

from octoarm_agents.policies.episode import Episode
from octoarm_env.rendering.history import History

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from octoarm_env.rendering.renderer import Renderer

__all__ = ["UPPER_HALF", "half_blocks", "show_in_terminal"]

UPPER_HALF = "▀"

_LARGEST = (160, 50)
"""Columns and lines that a frame takes at most, however large the terminal."""
_SMALLEST = (16, 8)
"""Columns and lines that a picture needs; below there are figures alone."""
_SHARPNESS = 4
"""Pixels of the picture for one of the terminal, along a side."""
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


class _Show:
    """An episode, and what the terminal shows of it.

    Args:
        episode: that is shown.
        renderer_of: makes what draws it in a size, (width, height) [pixels].
    """

    def __init__(
        self, episode: Episode, renderer_of: Callable[[Episode, tuple[int, int]], Renderer]
    ) -> None:
        self.episode, self._renderer_of = episode, renderer_of
        self._renderer: Renderer | None = None
        self._history = History(episode.period)
        self._history.begin(episode.info)

    def step(self) -> None:
        """Let the agent act once."""
        self._history.disturbances = self.episode.disturbances
        self.episode.step()
        self._history.add(self.episode.info, self.episode.reward)

    def frame(self, width: int, height: int, speed: str) -> Group:
        """Draw what is to be seen now, in so many columns and lines."""
        columns, lines = min(width, _LARGEST[0]), min(height, _LARGEST[1])
        status = self._status(speed)
        status.truncate(max(columns, 1), overflow="ellipsis")
        lines -= 1
        if columns < _SMALLEST[0] or lines < _SMALLEST[1]:
            return Group(status)
        size = (_SHARPNESS * columns, _SHARPNESS * 2 * lines)
        if self._renderer is None or self._renderer.size != size:
            self._renderer = self._renderer_of(self.episode, size)
        picture = self._renderer.frame(self.episode.arm_env.arm_joints, self._history)
        blocks = picture.reshape(2 * lines, _SHARPNESS, columns, _SHARPNESS, 3)
        return Group(half_blocks(blocks.mean(axis=(1, 3)).astype(np.uint8)), status)

    def _status(self, speed: str) -> Text:
        episode = self.episode
        alarms = [*episode.disturbances, *(["left its domain"] if episode.failure else [])]
        duration = episode.steps * episode.period
        figures = (
            f"{episode.time:.2f} of {duration:.2f} s  return {episode.earned:.1f} of "
            f"{episode.steps_made}  error {episode.info['tracking_error']:.2f}°  {speed}"
        )
        alarm = f" {' + '.join(alarms).upper()} " if alarms else ""
        return Text.assemble(figures, "  ", (alarm, "bold white on red"), no_wrap=True)


def show_in_terminal(
    console: Console,
    episodes: Iterable[Episode],
    renderer_of: Callable[[Episode, tuple[int, int]], Renderer],
    speed: float,
) -> None:
    """Show episodes one after the other, live; into a pipe their figures alone.

    Args:
        console: where to.
        episodes: made one by one.
        renderer_of: makes what draws an episode in a size, (width, height) [pixels].
        speed: times real time.
    """
    # FORCE_COLOR and the like make a terminal of a pipe in the eyes of rich.
    live = sys.stdout.isatty() and console.is_terminal and not console.is_dumb_terminal
    if live and console.color_system is not None:
        _show_live(console, (_Show(episode, renderer_of) for episode in episodes), speed)
        return
    for episode in episodes:
        while not episode.ended:
            episode.step()
        typer.echo(episode.report())


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


def _show_live(console: Console, shows: Iterable[_Show], speed: float) -> None:
    reports: list[str] = []
    show: _Show | None = None
    words = f"{speed:g}×"
    try:
        with Live(console=console, screen=True, auto_refresh=False) as live:
            for show in shows:
                pace = _Pace(speed, show.episode.period)
                next_frame = time.monotonic()
                while not show.episode.ended:
                    pace.wait()
                    show.step()
                    now = time.monotonic()
                    if now < next_frame and not show.episode.ended:
                        continue
                    words = str(pace)
                    frame: Any = show.frame(console.width, console.height, words)
                    live.update(frame, refresh=True)
                    # At most half of the time goes into drawing.
                    next_frame = now + max(_FRAME_TIME, 2 * (time.monotonic() - now))
                reports.append(show.episode.report())
    except KeyboardInterrupt:
        reports.append("Stopped.")
    # The screen of before is back; what was seen last stays on it.
    if show is not None:
        console.print(show.frame(console.width, console.height - 2 - len(reports), words))
    typer.echo("\n".join(reports))
