"""Options of commands that draw the arm."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Annotated

import typer

from octoarm_agents.cli.options import need_extra, number_between

if TYPE_CHECKING:
    from octoarm_agents.policies.episode import Episode
    from octoarm_env.rendering.renderer import Renderer

__all__ = ["CameraName", "Exaggeration", "PictureHeight", "PictureWidth", "Zoom", "make_renderer"]

_CAMERAS = ("perspective", "front", "side", "top", "base")


def _check_camera(name: str) -> str:
    if name not in _CAMERAS:
        raise typer.BadParameter(f"{name!r} is not one of {', '.join(_CAMERAS)}.")
    return name


PictureWidth = Annotated[
    int, typer.Option(help="Pixels.", callback=number_between(64, 4096, "pixels"))
]
PictureHeight = Annotated[
    int, typer.Option(help="Pixels.", callback=number_between(64, 4096, "pixels"))
]
CameraName = Annotated[
    str,
    typer.Option(
        help=f"From where: {', '.join(_CAMERAS)}.", metavar="NAME", callback=_check_camera
    ),
]
Zoom = Annotated[
    # Within this no camera comes to the end of its range.
    float,
    typer.Option(help="Times the camera's own.", callback=number_between(0.2, 6.0)),
]
Exaggeration = Annotated[
    float,
    typer.Option(
        help="Draw the arm's ways to the side so many times as large; the picture says so.",
        callback=number_between(1.0, 50.0),
    ),
]


def make_renderer(
    episode: Episode,
    title: str,
    size: tuple[int, int],
    camera: str,
    zoom: float,
    exaggeration: float,
    *,
    overlay: bool = True,
) -> Renderer:
    """Make what draws an episode; without pygame say how to install it, and exit."""
    with need_extra("render"):
        from octoarm_env.rendering.renderer import Renderer
    from octoarm_env.rendering import CAMERAS

    chosen = dataclasses.replace(CAMERAS[camera].zoomed(zoom), exaggeration=exaggeration)
    env = episode.arm_env
    return Renderer(
        episode.parameters,
        env.orbit,
        env.action_range,
        title,
        size=size,
        camera=chosen,
        overlay=overlay,
    )
