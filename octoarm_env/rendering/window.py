"""A window in which an arm is seen while it moves, from where the mouse wants it."""

from __future__ import annotations

import dataclasses
import os
import time
import weakref
from typing import Any, ClassVar

import numpy as np

from octoarm_env.arrays import Float
from octoarm_env.rendering.camera import CAMERAS, LARGEST
from octoarm_env.rendering.history import History
from octoarm_env.rendering.renderer import Renderer
from octoarm_env.rendering.toolkit import pygame

_FRAME_TIME = 1 / 60
"""Least time between frames [s]."""
_SPEEDS = (0.01, 100.0)
_SMALLEST = 160
_TURN = 0.4
"""Degrees around the arm for a pixel of the mouse."""
_EXAGGERATIONS = (1.0, 2.0, 4.0, 8.0)
_ARROWS = {
    pygame.K_LEFT: (-0.1, 0.0),
    pygame.K_RIGHT: (0.1, 0.0),
    pygame.K_UP: (0.0, 0.1),
    pygame.K_DOWN: (0.0, -0.1),
}
_LETTERS = {
    pygame.K_SPACE: " ",
    pygame.K_PERIOD: ".",
    pygame.K_ESCAPE: "q",
    pygame.K_1: "1",
    pygame.K_KP_PLUS: "+",
    pygame.K_KP_MINUS: "-",
}
"""Keys that count wherever they are; the others by what they write."""
_HELP = (
    "space  pause      .  one step",
    "+ −  speed        1  real time",
    "wheel  zoom       r  camera of before",
    "c  next camera    x  exaggerate sideways",
    "o  figures        q  close",
)


WITHOUT_DISPLAY = (
    'Without a display use render_mode="rgb_array", or the commands octoarm record and '
    "octoarm watch --view terminal"
)


class WindowError(RuntimeError):
    """No window can be opened."""


class Window:
    """Shows steps in the time that they take.

    Left button: drag around the arm (right button, where the left one leads the base). Wheel: zoom.
    Keys: `h` shows them.

    Args:
        renderer: draws; its camera is that of before.
        caption: of the window.
        control_period: seconds of a step.
        speed: times real time, 0.01 to 100.
        lead: whether the left button and the arrow keys lead the base; see `lean`.

    Attributes:
        closed: whether the user has closed it, or another has taken its place; then nothing is
            shown, and nothing waits.
        paused: whether the time stands.
        speed: times real time.
        seen: whether there is a display that it can be seen on.
        lean: (2,), where the mouse leads the base: to the right and away, a disc of radius 1.

    Raises:
        WindowError: there is no display.

    A process has one window at a time: one that is open when another opens counts as closed.
    """

    _open: ClassVar[weakref.ref[Window] | None] = None

    def __init__(
        self,
        renderer: Renderer,
        caption: str,
        control_period: float,
        *,
        speed: float = 1.0,
        lead: bool = False,
    ) -> None:
        self._renderer, self._camera = renderer, renderer.camera
        self._period, self._lead = control_period, lead
        self.speed, self._speed = speed, speed
        self.closed = self.paused = self._help = self._one_step = self._stale = False
        self.lean = np.zeros(2)
        self._held: int | None = None
        self._looked = False
        other = Window._open() if Window._open is not None else None
        if other is not None:
            other.closed = True  # pygame has one window at a time: this is it now
        try:
            pygame.display.init()
            if pygame.display.get_driver() != "wayland":  # which cannot do without
                # OpenGL would be loaded to copy a picture, and with it its LLVM, beside which
                # PyTorch's Triton crashes.
                os.environ.setdefault("SDL_FRAMEBUFFER_ACCELERATION", "0")
            self._screen = pygame.display.set_mode(renderer.size, pygame.RESIZABLE)
        except pygame.error as error:
            pygame.display.quit()
            raise WindowError(f"no window can be opened: {error}. {WITHOUT_DISPLAY}") from None
        # Where it finds no display, SDL may open a window that is nowhere.
        driver = pygame.display.get_driver()
        self.seen = driver != "offscreen" or driver == os.environ.get("SDL_VIDEODRIVER")
        Window._open = weakref.ref(self)
        pygame.display.set_caption(caption)
        self._due = self._next_frame = time.monotonic()

    @property
    def renderer(self) -> Renderer:
        """What draws; another one after the window's size has changed."""
        return self._renderer

    @property
    def lost(self) -> bool:
        """Whether somebody else has closed all windows of this process, with pygame.quit()."""
        return not self.closed and pygame.display.get_surface() is not self._screen

    def show(self, joints: Float, history: History, *, again: bool = False) -> None:
        """Show a step when its time has come; while paused, wait.

        Args:
            joints: `OctoArmEnv.arm_joints`, (N + 1, 4, 3) [m].
            history: of the episode, which has begun.
            again: the step was shown already: draw it at once, and do not wait.
        """
        self._one_step, self._stale = False, self._stale or again
        if not again:
            self._due += self._period / self.speed
        while not self.closed:
            self._react()
            if self.closed:
                return
            now = time.monotonic()
            if self._stale or (now >= self._next_frame and (self.paused or now >= self._due)):
                self._draw(joints, history)
            if self._one_step:
                break
            if self.paused:
                self._due = time.monotonic()
                time.sleep(_FRAME_TIME / 2)
                continue
            left = self._due - time.monotonic()
            if left <= 0:
                break
            time.sleep(min(left, _FRAME_TIME / 2))
        now = time.monotonic()
        if now - self._due > 0.1:  # too slow, or stopped for a while: what is lost is lost
            self._due = now

    def hold(self, joints: Float, history: History) -> None:
        """Show an end, which can be looked at from all sides, until a key is pressed.

        Those keys that change what is seen do not count.
        """
        while not self.closed:
            self._draw(joints, history, "the end; space closes")
            time.sleep(_FRAME_TIME)
            self._looked = False
            if pygame.KEYDOWN in self._react() and not self._looked:
                return

    def close(self) -> None:
        """Close the window; nothing happens if it is closed."""
        if not self.closed:
            self.closed = True
            pygame.display.quit()

    def _draw(self, joints: Float, history: History, note: str = "") -> None:
        state = "paused" if self.paused else f"{self.speed:.3g}×"
        note = note or f"{state}   h: keys"
        self._renderer.notes = (note, *(_HELP if self._help else ()))
        picture = self._renderer.draw(joints, history)
        self._screen.blit(picture, picture.get_rect(center=self._screen.get_rect().center))
        pygame.display.flip()
        self._stale = False
        self._next_frame = time.monotonic() + _FRAME_TIME * 0.9

    def _react(self) -> list[int]:
        """Do what the user asked for; give the types of what happened."""
        if self.lost:
            self.closed = True
            return []
        events = pygame.event.get()
        for event in events:
            if event.type == pygame.QUIT:
                self.close()
                break
            if event.type == pygame.KEYDOWN:
                self._key(event)
            elif event.type == pygame.VIDEORESIZE:
                self._resize(event.w, event.h)
            elif event.type == pygame.MOUSEWHEEL:
                self._renderer.camera = self._renderer.camera.zoomed(1.15**event.y)
                self._stale = True
            elif event.type == pygame.MOUSEBUTTONDOWN and event.button in (1, 3):
                self._held = event.button
            elif event.type == pygame.MOUSEBUTTONUP and event.button == self._held:
                self._held = None
            elif event.type == pygame.MOUSEMOTION and self._held is not None:
                self._drag(*event.rel)
            if self.closed:
                break
        return [event.type for event in events]

    def _drag(self, right: float, down: float) -> None:
        if self._lead and self._held == 1:
            self._shift(np.array([right, -down]) / (0.25 * self._renderer.size[1]))
            return
        self._renderer.camera = self._renderer.camera.orbited(_TURN * right, _TURN * down)
        self._stale = True

    def _shift(self, way: Float) -> None:
        lean = self.lean + way
        self.lean = lean / max(1.0, float(np.hypot(*lean)))

    def _resize(self, width: int, height: int) -> None:
        size = (min(max(width, _SMALLEST), LARGEST), min(max(height, _SMALLEST), LARGEST))
        if size != self._renderer.size:
            self._renderer = self._renderer.resized(*size)
            self._screen = pygame.display.get_surface() or self._screen
            self._stale = True

    def _key(self, event: Any) -> None:  # noqa: PLR0912, a branch a key
        if self._lead and event.key in _ARROWS:
            self._shift(np.array(_ARROWS[event.key]))
            return
        letter = _LETTERS.get(event.key, getattr(event, "unicode", ""))
        match letter:
            case " ":
                self.paused = not self.paused
            case ".":
                self.paused = self._one_step = True
            case "1":
                self.speed = 1.0
            case "+" | "=":
                self.speed = min(2 * self.speed, _SPEEDS[1])
            case "-":
                self.speed = max(self.speed / 2, _SPEEDS[0])
            case "c":
                self._next_camera()
            case "h":
                self._help = not self._help
            case "o":
                self._renderer.overlay = not self._renderer.overlay
            case "q":
                self.close()
            case "r":
                self._renderer.camera, self.speed = self._camera, self._speed
                self.lean = np.zeros(2)
            case "x":
                self._exaggerate()
            case _:
                return
        self._stale = True
        self._looked = letter in "chorx"

    def _next_camera(self) -> None:
        cameras = list(CAMERAS.values())
        factor = self._renderer.camera.exaggeration
        here = dataclasses.replace(self._renderer.camera, exaggeration=1.0)
        index = cameras.index(here) + 1 if here in cameras else 0
        chosen = cameras[index % len(cameras)]
        self._renderer.camera = dataclasses.replace(chosen, exaggeration=factor)

    def _exaggerate(self) -> None:
        now = self._renderer.camera.exaggeration
        larger = next((factor for factor in _EXAGGERATIONS if factor > now), _EXAGGERATIONS[0])
        self._renderer.camera = dataclasses.replace(self._renderer.camera, exaggeration=larger)
