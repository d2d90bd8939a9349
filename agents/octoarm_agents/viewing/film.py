"""An episode as a film: `.mp4` (H.264) or `.gif`, through the ffmpeg that imageio-ffmpeg brings."""

from __future__ import annotations

import io
import os
import subprocess
import tempfile
from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from octoarm_agents.common.files import atomic_file
from octoarm_agents.viewing.episode import Episode

if TYPE_CHECKING:
    from octoarm_env.rendering.renderer import Renderer


Frame = NDArray[np.uint8]

FILMS = (".mp4", ".gif")

_FASTEST_GIF = 50.0
"""Most frames of a second of a GIF: viewers show one that lasts less than 2/100 s for 1/10 s."""

_LARGEST_GIF = 2_000_000_000
"""Most bytes of a GIF's frames, 4 a pixel: all are held in memory for their common colours."""

# The kind of colours is written down: players else guess it from the size of the picture.
_MP4 = [
    "-vf",
    "scale=out_color_matrix=bt709:out_range=tv,format=yuv420p,"
    "setparams=range=tv:colorspace=bt709:color_primaries=bt709:color_trc=bt709",
    *("-c:v", "libx264", "-crf", "15", "-movflags", "+faststart"),
]
# One table of colours for the whole film, made from what moves; ordered dithering, which stays
# where it is from frame to frame, so that water that stands still costs nothing.
_GIF = [
    "-filter_complex",
    "split[a][b];[a]palettegen=stats_mode=full[p];"
    "[b][p]paletteuse=dither=bayer:bayer_scale=5:diff_mode=rectangle",
    *("-c:v", "gif", "-loop", "0"),
]


def default_fps(path: Path) -> float:
    """Frames of a second of a film: 50, and 25 of a GIF, whose times are in hundredths."""
    return 25.0 if path.suffix.lower() == ".gif" else 50.0


def check_film(path: Path, size: tuple[int, int], fps: float, frames: int) -> None:
    """Raise a ValueError, which says what to change, if no such film can be made.

    Args:
        path: of the film, `.mp4` or `.gif`.
        size: (width, height) [pixels]; even numbers for `.mp4`.
        fps: frames of a second; at most 50 for `.gif`.
        frames: of the film; of a `.gif` as many as have room in 2 GB, 4 bytes a pixel.
    """
    width, height = size
    if path.suffix.lower() == ".mp4":
        if width % 2 or height % 2:
            raise ValueError(f"size = {width}×{height}: H.264 needs an even width and height")
        return
    if fps > _FASTEST_GIF:
        raise ValueError(
            f"fps = {fps:g} is too fast for a .gif, at most {_FASTEST_GIF:g}: choose .mp4"
        )
    most = _LARGEST_GIF // (4 * width * height)
    if frames > most:
        raise ValueError(
            f"{frames:,} frames of {width}×{height} are too many for a .gif, at most {most:,}: "
            "choose .mp4, fewer steps, fewer frames a second or a smaller picture"
        )


def frame_count(steps: int, control_period: float, fps: float, speed: float) -> int:
    """Number of frames of an episode; the arguments are those of `frame_steps`."""
    return int(steps * control_period * fps / speed + 1e-9) + 1


def frame_steps(steps: int, control_period: float, fps: float, speed: float) -> Iterator[int]:
    """Give the step that each frame shows, from 0, the reset, to at most `steps`.

    Args:
        steps: control periods of the episode.
        control_period: seconds of each.
        fps: frames of a second of the film.
        speed: seconds of the arm in a second of the film.
    """
    for frame in range(frame_count(steps, control_period, fps, speed)):
        # What is a whole number but for its rounding is one.
        yield int(frame * speed / fps / control_period + 1e-9)


def film_frames(
    episode: Episode, renderer: Renderer, *, fps: float, speed: float
) -> Iterator[Frame]:
    """Let an episode run, and draw its film; an arm that leaves its domain ends it.

    Args:
        episode: at its beginning.
        renderer: draws it.
        fps: frames of a second of the film.
        speed: seconds of the arm in a second of the film.
    """
    for shown in frame_steps(episode.steps, episode.control_period, fps, speed):
        while episode.steps_made < shown and not episode.ended:
            episode.step()
        yield renderer.frame(episode.joints, episode.history)
        if episode.history.failure:
            return
    while not episode.ended:  # the steps after the last frame
        episode.step()


def write_film(path: Path, frames: Iterable[Frame], size: tuple[int, int], fps: float) -> int:
    """Write a film; the file is there when all of it has been written, and only then.

    Args:
        path: of the film, `.mp4` or `.gif`.
        frames: (height, width, 3), all frames.
        size: (width, height) [pixels].
        fps: frames of a second.

    Returns:
        Number of frames.

    Raises:
        OSError: the file cannot be written.
    """
    import imageio_ffmpeg

    try:
        ffmpeg = imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError as error:
        raise OSError(str(error)) from None
    # The library's own writer does not look at how ffmpeg ended: a full disk would cut a film
    # short without a word.
    command = [ffmpeg, "-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"]
    command += ["-s", f"{size[0]}x{size[1]}", "-r", str(Fraction(fps).limit_denominator(100_000))]
    command += ["-i", "-", *(_MP4 if path.suffix.lower() == ".mp4" else _GIF)]
    with atomic_file(path) as file, tempfile.TemporaryFile() as messages:
        encoder = subprocess.Popen(
            [*command, str(file)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=messages,
            # Ctrl-C is for this process alone.
            process_group=0 if os.name == "posix" else -1,
        )
        try:
            count, whole = _send(encoder, frames)
            encoder.wait()
        finally:
            encoder.kill()  # if this was interrupted; else it has ended
            encoder.wait()
        if encoder.returncode or not whole:
            messages.seek(0)
            raise OSError(_reason(messages.read(), encoder.returncode))
    return count


def _send(encoder: subprocess.Popen[bytes], frames: Iterable[Frame]) -> tuple[int, bool]:
    """Send frames: how many the encoder has taken, and whether those are all."""
    count, whole, pipe = 0, True, encoder.stdin
    assert pipe is not None
    try:
        for frame in frames:
            try:
                pipe.write(frame.data)
            except OSError:
                whole = False
                break
            count += 1
    except BaseException:
        encoder.kill()  # it is not to finish what is cut short
        raise
    finally:
        try:
            pipe.close()
        except OSError:  # of what was still to be sent
            whole = False
    return count, whole


def _reason(messages: bytes, status: int) -> str:
    """Say in a line why ffmpeg gave up."""
    # What is in brackets before its words are ffmpeg's parts and their addresses.
    lines = [line.rpartition("] ")[2] for line in messages.decode(errors="replace").splitlines()]
    words = [line.strip().rstrip(".") for line in lines]
    return f"ffmpeg: {next(filter(None, words), f'ended with status {status}')}"


def picture_end(episode: Episode, renderer: Renderer, path: Path) -> None:
    """Let an episode run, and write a picture of its end, `.png`.

    Raises:
        OSError: the file cannot be written.
    """
    from octoarm_env.rendering.toolkit import pygame

    while not episode.ended:
        episode.step()
    picture = renderer.draw(episode.joints, episode.history)
    # Not into the file itself: pygame says nothing of a full disk.
    encoded = io.BytesIO()
    pygame.image.save(picture, encoded, "picture.png")
    with atomic_file(path) as file:
        file.write_bytes(encoded.getvalue())
