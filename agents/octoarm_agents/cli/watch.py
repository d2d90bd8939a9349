"""`octoarm watch`."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from octoarm_agents.cli.actors import ACTOR_HELP, Actor, find_actor
from octoarm_agents.cli.options import (
    EpisodeSeed,
    NoiseSize,
    OtherArm,
    PushSize,
    need_extra,
    number_between,
    read_body,
)
from octoarm_agents.cli.pictures import (
    CameraName,
    Exaggeration,
    PictureHeight,
    PictureWidth,
    Zoom,
    make_renderer,
)

if TYPE_CHECKING:
    from rich.console import Console

    from octoarm_agents.policies.episode import Episode

__all__ = ["watch"]

_FASTEST = 100.0
_BY_HAND = 60_000
"""Steps of an episode that the mouse leads, ten minutes."""


def _check_speed(value: float) -> float:
    if not 0 < value <= _FASTEST:
        raise typer.BadParameter(f"{value} is not above 0 and at most {_FASTEST:g}.")
    return value


def _check_view(value: str) -> str:
    if value not in ("auto", "window", "terminal"):
        raise typer.BadParameter(f"{value!r} is not one of auto, window, terminal.")
    return value


def watch(
    policy: Annotated[
        str | None,
        typer.Argument(
            help=f"{ACTOR_HELP} Without one, the mouse leads the base.", show_default=False
        ),
    ] = None,
    episodes: Annotated[
        int, typer.Option(help="Number of episodes.", callback=number_between(1, 4096))
    ] = 1,
    steps: Annotated[
        int | None,
        typer.Option(
            help="Control periods of an episode.",
            callback=number_between(10, 1_000_000),
            show_default=f"500, {_BY_HAND:,} with the mouse",
        ),
    ] = None,
    seed: EpisodeSeed = 0,
    speed: Annotated[
        float,
        typer.Option(
            help=f"Times real time, above 0 and at most {_FASTEST:g}.", callback=_check_speed
        ),
    ] = 1.0,
    push: PushSize = 0.0,
    noise: NoiseSize = 0.0,
    arm: OtherArm = None,
    target: Annotated[
        str | None,
        typer.Option(
            help="What the mouse is to follow, without a policy.", show_default="quadratic"
        ),
    ] = None,
    view: Annotated[
        str,
        typer.Option(
            help="window, terminal, or auto: a window where there is a display.",
            metavar="NAME",
            callback=_check_view,
        ),
    ] = "auto",
    width: PictureWidth = 960,
    height: PictureHeight = 720,
    camera: CameraName = "perspective",
    zoom: Zoom = 1.0,
    exaggeration: Exaggeration = 1.0,
) -> None:
    """Watch an agent drive the arm, or drive it yourself.

    In a window: the arm in three dimensions, the base and its target, the strain of the 80
    springs. Drag to look around, wheel to zoom, space to pause, + and - for the speed; h shows
    all keys. Without POLICY drag with the left button to swing the arm, with the right one to
    look around.

    In the terminal: the same picture in half blocks, and the figures of the episode below.

    Where standard output is no terminal with colours and there is no window, nothing waits: the
    figures of each episode are printed. Ctrl-C ends the show.
    """
    if policy is None:
        if view == "terminal":
            raise typer.BadParameter(
                "the mouse needs a window: name a POLICY.", param_hint="'--view'"
            )
        actor = _by_hand("quadratic" if target is None else target, arm)
    else:
        if target is not None:
            raise typer.BadParameter(
                "an agent has its own target; this is the mouse's.", param_hint="'--target'"
            )
        actor = find_actor(policy, arm)
    needs_window = view == "window" or policy is None
    settings = {"push": push, "noise": noise, "steps": steps}
    if steps is None:
        settings["steps"] = 500 if policy else _BY_HAND
    size = (width, height)
    try:
        if needs_window or (view == "auto" and _can_open_a_window()):
            picture = (size, camera, zoom, exaggeration)
            reason = _watch_window(actor, episodes, seed, speed, settings, picture)
            if not reason:
                return
            typer.echo(f"{reason}.", err=True)
            if needs_window:
                raise typer.Exit(1)
        _watch_terminal(actor, episodes, seed, speed, settings, (camera, zoom, exaggeration))
    except KeyboardInterrupt:
        typer.echo("Stopped.")


def _can_open_a_window() -> bool:
    if find_spec("pygame") is None:
        return False
    if sys.platform in ("win32", "darwin"):
        return True
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def _by_hand(target: str, arm: Path | None) -> Actor:
    from octoarm_agents.common.environment import TARGETS

    if target not in TARGETS:
        raise typer.BadParameter(
            f"{target!r} is not one of {', '.join(TARGETS)}.", param_hint="'--target'"
        )
    return Actor("by hand", None, read_body(arm), {"target": target})


def _watch_window(
    actor: Actor,
    episodes: int,
    seed: int,
    speed: float,
    settings: dict[str, Any],
    picture: tuple[tuple[int, int], str, float, float],
) -> str:
    """Show it in a window; say why that cannot be, or nothing."""
    with need_extra("render"):
        from octoarm_env.rendering.window import WindowError
    from octoarm_agents.cli.watch_window import MousePolicy, show_in_window
    from octoarm_agents.policies.episode import Episode

    env = actor.make_env(settings["steps"])
    mouse = MousePolicy(env.get_wrapper_attr("action_range")) if actor.policy is None else None
    policy = mouse or actor.policy or "hold"

    def renderer_of(episode: Episode) -> Any:
        return make_renderer(episode, actor.name, *picture)

    def played() -> Iterator[Episode]:
        for index in range(episodes):
            yield Episode(policy, env, seed=seed + index, **settings)

    try:
        show_in_window(played(), renderer_of, speed=speed, mouse=mouse)
    except WindowError as error:
        return str(error)
    finally:
        env.close()
    return ""


def _watch_terminal(
    actor: Actor,
    episodes: int,
    seed: int,
    speed: float,
    settings: dict[str, Any],
    picture: tuple[str, float, float],
) -> None:
    from rich.console import Console

    from octoarm_agents.cli.watch_terminal import UPPER_HALF, show_in_terminal
    from octoarm_agents.policies.episode import Episode

    console = Console(highlight=False)
    _check_encoding(console, UPPER_HALF)
    env = actor.make_env(settings["steps"])

    camera, zoom, exaggeration = picture

    def renderer_of(episode: Episode, size: tuple[int, int]) -> Any:
        # Few pixels: the arm fills them.
        closer = (camera, 1.7 * zoom, exaggeration)
        return make_renderer(episode, actor.name, size, *closer, overlay=False)

    def played() -> Iterator[Episode]:
        for index in range(episodes):
            yield Episode(actor.policy or "hold", env, seed=seed + index, **settings)

    try:
        show_in_terminal(console, played(), renderer_of, speed)
    finally:
        env.close()


def _check_encoding(console: Console, needed: str) -> None:
    try:
        needed.encode(console.encoding)
    except (UnicodeEncodeError, LookupError):
        typer.echo(
            f"Standard output is {console.encoding}, which cannot show the arm: "
            "set PYTHONIOENCODING=utf-8.",
            err=True,
        )
        raise typer.Exit(1) from None
