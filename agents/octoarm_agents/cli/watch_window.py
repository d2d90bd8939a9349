"""The show of `octoarm watch` in a window."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
import typer

from octoarm_agents.cli.options import need_extra

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from octoarm_agents.policies.episode import Episode
    from octoarm_env.rendering.renderer import Renderer
    from octoarm_env.rendering.window import Window

__all__ = ["MousePolicy", "show_in_window"]


class MousePolicy:
    """Leans the base where the mouse has dragged it.

    Attributes:
        window: in which it is dragged; None: nowhere yet.
    """

    parameter_count = 0

    def __init__(self, action_range: float) -> None:
        self._range = action_range
        self.window: Window | None = None

    def predict(
        self,
        observation: Any = None,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Any]:
        """Give the action that leans the base there, (2,)."""
        del observation, episode_start, deterministic
        angles = np.zeros(2)
        if self.window is not None:
            angles = self.window.renderer.tilt_towards(*self.window.lean.tolist())
        return np.clip(angles / self._range, -1.0, 1.0).astype(np.float32), state


def show_in_window(
    episodes: Iterable[Episode],
    renderer_of: Callable[[Episode], Renderer],
    *,
    speed: float,
    mouse: MousePolicy | None = None,
) -> None:
    """Show episodes one after the other, until the last has ended or the window is closed.

    Args:
        episodes: made one by one.
        renderer_of: makes what draws the first of them; the others are of the same arm.
        speed: times real time.
        mouse: the agent, where the mouse leads the base.

    Raises:
        octoarm_env.rendering.window.WindowError: there is no display.
    """
    from octoarm_env.rendering.history import History

    with need_extra("render"):
        from octoarm_env.rendering.window import WITHOUT_DISPLAY, Window, WindowError

    window: Window | None = None
    try:
        for episode in episodes:
            history = History(episode.period)
            history.begin(episode.info)
            if window is None:
                renderer = renderer_of(episode)
                caption = f"OctoArm · {renderer.title}"
                lead = mouse is not None
                window = Window(renderer, caption, episode.period, speed=speed, lead=lead)
                if not window.seen:
                    raise WindowError(
                        f"no window can be opened: no display was found. {WITHOUT_DISPLAY}"
                    )
                if mouse is not None:
                    mouse.window = window
            joints = episode.arm_env.arm_joints
            window.show(joints, history)
            while not episode.ended and not window.closed:
                history.disturbances = episode.disturbances
                episode.step()
                history.add(episode.info, episode.reward)
                joints = episode.arm_env.arm_joints
                window.show(joints, history)
            if episode.ended:
                typer.echo(episode.report())
            elif episode.steps_made:
                typer.echo(
                    f"seed {episode.seed}: closed after {episode.time:.2f} s, "
                    f"return {episode.earned:.1f} of {episode.steps_made}"
                )
            if window.closed:
                return
        if window is not None:
            window.hold(joints, history)
    finally:
        if window is not None:
            window.close()
