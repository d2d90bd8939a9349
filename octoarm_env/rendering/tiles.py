"""Many pictures in one."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from octoarm_env.arguments import whole_number


def tile_images(
    images: Sequence[NDArray[np.uint8]], *, columns: int | None = None, gap: int = 0
) -> NDArray[np.uint8]:
    """Put pictures side by side, row by row.

    Args:
        images: at least one, each (height, width, 3), all of one size; what
            `OctoArmVectorEnv.render` gives.
        columns: how many are in a row; None: as many as make the whole nearly square.
        gap: black pixels between them.

    Returns:
        One picture, (rows × height + gaps, columns × width + gaps, 3); black where none is left.

    Raises:
        ValueError, TypeError: no pictures, pictures of different sizes, or a wrong number.
    """
    frames = [np.asarray(image) for image in images]
    if not frames:
        raise ValueError("images is empty: expected at least one picture")
    for index, frame in enumerate(frames):
        if frame.ndim != 3 or frame.shape[2] != 3 or frame.dtype != np.uint8:
            raise TypeError(
                f"images[{index}] is {frame.dtype} {frame.shape}: expected uint8 (height, width, 3)"
            )
        if frame.shape != frames[0].shape:
            raise ValueError(
                f"images[{index}] has shape {frame.shape}, images[0] {frames[0].shape}: "
                "expected one size"
            )
    height, width, _ = frames[0].shape
    if columns is None:
        columns = max(1, round(math.sqrt(len(frames) * height / width)))
    columns = min(whole_number("columns", columns, 1), len(frames))
    gap = whole_number("gap", gap, 0)
    rows = -(-len(frames) // columns)
    whole = np.zeros((rows * (height + gap) - gap, columns * (width + gap) - gap, 3), np.uint8)
    for index, frame in enumerate(frames):
        top, left = index // columns * (height + gap), index % columns * (width + gap)
        whole[top : top + height, left : left + width] = frame
    return whole
