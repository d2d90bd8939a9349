"""A policy as a file: NumPy's `.npz` with a header in JSON, and no pickle in it.

The header says what the arrays are and where they belong: format and version, environment id,
layout of the observation, the environment's settings, the body, how the policy came about, its
seed, and the packages that made it.
"""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from octoarm_agents.common.environment import ENV_ID
from octoarm_agents.common.files import atomic_file
from octoarm_agents.common.provenance import package_versions

FORMATS = ("octoarm-policy", "octoarm-network")
"""What is written, and what networks of before are called; for both this is version `VERSION`."""

VERSION = 1

OBSERVATION = "spring_lengths"
"""The only layout of observations so far: lengths in metres, compartment by compartment."""

_PACKAGES = (
    *("octoarm-env", "octoarm-agents", "numpy", "scikit-learn"),
    *("stable-baselines3", "sb3-contrib", "torch"),
)


_KINDS = {"algorithm": str, "environment": dict, "training": dict, "network": dict, "body": dict}
"""Entries of a header that its reader looks at, beside ``seed``, a whole number or null."""


def write_policy_file(path: Path, header: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
    """Write a file, which appears whole or not at all.

    Args:
        path: the file, .npz; its folder must exist.
        header: ``algorithm``, ``seed``, ``environment``, ``training``, ``network`` and ``body``.
        arrays: by name.

    Raises:
        ValueError: a name that does not end in .npz, or what JSON cannot hold.
        OSError: the folder cannot be written to.
    """
    if path.suffix != ".npz":
        raise ValueError(f"path = {path}: expected a name that ends in .npz")
    entries = {
        "format": FORMATS[0],
        "version": VERSION,
        "id": ENV_ID,
        "observation": {"layout": OBSERVATION, "springs": len(arrays["mean"]), "unit": "m"},
        **header,
        "versions": package_versions(*_PACKAGES),
    }
    try:
        text = json.dumps(entries, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ValueError(f"policy cannot be written as JSON: {error}") from None
    with atomic_file(path) as file:
        np.savez_compressed(file, description=np.array(text), **arrays)


def read_policy_file(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Give a file's header and its arrays by name.

    Raises:
        ValueError: not a policy file, one of another version or observation layout, or one that is
            incomplete or damaged.
        OSError: the file cannot be read.
    """
    if path.suffix == ".json":
        raise ValueError("readouts in JSON are of before: teach it again and save it as .npz")
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise ValueError("it is no .npz archive")
            arrays = {name: archive[name] for name in archive.files}
    except (EOFError, KeyError, ValueError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"not a complete policy file: {error}") from None
    if "description" not in arrays:
        raise ValueError("not a policy file: it lacks a description")
    return _decode(str(arrays.pop("description"))), arrays


def _decode(text: str) -> dict[str, Any]:
    try:
        content = json.loads(text)
    except ValueError as error:
        raise ValueError(f"description is not JSON: {error}") from None
    if not isinstance(content, dict) or content.get("format") not in FORMATS:
        raise ValueError(f'not a policy file: it lacks "format": "{FORMATS[0]}"')
    version = content.get("version")
    if isinstance(version, bool) or version != VERSION:
        raise ValueError(f"version = {version!r}: this release reads version {VERSION}")
    if content.get("id") != ENV_ID:
        raise ValueError(f"it is for {content.get('id')!r}, expected {ENV_ID!r}")
    observation = content.get("observation")
    layout = observation.get("layout") if isinstance(observation, dict) else None
    if layout != OBSERVATION:
        raise ValueError(f"observation layout = {layout!r}: this release knows {OBSERVATION!r}")
    for name, kind in _KINDS.items():
        if not isinstance(content.get(name), kind):
            raise ValueError(f"{name} = {content.get(name)!r}: expected a {kind.__name__}")
    seed = content.setdefault("seed")
    if seed is not None and (isinstance(seed, bool) or not isinstance(seed, int)):
        raise ValueError(f"seed = {seed!r}: expected a whole number or null")
    return content
