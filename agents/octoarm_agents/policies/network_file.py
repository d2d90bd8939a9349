"""A trained network as a file: NumPy's `.npz` with a description in JSON, and no pickle in it."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from octoarm_agents.common.environment import ENV_ID, decode_body
from octoarm_agents.common.files import write_atomically
from octoarm_agents.common.provenance import package_versions
from octoarm_agents.policies.network import Lstm, Network, NetworkPolicy

__all__ = ["load_network", "save_network"]

FORMAT = "octoarm-network"
VERSION = 1

OBSERVATION = "spring_lengths"
"""The only layout of observations so far: lengths in metres, compartment by compartment."""

_LSTM = ("lstm_input_weights", "lstm_hidden_weights", "lstm_bias")
_PACKAGES = ("octoarm-env", "octoarm-agents", "numpy", "stable-baselines3", "sb3-contrib", "torch")


def save_network(path: str | os.PathLike[str], policy: NetworkPolicy) -> None:
    """Write a policy to a file, which appears whole or not at all.

    Raises:
        ValueError: training or settings that JSON cannot hold.
        OSError: the folder cannot be written to.
    """
    network = policy.network
    description = {
        "format": FORMAT,
        "version": VERSION,
        "id": ENV_ID,
        "observation": {"layout": OBSERVATION, "springs": network.springs, "unit": "m"},
        "algorithm": policy.algorithm,
        "seed": policy.seed,
        "environment": policy.settings,
        "training": policy.training,
        "network": {
            "activation": network.activation,
            "output": network.output,
            "clip": network.clip,
            "layers": len(network.layers),
            "memory": 0 if network.lstm is None else network.lstm.size,
        },
        "body": policy.parameters.to_dict(),
        "versions": package_versions(*_PACKAGES),
    }
    try:
        text = json.dumps(description, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ValueError(f"policy cannot be written as JSON: {error}") from None
    arrays: dict[str, Any] = {"description": np.array(text)}
    arrays |= {"mean": network.mean, "scale": network.scale}
    for index, (weights, bias) in enumerate(network.layers):
        arrays |= {f"weights_{index}": weights, f"bias_{index}": bias}
    if network.lstm is not None:
        arrays |= dict(zip(_LSTM, vars(network.lstm).values(), strict=True))
    write_atomically(Path(path), lambda file: _write(file, arrays))


def load_network(path: str | os.PathLike[str]) -> NetworkPolicy:
    """Read a policy from its file.

    Raises:
        ValueError: not a policy file, one of another version or observation layout, or one that is
            incomplete or damaged; the message names the file and what is wrong.
        OSError: the file cannot be read.
    """
    try:
        return _decode(_read(Path(path)))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _write(file: Path, arrays: dict[str, Any]) -> None:
    with file.open("wb") as stream:
        np.savez_compressed(stream, **arrays)


def _read(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise ValueError("it is no .npz archive")
            return {name: archive[name] for name in archive.files}
    except (EOFError, KeyError, ValueError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"not a complete policy file: {error}") from None


def _decode(arrays: dict[str, Any]) -> NetworkPolicy:
    description = _description(arrays)
    network = description["network"]
    parameters = decode_body(description["body"])
    count = network.get("layers")
    if not isinstance(count, int) or not 0 < count <= 64:
        raise ValueError(f"network: layers = {count!r}, expected 1 to 64")
    try:
        layers = [(arrays[f"weights_{k}"], arrays[f"bias_{k}"]) for k in range(count)]
        lstm = Lstm(*(arrays[name] for name in _LSTM)) if network["memory"] else None
        made = Network(
            mean=arrays["mean"],
            scale=arrays["scale"],
            clip=float(network["clip"]),
            layers=tuple(layers),
            activation=network["activation"],
            output=network["output"],
            lstm=lstm,
        )
    except KeyError as error:
        raise ValueError(f"{error} is missing") from None
    return NetworkPolicy(
        made,
        description["algorithm"],
        parameters,
        description["environment"],
        description["training"],
        description["seed"],
    )


def _description(arrays: dict[str, Any]) -> dict[str, Any]:
    text = arrays.get("description")
    if text is None:
        raise ValueError("not a policy file: it lacks a description")
    try:
        content = json.loads(str(text))
    except ValueError as error:
        raise ValueError(f"description is not JSON: {error}") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ValueError(f'not a policy file: it lacks "format": "{FORMAT}"')
    version = content.get("version")
    if isinstance(version, bool) or version != VERSION:
        raise ValueError(f"version = {version!r}: this release reads version {VERSION}")
    if content.get("id") != ENV_ID:
        raise ValueError(f"it is for {content.get('id')!r}, expected {ENV_ID!r}")
    observation = content.get("observation")
    layout = observation.get("layout") if isinstance(observation, dict) else None
    if layout != OBSERVATION:
        raise ValueError(f"observation layout = {layout!r}: this release knows {OBSERVATION!r}")
    kinds = {"algorithm": str, "environment": dict, "training": dict, "network": dict, "body": dict}
    for name, kind in kinds.items():
        if not isinstance(content.get(name), kind):
            raise ValueError(f"{name} = {content.get(name)!r}: expected a {kind.__name__}")
    seed = content.get("seed")
    if seed is not None and (isinstance(seed, bool) or not isinstance(seed, int)):
        raise ValueError(f"seed = {seed!r}: expected a whole number or null")
    content["seed"] = seed
    return content
