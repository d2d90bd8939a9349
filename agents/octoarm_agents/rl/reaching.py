"""Training on reaching: SAC with hindsight experience replay, and PPO."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import RescaleAction
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from octoarm_agents.common.files import write_json
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.policies.network import Network
from octoarm_agents.policies.reaching import (
    KEYS,
    GoalPolicy,
    evaluate_reaching,
    train_goals,
)
from octoarm_agents.rl.checkpoint import (
    read_checkpoint,
    restore_training,
    training_state,
    write_checkpoint,
)
from octoarm_agents.rl.export import layers_of
from octoarm_agents.rl.sb3_vec_env import Sb3VecEnv
from octoarm_agents.rl.task import check_same, finished_summary, open_folder
from octoarm_env.reach import OctoArmReachVectorEnv

Algorithm = Literal["sac", "ppo"]

STEPS: dict[Algorithm, int] = {"sac": 100_000, "ppo": 1_000_000}
"""Of all environments together, where nothing else is asked for."""

_SAC: dict[str, Any] = {
    "replay_buffer_class": HerReplayBuffer,
    "replay_buffer_kwargs": {"n_sampled_goal": 4, "goal_selection_strategy": "future"},
    "learning_starts": 3_200,
    "batch_size": 256,
    "gamma": 0.95,
    "tau": 0.01,
    "train_freq": 1,
    "gradient_steps": 4,
    "learning_rate": 1e-3,
    "buffer_size": 300_000,
    "policy_kwargs": {"net_arch": [256, 256]},
}
_PPO: dict[str, Any] = {
    "n_steps": 50,
    "batch_size": 800,
    "n_epochs": 10,
    "gamma": 0.97,
    "learning_rate": 3e-4,
    "policy_kwargs": {"net_arch": [128, 128], "log_std_init": -1.0},
}
_ARMS: dict[Algorithm, int] = {"sac": 16, "ppo": 64}


def train_reaching(
    algorithm: Algorithm,
    out: Path,
    *,
    steps: int | None = None,
    seed: int = 0,
    evaluations: int = 10,
    resume: bool = False,
    progress: Callable[[int, float], Any] | None = None,
) -> dict[str, Any]:
    """Train an agent to reach; one thread computes, so that a seed gives the same curve.

    SAC learns from the sparse reward with hindsight experience replay, PPO from the dense one.
    Both see `train_goals` alone; they are judged on `held_out_goals`, the last policy counts.
    Killed at any moment, the training goes on from the checkpoint of its last evaluation, and what
    it then computes is what it would have computed.

    Args:
        algorithm: ``"sac"`` or ``"ppo"``.
        out: folder for ``policy.npz``, ``training.json`` and ``checkpoint.zip``, all written
            anew at every evaluation, each whole or not at all. The checkpoint holds the replay
            buffer of SAC too: 1.5 kB a step, of the last 300,000.
        steps: of all environments together; None: those of `STEPS`.
        seed: of everything random.
        evaluations: at equal intervals.
        resume: go on with the training in `out` from its checkpoint; begin it if it has none. One
            that is finished is not trained again.
        progress: called with the steps done and the last success.

    Returns:
        What ``training.json`` holds.

    Raises:
        ValueError: a folder that holds another training, or this one without `resume`; a checkpoint
            that is damaged.
        OSError: the folder cannot be written to.
    """
    total = STEPS[algorithm] if steps is None else steps
    wanted = {
        "algorithm": algorithm,
        "steps": total,
        "seed": seed,
        "evaluations": evaluations,
        "envs": _ARMS[algorithm],
        "hyperparameters": _hyperparameters(algorithm),
    }
    checkpoint = open_folder(out, "sb3", resume)
    saved = None
    if checkpoint.exists():
        saved = read_checkpoint(checkpoint)
        check_same(checkpoint, saved["training"], wanted)
        finished = finished_summary(out, saved, total)
        if finished is not None:
            return finished
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        return _train(wanted, out, checkpoint, saved, progress)
    finally:
        torch.set_num_threads(threads)


def _hyperparameters(algorithm: Algorithm) -> dict[str, Any]:
    """Those of an algorithm as they read in JSON."""
    given = _SAC if algorithm == "sac" else _PPO
    return {name: getattr(value, "__name__", value) for name, value in given.items()}


def _train(
    wanted: dict[str, Any],
    out: Path,
    checkpoint: Path,
    saved: dict[str, Any] | None,
    progress: Callable[[int, float], Any] | None,
) -> dict[str, Any]:
    algorithm, seed = wanted["algorithm"], wanted["seed"]
    total, evaluations = wanted["steps"], wanted["evaluations"]
    sparse = algorithm == "sac"
    arms = OctoArmReachVectorEnv(
        wanted["envs"],
        "sparse" if sparse else "dense",
        goals=train_goals(),
        autoreset_mode=AutoresetMode.SAME_STEP,
        threads=1,
    )
    settings = arms.settings
    seen = Sb3VecEnv(arms if sparse else RescaleAction(arms, -1.0, 1.0))
    seen.seed(seed)
    monitor = VecMonitor(seen)
    kind: Any = SAC if sparse else PPO
    curve: list[dict[str, float]] = []
    learning, resumed = 0.0, 0
    if saved is not None:
        curve, learning, resumed = saved["curve"], saved["seconds"], saved["resumed"] + 1
        model, envs = restore_training(saved, kind, monitor, monitor, arms)
    else:
        given = _SAC if sparse else _PPO
        envs = VecNormalize(monitor, norm_reward=not sparse, gamma=given["gamma"])
        model = kind("MultiInputPolicy", envs, seed=seed, device="cpu", **given)
    summary: dict[str, Any] = {}
    for number in range(len(curve) + 1, evaluations + 1):
        begun = time.perf_counter()
        left = total * number // evaluations - model.num_timesteps
        if left > 0:
            model.learn(left, reset_num_timesteps=False)
        learning += time.perf_counter() - begun
        training = {"algorithm": algorithm, "seed": seed, "steps": int(model.num_timesteps)}
        policy = GoalPolicy(export_goal_network(model, envs), settings, training)
        judged = evaluate_reaching(policy)
        curve.append({"steps": int(model.num_timesteps), "seconds": round(learning, 1), **judged})
        policy.training |= judged
        policy.save(out / "policy.npz")
        summary = {
            **training,
            "envs": wanted["envs"],
            "hyperparameters": wanted["hyperparameters"],
            "parameters": policy.network.parameter_count,
            "curve": curve,
            "finished": number == evaluations,
            "resumed": resumed,
            "versions": package_versions(
                "octoarm-env", "octoarm-agents", "stable-baselines3", "torch", "numpy"
            ),
            "machine": describe_machine(),
        }
        write_json(out / "training.json", summary)
        state = {"training": wanted, "curve": curve, "seconds": learning, "resumed": resumed}
        state |= training_state(model, envs, monitor, arms)
        write_checkpoint(checkpoint, model, state)
        if progress is not None:
            progress(int(model.num_timesteps), judged["success"])
    return summary


def export_goal_network(model: Any, normalization: VecNormalize) -> Network:
    """Take the deterministic actor out of a model of a goal environment.

    Args:
        model: a PPO or SAC with a "MultiInputPolicy" and no layers before the flattening.
        normalization: of its observations.

    Returns:
        A network that takes tip, goal and lengths side by side, and acts in [-1, 1].
    """
    policy = model.policy
    if hasattr(policy, "action_net"):
        layers, activation = layers_of([*policy.mlp_extractor.policy_net, policy.action_net])
        output = "clip"
    else:
        layers, activation = layers_of([*policy.actor.latent_pi, policy.actor.mu])
        output = "tanh"
    statistics: Any = normalization.obs_rms
    mean = np.concatenate([statistics[key].mean for key in KEYS])
    variance = np.concatenate([statistics[key].var for key in KEYS])
    scale = 1 / np.sqrt(variance + normalization.epsilon)
    return Network(mean, scale, float(normalization.clip_obs), layers, activation, output)
