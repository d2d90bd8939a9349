"""What environments need to be seen; pygame is not touched before a picture is asked for."""

from __future__ import annotations

import sys
from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from octoarm_env.arguments import flag
from octoarm_env.arrays import Float
from octoarm_env.parameters import ArmParameters
from octoarm_env.rendering.camera import find_camera, picture_size
from octoarm_env.rendering.history import History

if TYPE_CHECKING:
    from octoarm_env.rendering.renderer import Renderer, Surfaces
    from octoarm_env.rendering.window import Window


_MEMORY = 256_000_000
"""Bytes that the renderers of different arms and targets may take; those used last are kept."""


def render_fps(control_period: float) -> float:
    """Give the frames of a second in which an arm is as fast as it is, one a step."""
    frames = round(1.0 / control_period, 6)
    return int(frames) if frames == int(frames) else frames


def warn_without_mode() -> None:
    """Say that there is nothing to render, as Gymnasium's own environments do."""
    gym.logger.warn(
        "render was called, but render_mode is None: "
        'make the environment with render_mode="rgb_array".'
    )


class Subject(Protocol):
    """The settings of an environment that is to be seen."""

    @property
    def arm(self) -> ArmParameters:
        """The body."""

    @property
    def title(self) -> str:
        """Of the picture."""

    @property
    def text(self) -> str:
        """The same for settings that look the same."""


class Scene(NamedTuple):
    """What is in a picture.

    Attributes:
        joints: `OctoArmEnv.arm_joints`, (N + 1, 4, 3) [m].
        task: gives the target (K, 2) and the base rotation at an action of 1 [degrees]; asked once.
    """

    joints: Float
    task: Callable[[], tuple[Float, float]]


class Pictures:
    """The pictures of one or more environments.

    Args:
        settings: of each environment.
        render_modes: that there are.
        render_mode, width, height, camera, overlay: as `OctoArmEnv` takes them.

    Raises:
        ValueError, TypeError: a wrong argument, by name, with its value and what is allowed.
    """

    def __init__(
        self,
        settings: Sequence[Subject],
        render_mode: Any,
        render_modes: Sequence[str],
        width: Any,
        height: Any,
        camera: Any,
        overlay: Any,
    ) -> None:
        if render_mode is not None and render_mode not in render_modes:
            known = ", ".join(repr(mode) for mode in render_modes)
            raise ValueError(f"render_mode = {render_mode!r}: expected None or one of {known}")
        self._size, self._camera = picture_size(width, height), find_camera(camera)
        self._overlay, self._settings = flag("overlay", overlay), settings
        self._renderers: OrderedDict[str, Renderer] = OrderedDict()
        self._surfaces: Surfaces | None = None
        self._window: Window | None = None
        self._warned = False

    def frame(self, index: int, history: History, scene: Scene) -> NDArray[np.uint8]:
        """Give the picture of an environment, (height, width, 3).

        Args:
            index: which.
            history: its episode's past.
            scene: what is to be seen.

        Raises:
            gymnasium.error.ResetNeeded: no episode has begun.
            gymnasium.error.DependencyNotInstalled: there is no pygame.
        """
        _check_begun(history)
        return self._renderer(index, scene).frame(scene.joints, history)

    def show(self, history: History, scene: Scene, *, again: bool = False) -> None:
        """Show the first environment in a window, in the time that its steps take.

        Args:
            history: its episode's past.
            scene: what is to be seen.
            again: show what was shown already, without waiting.

        Raises:
            gymnasium.error.ResetNeeded, gymnasium.error.DependencyNotInstalled: as `frame`.
            octoarm_env.rendering.window.WindowError: there is no display.
        """
        from octoarm_env.rendering.window import WITHOUT_DISPLAY, Window

        _check_begun(history)
        if self._window is None or self._window.lost:
            renderer = self._renderer(0, scene)
            self._window = Window(renderer, "OctoArm", history.control_period)
            if not self._window.seen:
                # Not a warning, which checkers of environments may take for an error.
                print(
                    f"The window is nowhere, no display was found. {WITHOUT_DISPLAY}.",
                    file=sys.stderr,
                )
        self._window.show(scene.joints, history, again=again)
        if self._window.closed and not self._warned:
            self._warned = True
            gym.logger.warn(
                "The window was closed, or another one opened: the arm goes on unseen, "
                "as fast as it can."
            )

    def close(self) -> None:
        """Close the window, and let go of what drew."""
        if self._window is not None:
            self._window.close()
            self._window = None
        self._renderers.clear()
        self._surfaces = None

    def _renderer(self, index: int, scene: Scene) -> Renderer:
        from octoarm_env.rendering.renderer import Renderer, Surfaces

        self._surfaces = self._surfaces or Surfaces(self._size)
        settings = self._settings[index]
        text = settings.text
        if text not in self._renderers:
            self._renderers[text] = Renderer(
                settings.arm,
                *scene.task(),
                settings.title,
                size=self._size,
                camera=self._camera,
                overlay=self._overlay,
                surfaces=self._surfaces,
            )
            kept = max(1, _MEMORY // self._renderers[text].memory)
            while len(self._renderers) > kept:
                self._renderers.popitem(last=False)
        self._renderers.move_to_end(text)
        return self._renderers[text]

    def __getstate__(self) -> dict[str, Any]:
        """Without what draws, which is made anew when it is needed."""
        return self.__dict__ | {"_renderers": OrderedDict(), "_surfaces": None, "_window": None}


def _check_begun(history: History) -> None:
    if not history.began:
        raise ResetNeeded("render was called before reset: there is no arm to be seen")
