"""Checkpoints: all that the rest of a training depends on, in one file."""

from __future__ import annotations

import io
import pickle
import random
import zipfile
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np
import torch
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize

from octoarm_agents.common.files import atomic_file

_MODEL, _STATE, _BUFFER = "model.zip", "state.pkl", "replay_buffer.pkl"

_ROWS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_HINDSIGHT_ROWS = ("ep_start", "ep_length")
_HINDSIGHT = "_current_ep_start"
"""Where the episodes of each environment begin; of a buffer that learns by hindsight."""


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
            rows = {name: _first(getattr(replay, name), used) for name in _row_names(replay)}
            packed = {"pos": replay.pos, "full": replay.full, **rows}
            if hasattr(replay, _HINDSIGHT):
                packed[_HINDSIGHT] = getattr(replay, _HINDSIGHT)
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
            for name in _row_names(replay):
                _put_first(getattr(replay, name), packed[name])
            if hasattr(replay, _HINDSIGHT):
                setattr(replay, _HINDSIGHT, packed[_HINDSIGHT])
        return loaded

    return {**state, "load": load}


def training_state(
    model: Any, envs: VecNormalize, monitor: VecMonitor, arms: Any
) -> dict[str, Any]:
    """Give what stable-baselines3 does not save of a training, between two rollouts.

    Args:
        model: of stable-baselines3.
        envs: its environments.
        monitor: below these.
        arms: the native batch, below all.
    """
    model.policy.set_training_mode(False)
    return {
        "normalization": envs,
        "normalized_returns": envs.returns,
        "episode_returns": monitor.episode_returns,
        "episode_lengths": monitor.episode_lengths,
        "memory": getattr(model, "_last_lstm_states", None),
        "arms": arms.snapshot(),
        "python_random": random.getstate(),
        "numpy_random": np.random.get_state(),  # noqa: NPY002, stable-baselines3 draws here
        "torch_random": torch.get_rng_state(),
        "action_random": model.action_space.np_random.bit_generator.state,
    }


def restore_training(
    saved: dict[str, Any], kind: Any, seen: VecEnv, monitor: VecMonitor, arms: Any
) -> tuple[Any, VecNormalize]:
    """Go on where a checkpoint was written.

    Args:
        saved: as of `read_checkpoint`, with all that `training_state` gave.
        kind: the algorithm's class.
        seen: the environments that are normalised.
        monitor: `seen`, or below it.
        arms: the native batch, below all.

    Returns:
        The model, and its environments.
    """
    # The arms must have begun before they can go on.
    monitor.reset()
    envs: VecNormalize = saved["normalization"]
    envs.set_venv(seen)
    model = saved["load"](kind, envs)
    arms.restore(saved["arms"])
    envs.returns = saved["normalized_returns"]
    monitor.episode_returns = saved["episode_returns"]
    monitor.episode_lengths = saved["episode_lengths"]
    if saved["memory"] is not None:
        model._last_lstm_states = saved["memory"]
    random.setstate(saved["python_random"])
    np.random.set_state(saved["numpy_random"])  # noqa: NPY002
    torch.set_rng_state(saved["torch_random"])
    model.action_space.np_random.bit_generator.state = saved["action_random"]
    return model, envs


def _row_names(replay: Any) -> tuple[str, ...]:
    return _ROWS + (_HINDSIGHT_ROWS if hasattr(replay, _HINDSIGHT) else ())


def _first(rows: Any, used: int) -> Any:
    """The rows that are in use, of an array or of each part of an observation."""
    return {key: rows[key][:used] for key in rows} if isinstance(rows, dict) else rows[:used]


def _put_first(rows: Any, used: Any) -> None:
    if isinstance(rows, dict):
        for key in rows:
            _put_first(rows[key], used[key])
    else:
        rows[: len(used)] = used
