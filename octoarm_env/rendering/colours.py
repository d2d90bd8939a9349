"""What colours mean, the same in every picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Colour = tuple[int, int, int]
"""Red, green and blue, 0 to 255."""

SPRINGS: tuple[Colour, ...] = ((240, 228, 66), (86, 180, 233), (0, 190, 130), (213, 80, 0))
"""Colours of springs 1 to 4, told apart by the colour-blind too (after Okabe and Ito)."""
FLESH: tuple[Colour, Colour] = ((250, 164, 136), (230, 138, 112))
"""Colours of compartments, in turn."""
BASE: Colour = (255, 150, 40)
ORBIT: Colour = (190, 214, 224)
TARGET: Colour = (255, 255, 255)

_SLACK = np.array([84.0, 72.0, 74.0])
_SHORTER = np.array([59.0, 90.0, 235.0])
_NEUTRAL = np.array([236.0, 236.0, 232.0])
_LONGER = np.array([200.0, 20.0, 40.0])
STRAIN_SCALE = 0.2
"""Strain of the strongest colour; a quarter of it has half of the colour."""


def strain_colours(strains: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Give the colours of strains, (…, 3): blue is shorter, red is longer than at rest."""
    shares = np.sqrt(np.clip(np.abs(strains) / STRAIN_SCALE, 0.0, 1.0))[..., np.newaxis]
    ends = np.where(strains[..., np.newaxis] < 0, _SHORTER, _LONGER)
    colours: NDArray[np.uint8] = np.rint(_NEUTRAL + shares * (ends - _NEUTRAL)).astype(np.uint8)
    return colours


def muscle_colours(activations: NDArray[np.float64]) -> NDArray[np.int64]:
    """Give the colours of muscles that are so active, (…, 4, 3): grey to those of springs."""
    shares = activations[..., np.newaxis]
    colours: NDArray[np.int64] = np.rint(_SLACK + shares * (np.array(SPRINGS) - _SLACK)).astype(int)
    return colours


def faded_base(shares: NDArray[np.float64], dark: int = 0) -> list[Colour]:
    """Give the colour of the base's past: at a share of 0 a grey, dark to 255; at 1 the base's."""
    shades = np.rint(dark + shares[:, np.newaxis] * (np.array(BASE) - dark))
    colours: list[Colour] = shades.astype(int).tolist()
    return colours
