"""A fitted readout as a file: JSON that can be read by eye, with the body it belongs to."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from octoarm_agents.common.environment import decode_body, differences
from octoarm_agents.common.files import write_json
from octoarm_agents.common.provenance import package_versions
from octoarm_agents.reservoir.readout import Readout
from octoarm_env import ArmParameters

__all__ = ["SavedReadout", "load_readout", "save_readout"]

Float = NDArray[np.float64]

FORMAT = "octoarm-readout"
VERSION = 1

_PACKAGES = ("octoarm-env", "octoarm-agents", "numpy", "scikit-learn")


@dataclass(frozen=True, eq=False)
class SavedReadout:
    """What a readout file holds.

    Attributes:
        readout: fitted, with the very weights that were saved.
        parameters: the body it was fitted on.
        protocol: how it was fitted, as it was given to `save_readout`.
        seed: of the protocol, None if it has none.
        versions: of the packages it was fitted with, None for one that was not installed.
        format: version of the file's format.
    """

    readout: Readout
    parameters: ArmParameters
    protocol: dict[str, Any]
    seed: int | None
    versions: dict[str, str | None]
    format: int


def save_readout(
    path: str | os.PathLike[str],
    readout: Readout,
    *,
    parameters: ArmParameters,
    protocol: dict[str, Any],
    seed: int | None = None,
) -> None:
    """Write a fitted readout to a JSON file, which appears whole or not at all.

    Args:
        path: the file; its folder must exist.
        readout: fitted to the 4 N spring lengths of the body.
        parameters: the body.
        protocol: how it was fitted: names with numbers, texts, lists and dictionaries of these.
            Tuples come back as lists.
        seed: of the protocol.

    Raises:
        ValueError: a readout that is not fitted or is for another number of springs, or anything
            that JSON cannot hold; the message names it.
        OSError: the folder cannot be written to.
    """
    if not hasattr(readout, "weights_"):
        raise ValueError("readout is not fitted: expected one after fit")
    springs = 4 * parameters.compartments
    if readout.n_features_in_ != springs:
        raise ValueError(
            f"readout takes {readout.n_features_in_} lengths, the body has {springs} springs"
        )
    seed = _plain(seed)
    if seed is not None and (isinstance(seed, bool) or not isinstance(seed, int)):
        raise ValueError(f"seed = {seed!r}: expected a whole number or None")
    settings = readout.get_params()
    content = {
        "format": FORMAT,
        "version": VERSION,
        "settings": {name: _plain(value) for name, value in settings.items()},
        "fit": {
            "single_output": readout.single_output_,
            "rank": readout.rank_,
            "training_error": readout.training_error_,
            "singular_values": readout.singular_values_.tolist(),
        },
        "protocol": protocol,
        "seed": seed,
        "body": parameters.to_dict(),
        "versions": package_versions(*_PACKAGES),
        # Last, because they are long. JSON's shortest decimals give back the same bits.
        "weights": readout.weights_.tolist(),
    }
    for name, value in content.items():
        try:
            json.dumps(value, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{name} cannot be written as JSON: {error}") from None
    write_json(Path(path), content)


def load_readout(
    path: str | os.PathLike[str], *, parameters: ArmParameters | None = None
) -> SavedReadout:
    """Read a readout from its file.

    Args:
        path: the file.
        parameters: the body that the readout is to be used on; None: whatever body it is for.

    Raises:
        ValueError: not a readout file, one of another version, one that is incomplete or damaged,
            or one for another body than `parameters`; the message names the file and what is wrong.
        OSError: the file cannot be read.
    """
    content = _read(Path(path))
    try:
        saved = _decode(content)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    if parameters is not None:
        found = differences(saved.parameters.to_dict(), parameters.to_dict())
        if found:
            raise ValueError(f"{path} is for another body: {found}")
    return saved


def _plain(value: Any) -> Any:
    """A NumPy number as Python's own."""
    return value.item() if isinstance(value, np.generic) else value


def _read(path: Path) -> Any:
    def refuse(constant: str) -> NoReturn:
        raise ValueError(f"{constant} is not a finite number")

    try:
        return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    # UnicodeDecodeError and JSONDecodeError are ValueErrors.
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not a complete JSON file: {error}") from None


def _decode(content: Any) -> SavedReadout:
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ValueError(f'not a readout file: it lacks "format": "{FORMAT}"')
    version = content.get("version")
    if isinstance(version, bool) or version != VERSION:
        raise ValueError(f"version = {version!r}: this release reads version {VERSION}")
    parameters = decode_body(_entry(content, "body", dict))
    seed = content.get("seed")
    if seed is not None:
        seed = _entry(content, "seed", int)
    return SavedReadout(
        readout=_readout(content, 4 * parameters.compartments),
        parameters=parameters,
        protocol=_entry(content, "protocol", dict),
        seed=seed,
        versions=_entry(content, "versions", dict),
        format=VERSION,
    )


def _entry(content: dict[str, Any], name: str, kind: type, where: str = "") -> Any:
    """An entry that must be there and of its type."""
    if name not in content:
        raise ValueError(f"{where}{name} is missing")
    value = content[name]
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        raise ValueError(
            f"{where}{name} is of type {type(value).__name__}, expected {kind.__name__}"
        )
    return value


def _readout(content: dict[str, Any], springs: int) -> Readout:
    settings = _entry(content, "settings", dict)
    fit = _entry(content, "fit", dict)
    known = sorted(Readout().get_params())
    if sorted(settings) != known:
        raise ValueError(f"settings holds {sorted(settings)}, expected {known}")
    readout = Readout(**settings)
    readout.check_parameters()
    weights = _numbers(_entry(content, "weights", list), "weights")
    rows = springs + int(_entry(settings, "bias", bool, "settings: "))
    if weights.ndim != 2 or weights.shape[0] != rows or weights.shape[1] < 1:
        raise ValueError(f"weights have shape {weights.shape}, expected ({rows}, outputs)")
    singular = _numbers(_entry(fit, "singular_values", list, "fit: "), "singular_values")
    if singular.shape != (springs,):
        raise ValueError(f"singular_values have shape {singular.shape}, expected ({springs},)")
    single = _entry(fit, "single_output", bool, "fit: ")
    if single and weights.shape[1] != 1:
        raise ValueError(f"single_output is true, but there are {weights.shape[1]} outputs")
    error = _entry(fit, "training_error", float, "fit: ")
    if not 0 <= error < math.inf:
        raise ValueError(f"training_error = {error}: expected a finite number, not negative")
    rank = _entry(fit, "rank", int, "fit: ")
    if not 0 <= rank <= springs:
        raise ValueError(f"rank = {rank}: expected 0 to {springs}")
    readout.weights_ = weights
    readout.n_features_in_ = springs
    readout.single_output_ = single
    readout.singular_values_ = singular
    readout.rank_ = rank
    readout.training_error_ = error
    return readout


def _numbers(entries: list[Any], name: str) -> Float:
    """A list of numbers, or of equally long lists of numbers, as an array."""
    flat = [each for row in entries for each in (row if isinstance(row, list) else [row])]
    if not all(type(each) in (int, float) for each in flat):
        raise ValueError(f"{name} holds something that is not a number")
    try:
        array = np.array(entries, dtype=np.float64)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{name}: {error}") from None
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds numbers that are not finite")
    return array
