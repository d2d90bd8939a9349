"""`octoarm record`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from octoarm_agents.cli.actors import ACTOR_HELP, find_actor
from octoarm_agents.cli.options import (
    EpisodeSeed,
    EpisodeSteps,
    NoiseSize,
    OtherArm,
    PushSize,
    need_extra,
    number_between,
    output_file,
)
from octoarm_agents.cli.pictures import (
    CameraName,
    Exaggeration,
    PictureHeight,
    PictureWidth,
    Zoom,
    make_renderer,
)
from octoarm_agents.common.progress import progress_bar

__all__ = ["record"]

_MOST_FRAMES = 1_000_000


def record(
    policy: Annotated[str, typer.Argument(help=ACTOR_HELP, show_default=False)],
    out: Annotated[
        Path,
        typer.Option(
            help="The film, .mp4 or .gif, or a picture of the end, .png.", callback=output_file
        ),
    ],
    steps: EpisodeSteps = 500,
    seed: EpisodeSeed = 0,
    push: PushSize = 0.0,
    noise: NoiseSize = 0.0,
    arm: OtherArm = None,
    fps: Annotated[
        float | None,
        typer.Option(
            help="Frames of a second of the film.",
            callback=number_between(1.0, 240.0),
            show_default="50, of a .gif 25",
        ),
    ] = None,
    speed: Annotated[
        float,
        typer.Option(
            help="Seconds of the arm in a second of the film.", callback=number_between(0.01, 100.0)
        ),
    ] = 1.0,
    width: PictureWidth = 640,
    height: PictureHeight = 480,
    camera: CameraName = "perspective",
    zoom: Zoom = 1.0,
    exaggeration: Exaggeration = 1.0,
    overlay: Annotated[
        bool, typer.Option(help="Figures, phase portrait of the base and strains as well.")
    ] = True,
) -> None:
    """Film an agent that drives the arm; no display is needed.

    The same call gives the same frames. A film appears whole or not at all: an interrupted one
    leaves nothing behind.
    """
    from octoarm_agents import recording
    from octoarm_agents.policies.episode import Episode

    actor = find_actor(policy, arm)
    if out.suffix.lower() not in (*recording.FORMATS, ".png"):
        known = ", ".join((*recording.FORMATS, ".png"))
        raise typer.BadParameter(f"{out} does not end in one of {known}.", param_hint="'--out'")
    rate = recording.default_fps(out) if fps is None else fps
    if out.suffix.lower() == ".gif" and rate > recording.FASTEST_GIF:
        raise typer.BadParameter(
            f"{rate:g} is too fast for a .gif, at most {recording.FASTEST_GIF:g}: choose .mp4.",
            param_hint="'--fps'",
        )
    env = actor.make_env(steps)
    try:
        assert actor.policy is not None
        episode = Episode(actor.policy, env, seed=seed, steps=steps, push=push, noise=noise)
        renderer = make_renderer(
            episode, policy, (width, height), camera, zoom, exaggeration, overlay=overlay
        )
        frames = round(steps * episode.period * rate / speed) + 1
        if frames > _MOST_FRAMES:
            raise typer.BadParameter(
                f"{frames:,} frames are too many, at most {_MOST_FRAMES:,}: choose fewer --steps, "
                "a lower --fps or a higher --speed.",
                param_hint="'--out'",
            )
        most = recording.longest_gif(renderer.size)
        if out.suffix.lower() == ".gif" and frames > most:
            raise typer.BadParameter(
                f"{frames:,} frames of {width}×{height} are too many for a .gif, at most {most:,}: "
                "choose .mp4, fewer --steps, a lower --fps or a smaller picture.",
                param_hint="'--out'",
            )
        with progress_bar(steps, "filming", unit=" steps") as bar:
            if out.suffix.lower() == ".png":
                recording.picture_end(episode, renderer, out, progress=bar.update)
            else:
                with (
                    need_extra("render"),
                    recording.open_film(out, renderer.size, rate) as film,
                ):
                    recording.film_episode(
                        episode, renderer, film, fps=rate, speed=speed, progress=bar.update
                    )
    except KeyboardInterrupt:
        typer.echo("Stopped; no film was written.", err=True)
        raise typer.Exit(130) from None
    except OSError as error:
        typer.echo(f"cannot write {out}: {error}.", err=True)
        raise typer.Exit(1) from None
    except ValueError as error:
        raise typer.BadParameter(f"{error}.") from None
    finally:
        env.close()
    typer.echo(episode.report())
    if out.suffix.lower() != ".png":
        seconds = film.frames / rate
        typer.echo(f"{film.frames} frames, {seconds:.2f} s, {out.stat().st_size / 1e6:.2f} MB")
    typer.echo(f"Wrote {out}.")
