"""The arm's skin as facets, and how much light falls on them."""

from __future__ import annotations

import numpy as np

from octoarm_env.arrays import Float

SIDES = 24
"""Facets around a compartment, a multiple of four."""

_ROUNDING = np.radians([30.0, 60.0, 88.0])
"""Where the rings of the tip's cap lie."""


_quarter, _part = np.divmod(4 * np.arange(SIDES) / SIDES, 1.0)
_joint, _angle = _quarter.astype(int), 0.5 * np.pi * _part[:, np.newaxis]
_WEIGHTS = np.cos(_angle) * np.eye(4)[_joint] + np.sin(_angle) * np.eye(4)[(_joint + 1) % 4]
"""Weights of the four joints in each point of a ring: quarters of ellipses, (SIDES, 4)."""


def centres(joints: Float) -> Float:
    """Give the planes' centres, (N + 1, 3): where their struts meet.

    Args:
        joints: ends of the struts, (N + 1, 4, 3).
    """
    across = joints[:, 2] - joints[:, 0]
    beside = joints[:, 1] - joints[:, 0]
    # Struts 1 and 3 are one line, 2 and 4 are square to it.
    share = (across * beside).sum(axis=1) / (across * across).sum(axis=1)
    points: Float = joints[:, 0] + share[:, np.newaxis] * across
    return points


def exaggerate(joints: Float, rest: Float, factor: float) -> Float:
    """Move every plane `factor` times as far to the side of the arm at rest as it is.

    Args:
        joints: ends of the struts, (N + 1, 4, 3).
        rest: the planes' centres at rest, (N + 1, 3).
        factor: 1 changes nothing.
    """
    if factor == 1.0:
        return joints
    along = np.gradient(rest, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    way = centres(joints) - rest
    sideways = way - (way * along).sum(axis=1, keepdims=True) * along
    moved: Float = joints + (factor - 1.0) * sideways[:, np.newaxis, :]
    return moved


def skin(joints: Float) -> Float:
    """Give the rings of the arm's skin, with a rounded tip, (N + 4, SIDES, 3)."""
    middles = centres(joints)
    rings = middles[:, np.newaxis] + np.einsum(
        "ks,nsd->nkd", _WEIGHTS, joints - middles[:, np.newaxis]
    )
    last, middle = rings[-1], middles[-1]
    normal = _cross(joints[-1, 0] - middle, joints[-1, 1] - middle)
    normal /= np.linalg.norm(normal)
    radius = np.linalg.norm(last - middle, axis=1).mean()
    cap = [
        middle + np.cos(angle) * (last - middle) + np.sin(angle) * radius * normal
        for angle in _ROUNDING
    ]
    return np.concatenate((rings, np.array(cap)))


def tube(begin: Float, end: Float, radii: tuple[float, float], sides: int = SIDES) -> Float:
    """Give two rings around a line, (2, sides, 3)."""
    axis = (end - begin) / np.linalg.norm(end - begin)
    some = np.array([1.0, 0.0, 0.0]) if abs(axis[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    first = _cross(axis, some)
    first /= np.linalg.norm(first)
    second = _cross(axis, first)
    angles = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    circle = np.outer(np.cos(angles), first) + np.outer(np.sin(angles), second)
    return np.stack((begin + radii[0] * circle, end + radii[1] * circle))


def _cross(a: Float, b: Float) -> Float:
    """The cross product of vectors in the last axis, without the detours of NumPy's own."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx), axis=-1)


def facets(rings: Float) -> tuple[Float, Float]:
    """Give the corners (n, 4, 3) and outward unit normals (n, 3) of the facets between rings."""
    beside = np.concatenate((rings[:, 1:], rings[:, :1]), axis=1)
    corners = np.stack((rings[:-1], beside[:-1], beside[1:], rings[1:]), axis=2)
    normals = _cross(
        corners[..., 2, :] - corners[..., 0, :], corners[..., 1, :] - corners[..., 3, :]
    )
    middles = rings.mean(axis=1)
    outwards = corners.mean(axis=2) - 0.5 * (middles[:-1] + middles[1:])[:, np.newaxis]
    normals *= np.sign((normals * outwards).sum(axis=2, keepdims=True))
    size = np.linalg.norm(normals, axis=2, keepdims=True)
    normals /= np.maximum(size, 1e-300)
    return corners.reshape(-1, 4, 3), normals.reshape(-1, 3)


def lit(colours: Float, normals: Float, light: Float, back: Float, water: Float) -> Float:
    """Give the colours of surfaces under water.

    Args:
        colours: of the surfaces, (n, 3), 0 to 255.
        normals: theirs, (n, 3).
        light: where most of the light comes from, a unit vector.
        back: towards the camera, a unit vector.
        water: colour of the light from all around.

    Returns:
        (n, 3), 0 to 255: soft diffuse light, a little gloss (Blinn and Phong), and at the rim the
        colour of the water.
    """
    diffuse = np.clip(0.5 + 0.5 * (normals @ light), 0.0, 1.0) ** 1.5
    halfway = (light + back) / np.linalg.norm(light + back)
    gloss = np.clip(normals @ halfway, 0.0, 1.0) ** 30
    rim = (1.0 - np.clip(normals @ back, 0.0, 1.0)) ** 3
    shaded = colours * (0.4 + 0.75 * diffuse)[:, np.newaxis]
    shaded += 70.0 * gloss[:, np.newaxis]
    shaded += 0.28 * rim[:, np.newaxis] * (water - shaded)
    return np.clip(shaded, 0.0, 255.0)
