"""Checkpoints: all that the rest of a training depends on, in one file."""

from __future__ import annotations

import io
import pickle
import zipfile
from pathlib import Path
from typing import Any

import cloudpickle

from octoarm_agents.common.files import atomic_file

_MODEL, _STATE, _BUFFER = "model.zip", "state.pkl", "replay_buffer.pkl"

_ROWS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def write_checkpoint(path: Path, model: Any, state: dict[str, Any]) -> None:
    """Write a checkpoint, which appears whole or not at all.

    Args:
        path: the file.
        model: of stable-baselines3.
        state: what it does not save itself; must pickle.
    """
    saved = io.BytesIO()
    model.save(saved)
    with atomic_file(path) as file, zipfile.ZipFile(file, "w") as archive:
        archive.writestr(_MODEL, saved.getvalue())
        archive.writestr(_STATE, cloudpickle.dumps(state))
        replay = getattr(model, "replay_buffer", None)
        if replay is not None:
            # stable-baselines3 would save the rows that are not in use yet too.
            used = replay.buffer_size if replay.full else replay.pos
            rows = {name: getattr(replay, name)[:used] for name in _ROWS}
            packed = {"pos": replay.pos, "full": replay.full, **rows}
            archive.writestr(_BUFFER, pickle.dumps(packed, pickle.HIGHEST_PROTOCOL))


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
            packed, replay = pickle.loads(parts[_BUFFER]), loaded.replay_buffer
            replay.pos, replay.full = packed["pos"], packed["full"]
            for name in _ROWS:
                getattr(replay, name)[: len(packed[name])] = packed[name]
        return loaded

    return {**state, "load": load}
