"""The show of `octoarm watch` in the terminal."""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
import typer
from rich.console import Console
from rich.live import Live
from rich.text import Text

from octoarm_agents.policies.episode import Episode
from octoarm_agents.policies.terminal import Moment, Scene, draw_frame
from octoarm_agents.reservoir.orbit import orbit_distance
from octoarm_env.rendering.history import LATE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float = NDArray[np.float64]

__all__ = ["TerminalEpisode", "show_in_terminal"]

_FRAME_TIME = 0.04
"""Least time between frames [s]."""


class TerminalEpisode(Episode):
    """An episode that remembers what the terminal shows of it.

    Args:
        title: of the frames.
        *arguments: as for `Episode`.
        **settings: as for `Episode`.
    """

    def __init__(self, title: str, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        duration = self.steps * self.period
        rest_length = self.parameters.rest_length
        self.scene = Scene(title, self.arm_env.orbit, rest_length, duration, self.steps)
        late = max(2, round(LATE / self.period))
        self._trace: deque[Float] = deque(maxlen=late)
        self._shapes: deque[Float] = deque(maxlen=late)
        self._reach = self._strain = 0.0
        self._remember()

    def step(self) -> None:
        """Let the agent act once."""
        super().step()
        self._remember()

    def moment(self, speed: str) -> Moment:
        """What is to be seen now; `speed` is that of the show, in words."""
        trace, shapes = np.array(self._trace), np.array(self._shapes)
        alarms = [*self.disturbances, *(["left its domain"] if self.failure else [])]
        return Moment(
            time=self.time,
            trace=trace,
            target=self.info["target"],
            arm=self.arm_env.arm_positions,
            sway=np.stack((shapes.min(axis=0), shapes.max(axis=0))),
            reach=self._reach,
            lengths=self.lengths,
            strain=self._strain,
            earned=self.earned,
            possible=float(self.steps_made),
            error=float(self.info["tracking_error"]),
            distance=float(orbit_distance(trace[-1:], self.scene.orbit)[0]),
            speed=speed,
            disturbance=" + ".join(alarms).upper(),
        )

    def _remember(self) -> None:
        self._trace.append(np.asarray(self.info["base_angles"]))
        across = self.arm_env.arm_positions[:, 0]
        self._shapes.append(across)
        self._reach = max(self._reach, float(np.abs(across).max()))
        # The most strained twentieth, next to the base, would leave no colours for the others.
        strains = np.sort(np.abs(self.lengths / self.scene.rest_length - 1))
        self._strain = max(self._strain, float(strains[int(0.95 * (len(strains) - 1))]))


def show_in_terminal(console: Console, episodes: Iterable[TerminalEpisode], speed: float) -> None:
    """Show episodes one after the other, live; into a pipe the last frame of each.

    Args:
        console: where to.
        episodes: made one by one.
        speed: times real time.
    """
    # FORCE_COLOR and the like make a terminal of a pipe in the eyes of rich.
    if sys.stdout.isatty() and console.is_terminal and not console.is_dumb_terminal:
        _show_live(console, episodes, speed)
    else:
        _print_all(console, episodes)


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


def _draw(console: Console, episode: TerminalEpisode, speed: str, height: int) -> Text:
    colour = console.color_system is not None and not console.no_color
    moment = episode.moment(speed)
    return draw_frame(episode.scene, moment, console.width, max(1, height), colour=colour)


def _print_all(console: Console, episodes: Iterable[TerminalEpisode]) -> None:
    for episode in episodes:
        while not episode.ended:
            episode.step()
        console.print(_draw(console, episode, "unlimited", console.height - 1))
        typer.echo(f"{episode.report()}\n")


def _show_live(console: Console, episodes: Iterable[TerminalEpisode], speed: float) -> None:
    reports: list[str] = []
    episode: TerminalEpisode | None = None
    words = f"{speed:g}×"
    try:
        with Live(console=console, screen=True, auto_refresh=False) as live:
            for episode in episodes:
                pace = _Pace(speed, episode.period)
                next_frame = time.monotonic()
                while not episode.ended:
                    pace.wait()
                    episode.step()
                    now = time.monotonic()
                    if now < next_frame and not episode.ended:
                        continue
                    words = str(pace)
                    live.update(_draw(console, episode, words, console.height), refresh=True)
                    # At most half of the time goes into drawing.
                    next_frame = now + max(_FRAME_TIME, 2 * (time.monotonic() - now))
                reports.append(episode.report())
    except KeyboardInterrupt:
        reports.append("Stopped.")
    # The screen of before is back; what was seen last stays on it.
    if episode is not None:
        console.print(_draw(console, episode, words, console.height - 2 - len(reports)))
    typer.echo("\n".join(reports))
