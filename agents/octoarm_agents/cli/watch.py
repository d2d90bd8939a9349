"""`octoarm watch`."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from octoarm_agents.cli.options import (
    EpisodeSeed,
    MouseTarget,
    NoiseSize,
    OtherBody,
    PushSize,
    need_extra,
    number,
)
from octoarm_agents.cli.pictures import (
    CameraName,
    Exaggeration,
    PictureSide,
    Speed,
    Zoom,
    make_camera,
)
from octoarm_agents.cli.policy_names import POLICY_HELP, find_policy
from octoarm_agents.common.progress import progress_bar

if TYPE_CHECKING:
    from octoarm_agents.viewing.episode import Episode
    from octoarm_env.rendering import Camera


_BY_HAND = 60_000
"""Steps of an episode that the mouse leads, ten minutes."""


def watch(
    policy: Annotated[
        str | None,
        typer.Argument(
            help=f"{POLICY_HELP} Without one, the mouse leads the base.", show_default=False
        ),
    ] = None,
    episodes: Annotated[int, number("Number of episodes.", 1, 4096)] = 1,
    steps: Annotated[
        int | None,
        number(
            "Control periods of an episode.",
            10,
            1_000_000,
            show_default=f"500, {_BY_HAND:,} with the mouse",
        ),
    ] = None,
    seed: EpisodeSeed = 0,
    speed: Speed = 1.0,
    push: PushSize = 0.0,
    noise: NoiseSize = 0.0,
    arm: OtherBody = None,
    target: MouseTarget = None,
    view: Annotated[
        Literal["auto", "window", "terminal", "rerun", "browser"],
        typer.Option(help="Where; auto: in a window where there is a display, or the terminal."),
    ] = "auto",
    width: PictureSide = 960,
    height: PictureSide = 720,
    camera: CameraName = "perspective",
    zoom: Zoom = 1.0,
    exaggeration: Exaggeration = 1.0,
) -> None:
    """Watch a policy drive the arm, or drive it yourself.

    In a window: drag to look around, wheel to zoom, space to pause; h shows all keys. Without
    POLICY drag with the left button to swing the arm, with the right one to look around. In the
    terminal: the same picture in half blocks; into a pipe go the figures of each episode alone.

    rerun and browser show all of one episode, to look at any moment: in the viewer of Rerun, or
    in a browser on this machine. Ctrl-C ends the show. `octoarm record` writes files instead.
    """
    by_hand = policy is None
    if by_hand and view not in ("auto", "window"):
        raise typer.BadParameter("the mouse needs a window: name a POLICY.", param_hint="'--view'")
    if not by_hand and target is not None:
        raise typer.BadParameter(
            "an agent has its own target; this is the mouse's.", param_hint="'--target'"
        )
    if view in ("rerun", "browser") and episodes > 1:
        raise typer.BadParameter(f"--view {view} shows one.", param_hint="'--episodes'")
    named = find_policy(policy or f"hold/{target or 'quadratic'}", arm)
    mouse = None
    if by_hand:
        with need_extra("render"):
            from octoarm_agents.viewing.window import MousePolicy
        mouse = MousePolicy(named.settings["action_range"])
        named, view = replace(named, name="by hand", policy=mouse), "window"
    steps = steps or (_BY_HAND if by_hand else 500)
    env = named.make_env(steps)

    def played() -> Iterator[Episode]:
        from octoarm_agents.viewing.episode import Episode

        for index in range(episodes):
            yield Episode(
                named.policy,
                env,
                seed=seed + index,
                steps=steps,
                push=push,
                noise=noise,
                title=named.name,
            )

    try:
        if view in ("rerun", "browser"):
            _show_in_rerun(next(played()), in_browser=view == "browser")
            return
        look = make_camera(camera, zoom, exaggeration)
        if view == "window" or (view == "auto" and _can_open_a_window()):
            with need_extra("render"):
                from octoarm_agents.viewing.window import show_in_window
                from octoarm_env.rendering.window import WindowError
            try:
                show_in_window(played(), (width, height), look, speed=speed, mouse=mouse)
                return
            except WindowError as error:
                typer.echo(f"{error}.", err=True)
            if view == "window":
                raise typer.Exit(1)
        _show_in_terminal(played(), look, speed)
    except KeyboardInterrupt:
        typer.echo("Stopped.")
    finally:
        env.close()


def _can_open_a_window() -> bool:
    if find_spec("pygame") is None:
        return False
    if sys.platform in ("win32", "darwin"):
        return True
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def _show_in_terminal(episodes: Iterator[Episode], camera: Camera, speed: float) -> None:
    from rich.console import Console

    from octoarm_agents.viewing.terminal import UPPER_HALF, show_in_terminal

    console = Console(highlight=False)
    try:
        UPPER_HALF.encode(console.encoding)
    except (UnicodeEncodeError, LookupError):
        typer.echo(
            f"Standard output is {console.encoding}, which cannot show the arm: "
            "set PYTHONIOENCODING=utf-8.",
            err=True,
        )
        raise typer.Exit(1) from None
    with need_extra("render"):
        show_in_terminal(console, episodes, camera, speed)


def _show_in_rerun(episode: Episode, *, in_browser: bool) -> None:
    """Show all of an episode in Rerun's viewer, or in a browser until Ctrl-C."""
    with need_extra("rerun"):
        from octoarm_agents.viewing.rerun_streams import RecordingError, log_episode
        from octoarm_agents.viewing.rerun_viewers import recording_in_browser, recording_in_viewer

    try:
        with progress_bar(episode.steps, "recording", unit=" steps") as bar:
            episode.progress = bar.update
            if in_browser:
                recording, address = recording_in_browser(open_browser=sys.stdout.isatty())
                log_episode(recording, episode)
            else:
                with recording_in_viewer() as recording:
                    log_episode(recording, episode)
    except RecordingError as error:
        typer.echo(f"cannot show it: {error}. octoarm record writes files.", err=True)
        raise typer.Exit(1) from None
    typer.echo(episode.report())
    if in_browser:
        typer.echo(f"Look at it in a browser: {address}")
        typer.echo("Ctrl-C ends it.")
        while True:
            time.sleep(3600)
