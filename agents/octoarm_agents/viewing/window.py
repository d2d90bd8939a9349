"""Episodes in a window, and the mouse that leads the base."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from octoarm_agents.policies.rollout import HoldPolicy
from octoarm_env.arrays import Float
from octoarm_env.rendering.window import WITHOUT_DISPLAY, Window, WindowError

if TYPE_CHECKING:
    from octoarm_agents.viewing.episode import Episode
    from octoarm_env.rendering import Camera


class MousePolicy(HoldPolicy):
    """Leans the base where the mouse has dragged it.

    Attributes:
        window: in which it is dragged; None: nowhere yet.
    """

    def __init__(self, action_range: float) -> None:
        self._range = action_range
        self.window: Window | None = None

    @property
    def held(self) -> Float:
        """The action that leans the base there, (2,)."""
        if self.window is None:
            return super().held
        angles = self.window.renderer.tilt_towards(*self.window.lean.tolist())
        return np.clip(angles / self._range, -1.0, 1.0)


def show_in_window(
    episodes: Iterable[Episode],
    size: tuple[int, int],
    camera: Camera,
    *,
    speed: float,
    mouse: MousePolicy | None = None,
) -> None:
    """Show episodes one after the other, until the last has ended or the window is closed.

    Args:
        episodes: made one by one, of the same arm.
        size: of the window, (width, height) [pixels].
        camera: from where.
        speed: times real time.
        mouse: the policy, where the mouse leads the base.

    Raises:
        octoarm_env.rendering.window.WindowError: there is no display.
    """
    window: Window | None = None
    try:
        for episode in episodes:
            if window is None:
                window = Window(
                    episode.renderer(size, camera),
                    f"OctoArm · {episode.title}",
                    episode.control_period,
                    speed=speed,
                    lead=mouse is not None,
                )
                if not window.seen:
                    raise WindowError(
                        f"no window can be opened: no display was found. {WITHOUT_DISPLAY}"
                    )
                if mouse is not None:
                    mouse.window = window
            window.show(episode.joints, episode.history)
            while not episode.ended and not window.closed:
                episode.step()
                window.show(episode.joints, episode.history)
            if episode.ended:
                print(episode.report())
            elif episode.steps_made:
                print(
                    f"seed {episode.seed}: closed after {episode.history.time:.2f} s, "
                    f"return {episode.history.total:.1f} of {episode.steps_made}"
                )
            if window.closed:
                return
        if window is not None:
            window.hold(episode.joints, episode.history)
    finally:
        if window is not None:
            window.close()
