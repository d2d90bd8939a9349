"""Options of commands that draw the arm."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from octoarm_agents.cli.options import number

if TYPE_CHECKING:
    from octoarm_env.rendering import Camera


PictureSide = Annotated[int, number("Pixels.", 64, 4096, "pixels")]
CameraName = Annotated[
    Literal["perspective", "front", "side", "top", "base"], typer.Option(help="From where.")
]
# Within this no camera comes to the end of its range.
Zoom = Annotated[float, number("Times the camera's own.", 0.2, 6.0)]
Exaggeration = Annotated[
    float,
    number("Draw the arm's ways to the side so many times as large; it says so.", 1.0, 50.0),
]
Speed = Annotated[float, number("Seconds of the arm in a second.", 0.01, 100.0)]


def make_camera(name: str, zoom: float, exaggeration: float) -> Camera:
    """Give the camera that the options ask for."""
    from octoarm_env.rendering import CAMERAS

    return dataclasses.replace(CAMERAS[name].zoomed(zoom), exaggeration=exaggeration)
