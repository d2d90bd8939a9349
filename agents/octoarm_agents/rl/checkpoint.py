"""Checkpoints: all that the rest of a training depends on, in one file."""

from __future__ import annotations

import io
import pickle
import zipfile
from pathlib import Path
from typing import Any

import cloudpickle
from stable_baselines3.common.save_util import load_from_pkl, save_to_pkl

from octoarm_agents.common.files import write_atomically

__all__ = ["read_checkpoint", "write_checkpoint"]

_MODEL, _STATE, _BUFFER = "model.zip", "state.pkl", "replay_buffer.pkl"


def write_checkpoint(path: Path, model: Any, state: dict[str, Any]) -> None:
    """Write a checkpoint, which appears whole or not at all.

    Args:
        path: the file.
        model: of stable-baselines3.
        state: what it does not save itself; must pickle.
    """
    write_atomically(path, lambda file: _write(file, model, state))


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint. It holds pickles: read your own only.

    Returns:
        The state, and as ``"load"`` a function of the algorithm's class and the environments that
        gives the model.

    Raises:
        ValueError: the file is damaged, no checkpoint, or of another version.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            parts = {name: archive.read(name) for name in archive.namelist()}
        state: dict[str, Any] = pickle.loads(parts[_STATE])
        model = parts[_MODEL]
    except (AttributeError, ImportError) as error:
        raise ValueError(f"{path} was written by another version: {error}") from None
    except (zipfile.BadZipFile, KeyError, pickle.UnpicklingError, EOFError) as error:
        raise ValueError(f"{path} is no complete checkpoint: {error}") from None

    def load(kind: Any, envs: Any) -> Any:
        loaded = kind.load(io.BytesIO(model), env=envs, device="cpu", force_reset=False)
        if _BUFFER in parts:
            buffer = load_from_pkl(io.BytesIO(parts[_BUFFER]))
            _unpack(buffer, loaded.replay_buffer)
        return loaded

    return {**state, "load": load}


def _write(file: Path, model: Any, state: dict[str, Any]) -> None:
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        with archive.open(_MODEL, "w", force_zip64=True) as member:
            buffer = io.BytesIO()
            model.save(buffer)
            member.write(buffer.getvalue())
        archive.writestr(_STATE, cloudpickle.dumps(state))
        if getattr(model, "replay_buffer", None) is not None:
            with archive.open(_BUFFER, "w", force_zip64=True) as member:
                buffer = io.BytesIO()
                save_to_pkl(buffer, _pack(model.replay_buffer))
                member.write(buffer.getbuffer())


_ROWS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def _pack(replay: Any) -> dict[str, Any]:
    """The rows of a replay buffer that are in use."""
    used = replay.buffer_size if replay.full else replay.pos
    rows = {name: getattr(replay, name)[:used] for name in _ROWS}
    return {"pos": replay.pos, "full": replay.full, **rows}


def _unpack(packed: dict[str, Any], replay: Any) -> None:
    replay.pos, replay.full = packed["pos"], packed["full"]
    for name in _ROWS:
        rows = packed[name]
        getattr(replay, name)[: len(rows)] = rows
