"""An episode as a film: `.mp4` (H.264) or `.gif`, through the ffmpeg that imageio-ffmpeg brings."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from octoarm_agents.files import atomic_file

if TYPE_CHECKING:
    from collections.abc import Callable

    from octoarm_agents.policies.episode import Episode
    from octoarm_env.rendering.renderer import Renderer

__all__ = [
    "FORMATS",
    "LONGEST_GIF",
    "Film",
    "default_fps",
    "film_episode",
    "frame_steps",
    "open_film",
    "picture_end",
]

FORMATS = (".mp4", ".gif")
LONGEST_GIF = 1500
"""Most frames of a GIF: all are held in memory for their common colours."""

# One table of colours for the whole film, made from what moves; ordered dithering, which stays
# where it is from frame to frame, so that water that stands still costs nothing.
_GIF = (
    "split[a][b];[a]palettegen=stats_mode=full[p];"
    "[b][p]paletteuse=dither=bayer:bayer_scale=5:diff_mode=rectangle"
)


def default_fps(path: Path) -> float:
    """Frames of a second of a film: 50, and 25 of a GIF, whose times are in hundredths."""
    return 25.0 if path.suffix == ".gif" else 50.0


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


class Film:
    """A film that frames are added to.

    Attributes:
        frames: added so far.
    """

    def __init__(self, writer: Generator[None, Any, None], size: tuple[int, int]) -> None:
        self._writer, self._size, self.frames = writer, size, 0

    def add(self, frame: NDArray[np.uint8]) -> None:
        """Add a frame, (height, width, 3).

        Raises:
            ValueError: it has another size than the film.
        """
        width, height = self._size
        if frame.shape != (height, width, 3) or frame.dtype != np.uint8:
            raise ValueError(
                f"frame is {frame.dtype} {frame.shape}: expected uint8 ({height}, {width}, 3)"
            )
        self._writer.send(np.ascontiguousarray(frame))
        self.frames += 1


@contextmanager
def open_film(path: Path, size: tuple[int, int], fps: float) -> Iterator[Film]:
    """Open a film; the file is there when the block has ended well, and only then.

    Args:
        path: of the film, `.mp4` or `.gif`.
        size: (width, height) [pixels]; even numbers for `.mp4`.
        fps: frames of a second.

    Raises:
        ValueError: another kind of file, or an odd size.
        OSError: the file cannot be written.
    """
    import imageio_ffmpeg

    if path.suffix not in FORMATS:
        raise ValueError(f"{path}: expected a file name that ends in {' or '.join(FORMATS)}")
    moving = path.suffix == ".mp4"
    if moving and (size[0] % 2 or size[1] % 2):
        raise ValueError(f"size = {size[0]}×{size[1]}: H.264 needs an even width and height")
    options: dict[str, Any] = (
        {"quality": 7, "output_params": ["-movflags", "+faststart"]}
        if moving
        else {
            "codec": "gif",
            "pix_fmt_out": "pal8",
            "quality": None,
            "output_params": ["-filter_complex", _GIF, "-loop", "0"],
        }
    )
    with atomic_file(path) as file:
        writer = imageio_ffmpeg.write_frames(
            str(file), size, fps=fps, macro_block_size=1, ffmpeg_log_level="error", **options
        )
        writer.send(None)
        film = Film(writer, size)
        try:
            yield film
        finally:
            writer.close()
        # The end of ffmpeg is not looked at by the library.
        found = imageio_ffmpeg.count_frames_and_secs(str(file))[0] if file.stat().st_size else 0
        if not 0 < found <= film.frames:
            raise OSError(f"{path}: ffmpeg wrote {found} of {film.frames} frames")


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
        episode.step()
        history.add(episode.info, episode.reward)
        if progress is not None:
            progress(1)
    picture = renderer.draw(episode.arm_env.arm_joints, history)
    with atomic_file(path) as file:
        pygame.image.save(picture, str(file))
