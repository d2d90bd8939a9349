"""`octoarm record`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from octoarm_agents.cli.options import (
    EpisodeSeed,
    EpisodeSteps,
    NoiseSize,
    OtherBody,
    PushSize,
    need_extra,
    number,
    refused,
    result_file,
)
from octoarm_agents.cli.pictures import (
    CameraName,
    Exaggeration,
    PictureSide,
    Speed,
    Zoom,
    make_camera,
)
from octoarm_agents.cli.policy_names import PolicyName, find_policy
from octoarm_agents.common.progress import progress_bar

_KINDS = (".mp4", ".gif", ".png", ".rrd")


def record(
    policy: PolicyName,
    out: Annotated[Path, result_file(f"What to write, by its end: {', '.join(_KINDS)}.")],
    steps: EpisodeSteps = 500,
    seed: EpisodeSeed = 0,
    push: PushSize = 0.0,
    noise: NoiseSize = 0.0,
    arm: OtherBody = None,
    fps: Annotated[
        float | None,
        number("Frames of a second of the film.", 1.0, 240.0, show_default="50, of a .gif 25"),
    ] = None,
    speed: Speed = 1.0,
    width: PictureSide = 640,
    height: PictureSide = 480,
    camera: CameraName = "perspective",
    zoom: Zoom = 1.0,
    exaggeration: Exaggeration = 1.0,
    overlay: Annotated[
        bool, typer.Option(help="Figures, phase portrait of the base and strains as well.")
    ] = True,
) -> None:
    """Record an episode: a film (.mp4, .gif), its last picture (.png), or all of it (.rrd).

    A .rrd holds arm, springs, base, commands, errors, rewards and events, 10 kB a step, to look
    at any moment in the Rerun viewer, `rerun FILE.rrd`; what the options say of pictures does
    not touch it. No display is needed. The same call records the same. A file appears whole or
    not at all: an interrupted run leaves nothing behind.
    """
    from octoarm_agents.viewing.episode import Episode
    from octoarm_agents.viewing.film import (
        FILMS,
        check_film,
        default_fps,
        film_frames,
        frame_count,
        picture_end,
        write_film,
    )

    named, kind, frames = find_policy(policy, arm), out.suffix.lower(), 0
    if kind not in _KINDS:
        raise typer.BadParameter(
            f"{out} does not end in one of {', '.join(_KINDS)}.", param_hint="'--out'"
        )
    rate = default_fps(out) if fps is None else fps
    env = named.make_env(steps)
    try:
        episode = Episode(
            named.policy, env, seed=seed, steps=steps, push=push, noise=noise, title=policy
        )
        if kind == ".rrd":
            with need_extra("rerun"):
                from octoarm_agents.viewing.rerun_streams import log_episode, recording_file
        else:
            with need_extra("render"):
                look = make_camera(camera, zoom, exaggeration)
                renderer = episode.renderer((width, height), look, overlay=overlay)
        if kind in FILMS:
            with refused("--out"):
                count = frame_count(steps, episode.control_period, rate, speed)
                check_film(out, renderer.size, rate, count)
        with progress_bar(steps, "recording", unit=" steps") as bar:
            episode.progress = bar.update
            if kind == ".rrd":
                with recording_file(out) as recording:
                    log_episode(recording, episode)
            elif kind == ".png":
                picture_end(episode, renderer, out)
            else:
                drawn = film_frames(episode, renderer, fps=rate, speed=speed)
                with need_extra("render"):
                    frames = write_film(out, drawn, renderer.size, rate)
    except KeyboardInterrupt:
        typer.echo("Stopped; nothing was written.", err=True)
        raise typer.Exit(130) from None
    except OSError as error:  # also where logging is switched off
        typer.echo(f"cannot write {out}: {error}.", err=True)
        raise typer.Exit(1) from None
    finally:
        env.close()
    typer.echo(episode.report())
    if frames:
        typer.echo(f"{frames} frames, {frames / rate:.2f} s")
    typer.echo(f"Wrote {out}, {out.stat().st_size / 1e6:.2f} MB.")
