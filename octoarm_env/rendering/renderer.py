"""Pictures of an arm in an episode."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from octoarm_env.arrays import Float
from octoarm_env.parameters import ArmParameters
from octoarm_env.rendering.body import Body
from octoarm_env.rendering.camera import Camera, View, find_camera, picture_size
from octoarm_env.rendering.history import History
from octoarm_env.rendering.panels import Line, Panels, status_lines
from octoarm_env.rendering.toolkit import pygame
from octoarm_env.rendering.water import draw_water

_FINEST = 2048
"""Largest side that is drawn twice as large first, for smooth edges [pixels]."""


class Surfaces:
    """What is drawn on: surfaces that every picture is drawn on anew.

    Args:
        size: of the pictures, (width, height) [pixels].

    Attributes:
        fine: pixels of the canvas for one of the picture, across.
        canvas: for shapes.
        picture: the finished picture.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self.fine = 2 if max(size) <= _FINEST else 1
        self.canvas = pygame.Surface((size[0] * self.fine, size[1] * self.fine), depth=32)
        self.picture = pygame.Surface(size, depth=32)


class Renderer:
    """Draws the arm in three dimensions, in water, on its base, with what it is doing beside it.

    The pointer above the base leans as the base does, against the arm; the curve that its end is to
    follow is the target. The arm's four rows of springs have four colours. At the bottom the strain
    of every spring, a cell each; the scale of colours is that of a square root.

    Args:
        parameters: the body.
        orbit: the target, (K, 2) [degrees].
        action_range: largest angle of the base [degrees].
        title: whose picture this is.
        size: (width, height) [pixels], 16 to 4096.
        camera: from where, a `Camera` or a name in `CAMERAS`; it may be changed.
        overlay: figures, phase portrait and strains as well; there must be room for them, 288×216
            at least.
        surfaces: to draw on, of that size; renderers that do not draw at once may share one.

    A picture depends on the arguments of `draw` and the camera alone. It needs no display.
    """

    def __init__(
        self,
        parameters: ArmParameters,
        orbit: Float,
        action_range: float,
        title: str = "",
        *,
        size: tuple[int, int] = (640, 480),
        camera: Camera | str | None = None,
        overlay: bool = True,
        surfaces: Surfaces | None = None,
    ) -> None:
        self.camera = find_camera(camera)
        self.size = picture_size(*size)
        self.title, self.overlay = title, overlay
        self.notes: tuple[str, ...] = ()
        """More lines among the figures."""
        self._parameters, self._orbit, self._range = parameters, orbit, action_range
        surfaces = surfaces or Surfaces(self.size)
        self._fine, self._canvas, self._picture = surfaces.fine, surfaces.canvas, surfaces.picture
        self._body = Body(parameters, orbit, action_range, self._fine)
        self._stage = self._body.stage
        count = parameters.compartments
        self._panels = Panels(self.size, self._fine, orbit, 1.06 * action_range, count)
        self._water = self._canvas.copy()
        self._view: View | None = None
        self._drawn_for: tuple[Camera, bool] | None = None

    def resized(self, width: int, height: int) -> Renderer:
        """Give a renderer of the same for another size."""
        renderer = Renderer(
            self._parameters,
            self._orbit,
            self._range,
            self.title,
            size=(width, height),
            camera=self.camera,
            overlay=self.overlay,
        )
        renderer.notes = self.notes
        return renderer

    def draw(self, joints: Float, history: History) -> pygame.Surface:
        """Draw a picture.

        Args:
            joints: `OctoArmEnv.arm_joints`, (N + 1, 4, 3) [m].
            history: of the episode, which has begun.

        Returns:
            The picture; it is drawn over by the next one.
        """
        view = self._look()
        self._canvas.blit(self._water, (0, 0))
        self._body.draw(self._canvas, view, joints, history, self.camera.exaggeration)
        if self.overlay:
            lengths = np.linalg.norm(np.diff(joints, axis=0), axis=2)
            strains = lengths / self._parameters.rest_length - 1.0
            labels = self._panels.draw(self._canvas, history, strains, self._lines(history))
        if self._fine == 1:
            self._picture.blit(self._canvas, (0, 0))
        else:
            pygame.transform.smoothscale(self._canvas, self.size, self._picture)
        if self.overlay:
            self._panels.write(self._picture, labels)
        return self._picture

    def frame(self, joints: Float, history: History) -> NDArray[np.uint8]:
        """Draw a picture as an array of its own, (height, width, 3), 0 to 255."""
        pixels = pygame.image.tobytes(self.draw(joints, history), "RGB")
        width, height = self.size
        return np.frombuffer(pixels, np.uint8).reshape(height, width, 3).copy()

    def tilt_towards(self, right: float, upwards: float) -> Float:
        """Give base angles that lean the arm towards a side of the picture, (2,) [degrees].

        Args:
            right: to the right, in parts of the action range.
            upwards: away from the viewer, in parts of the action range.
        """
        view = self._look()
        up = self._stage.up
        away = -view.back + (view.back @ up) * up
        away /= np.linalg.norm(away)
        size = min(float(np.hypot(right, upwards)), 1.0)
        if size == 0.0:
            return np.zeros(2)
        lean = (right * view.right + upwards * away) / np.hypot(right, upwards)
        # The plane's normal R e_z is (sin φ, -sin θ cos φ, cos θ cos φ).
        angles = np.array([-lean[1], lean[0]])
        longest = float(np.abs(angles).max()) or 1.0
        return size * self._range * angles / longest

    def _lines(self, history: History) -> list[Line]:
        factor = self.camera.exaggeration
        notes = (f"sideways ×{factor:.3g}", *self.notes) if factor != 1.0 else self.notes
        return status_lines(self.title, history, notes)

    @property
    def memory(self) -> int:
        """Bytes that this takes, the surfaces apart."""
        return self._water.get_pitch() * self._water.get_height()

    def _look(self) -> View:
        """Give the view of the camera as it stands now, with the water drawn for it."""
        key = (self.camera, self.overlay)
        if self._view is None or self._drawn_for != key:
            bottom = self._panels.bottom * self._fine if self.overlay else 0.0
            self._view = View(self.camera, self._stage, self._canvas.get_size(), bottom)
            draw_water(self._water, self._view, self._stage)
            self._drawn_for = key
        return self._view
