"""An episode as a film: `.mp4` (H.264) or `.gif`, through the ffmpeg that imageio-ffmpeg brings."""

from __future__ import annotations

import io
import os
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from octoarm_agents.common.files import atomic_file

if TYPE_CHECKING:
    from collections.abc import Callable

    from octoarm_agents.policies.episode import Episode
    from octoarm_env.rendering.renderer import Renderer

__all__ = [
    "FASTEST_GIF",
    "FORMATS",
    "Film",
    "default_fps",
    "film_episode",
    "frame_steps",
    "longest_gif",
    "open_film",
    "picture_end",
]

FORMATS = (".mp4", ".gif")
FASTEST_GIF = 50.0
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


def longest_gif(size: tuple[int, int]) -> int:
    """Most frames of a GIF of this size."""
    return _LARGEST_GIF // (4 * size[0] * size[1])


def frame_steps(steps: int, control_period: float, fps: float, speed: float) -> NDArray[np.intp]:
    """Give the step that each frame shows, from 0, the reset, to at most `steps`.

    Args:
        steps: control periods of the episode.
        control_period: seconds of each.
        fps: frames of a second of the film.
        speed: seconds of the arm in a second of the film.
    """
    count = int(steps * control_period * fps / speed + 1e-9) + 1
    times = np.arange(count) * speed / fps
    shown: NDArray[np.intp] = np.floor(times / control_period + 1e-9).astype(np.intp)
    return shown


class _BrokenPipeError(OSError):
    """ffmpeg reads no more."""


class Film:
    """A film that frames are added to.

    Attributes:
        frames: added so far.
    """

    def __init__(self, pipe: IO[bytes], size: tuple[int, int]) -> None:
        self._pipe, self._size, self.frames = pipe, size, 0

    def add(self, frame: NDArray[np.uint8]) -> None:
        """Add a frame, (height, width, 3).

        Raises:
            ValueError: it has another size than the film.
            OSError: the film cannot be written.
        """
        width, height = self._size
        if frame.shape != (height, width, 3) or frame.dtype != np.uint8:
            raise ValueError(
                f"frame is {frame.dtype} {frame.shape}: expected uint8 ({height}, {width}, 3)"
            )
        try:
            self._pipe.write(np.ascontiguousarray(frame).data)
        except OSError as error:
            raise _BrokenPipeError(*error.args) from None
        self.frames += 1


@contextmanager
def open_film(path: Path, size: tuple[int, int], fps: float) -> Iterator[Film]:
    """Open a film; the file is there when the block has ended well, and only then.

    Args:
        path: of the film, `.mp4` or `.gif`.
        size: (width, height) [pixels]; even numbers for `.mp4`.
        fps: frames of a second; at most `FASTEST_GIF` for `.gif`.

    Raises:
        ValueError: another kind of file, an odd size, or a GIF that is too fast.
        OSError: the file cannot be written, or no frame was added.
    """
    import imageio_ffmpeg

    if path.suffix.lower() not in FORMATS:
        raise ValueError(f"{path}: expected a file name that ends in {' or '.join(FORMATS)}")
    moving = path.suffix.lower() == ".mp4"
    if moving and (size[0] % 2 or size[1] % 2):
        raise ValueError(f"size = {size[0]}×{size[1]}: H.264 needs an even width and height")
    if not moving and fps > FASTEST_GIF:
        raise ValueError(f"fps = {fps:g}: a GIF shows at most {FASTEST_GIF:g} frames a second")
    try:
        ffmpeg = imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError as error:
        raise OSError(str(error)) from None
    # The library's own writer does not look at how ffmpeg ended: a full disk would cut a film
    # short without a word.
    command = [ffmpeg, "-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"]
    command += ["-s", f"{size[0]}x{size[1]}", "-r", str(Fraction(fps).limit_denominator(100_000))]
    command += ["-i", "-", *(_MP4 if moving else _GIF)]
    with atomic_file(path) as file, tempfile.TemporaryFile() as messages:
        encoder = subprocess.Popen(
            [*command, str(file)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=messages,
            # Ctrl-C is for this process alone.
            process_group=0 if os.name == "posix" else -1,
        )
        assert encoder.stdin is not None
        film, whole = Film(encoder.stdin, size), True
        try:
            yield film
        except _BrokenPipeError:
            whole = False
        except BaseException:
            encoder.kill()
            raise
        finally:
            try:
                encoder.stdin.close()
            except OSError:  # of what was still to be sent
                whole = False
            try:
                encoder.wait()
            finally:
                encoder.kill()  # if this was interrupted; else it has ended
                encoder.wait()
        if whole and not film.frames:
            raise OSError("no frame was added")
        if encoder.returncode or not whole:
            messages.seek(0)
            raise OSError(_reason(messages.read(), encoder.returncode))


def _reason(messages: bytes, status: int) -> str:
    """Say in a line why ffmpeg gave up."""
    # What is in brackets before its words are ffmpeg's parts and their addresses.
    lines = [line.rpartition("] ")[2] for line in messages.decode(errors="replace").splitlines()]
    words = [line.strip().rstrip(".") for line in lines]
    return f"ffmpeg: {next(filter(None, words), f'ended with status {status}')}"


def film_episode(
    episode: Episode,
    renderer: Renderer,
    film: Film,
    *,
    fps: float,
    speed: float,
    progress: Callable[[int], object] | None = None,
) -> None:
    """Let an episode run, and film it; an arm that leaves its domain ends the film.

    Args:
        episode: at its beginning.
        renderer: draws it.
        film: what the frames are added to.
        fps: frames of a second of the film.
        speed: seconds of the arm in a second of the film.
        progress: called with 1 after each step.
    """
    from octoarm_env.rendering.history import History

    history = History(episode.period)
    history.begin(episode.info)
    for shown in frame_steps(episode.steps, episode.period, fps, speed).tolist():
        while episode.steps_made < shown and not episode.ended:
            history.disturbances = episode.disturbances
            episode.step()
            history.add(episode.info, episode.reward)
            if progress is not None:
                progress(1)
        film.add(renderer.frame(episode.arm_env.arm_joints, history))
        if episode.failure:
            return
    while not episode.ended:  # the steps after the last frame
        episode.step()
        if progress is not None:
            progress(1)


def picture_end(
    episode: Episode,
    renderer: Renderer,
    path: Path,
    *,
    progress: Callable[[int], object] | None = None,
) -> None:
    """Let an episode run, and write a picture of its end, `.png`.

    Raises:
        OSError: the file cannot be written.
    """
    from octoarm_env.rendering.history import History
    from octoarm_env.rendering.toolkit import pygame

    history = History(episode.period)
    history.begin(episode.info)
    while not episode.ended:
        history.disturbances = episode.disturbances
        episode.step()
        history.add(episode.info, episode.reward)
        if progress is not None:
            progress(1)
    picture = renderer.draw(episode.arm_env.arm_joints, history)
    # Not into the file itself: pygame says nothing of a full disk.
    encoded = io.BytesIO()
    pygame.image.save(picture, encoded, "picture.png")
    with atomic_file(path) as file:
        file.write_bytes(encoded.getvalue())
