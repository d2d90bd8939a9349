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
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from octoarm_agents.common.files import write_json
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.whole import whole_number
from octoarm_agents.policies.network import Network
from octoarm_agents.policies.reaching import (
    KEYS,
    GoalPolicy,
    evaluate_reaching,
    held_out_goals,
    search_goals,
    train_goals,
    validation_goals,
)
from octoarm_agents.rl.checkpoint import (
    read_checkpoint,
    restore_training,
    training_state,
    write_checkpoint,
)
from octoarm_agents.rl.export import layers_of
from octoarm_agents.rl.hyperparameters import REACH_ID, Hyperparameters, algorithm_class
from octoarm_agents.rl.sb3_vec_env import Sb3VecEnv
from octoarm_agents.rl.task import check_same, finished_summary, open_folder
from octoarm_env.reach import OctoArmReachVectorEnv

Algorithm = Literal["sac", "ppo"]
Progress = Callable[[dict[str, float]], Any]


def train_reaching(
    algorithm: Algorithm,
    out: Path,
    *,
    steps: int | None = None,
    seed: int = 0,
    evaluations: int = 10,
    hyperparameters: Hyperparameters | None = None,
    validation: bool = False,
    resume: bool = False,
    progress: Progress | None = None,
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
        steps: of all environments together; None: those of the hyper-parameters.
        seed: of everything random.
        evaluations: at equal intervals.
        hyperparameters: None: those that come with this distribution.
        validation: learn from `search_goals` and be judged on `validation_goals`, as a search for
            hyper-parameters does; held-out goals are then not seen.
        resume: go on with the training in `out` from its checkpoint; begin it if it has none. One
            that is finished is not trained again.
        progress: called after every evaluation with its point of the curve.

    Returns:
        What ``training.json`` holds.

    Raises:
        ValueError: numbers out of their range; hyper-parameters that the algorithm does not know; a
            folder that holds another training, or this one without `resume`; a checkpoint that is
            damaged.
        OSError: the folder cannot be written to.
    """
    given = hyperparameters or Hyperparameters.load(algorithm, env_id=REACH_ID)
    wanted: dict[str, Any] = {
        "algorithm": algorithm,
        "steps": whole_number("steps", given.steps if steps is None else steps, 1),
        "seed": whole_number("seed", seed),
        "evaluations": whole_number("evaluations", evaluations, 1),
        "validation": validation,
        "hyperparameters": given.entries(),
    }
    checkpoint = open_folder(out, "sb3", resume)
    saved = None
    if checkpoint.exists():
        saved = read_checkpoint(checkpoint)
        check_same(checkpoint, saved["training"], wanted)
        finished = finished_summary(out, saved, wanted["steps"])
        if finished is not None:
            return finished
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        return _Run(wanted, out, checkpoint, progress).run(saved)
    finally:
        torch.set_num_threads(threads)


class _Run(BaseCallback):
    """A training under way; it evaluates and saves between rollouts, when nothing is half done."""

    model: Any

    def __init__(
        self, wanted: dict[str, Any], out: Path, checkpoint: Path, progress: Progress | None
    ) -> None:
        super().__init__()
        self.wanted, self.out, self.checkpoint = wanted, out, checkpoint
        self.progress = progress or (lambda point: None)
        self.given = Hyperparameters.from_entries(wanted["hyperparameters"])
        learnt, self.judged = (
            (search_goals(), validation_goals())
            if wanted["validation"]
            else (train_goals(), held_out_goals())
        )
        self.kind = algorithm_class(wanted["algorithm"])
        self.arms = OctoArmReachVectorEnv(
            self.given.num_envs,
            **{"threads": 1, "goals": learnt, **self.given.env},
            autoreset_mode=AutoresetMode.SAME_STEP,
        )
        # What learns from a replay buffer scales its actions itself.
        scaled = issubclass(self.kind, OffPolicyAlgorithm)
        seen = Sb3VecEnv(self.arms if scaled else RescaleAction(self.arms, -1.0, 1.0))
        seen.seed(wanted["seed"])
        self.monitor = VecMonitor(seen)
        normalize = {"gamma": self.given.arguments.get("gamma", 0.99), **self.given.normalize}
        self.envs = VecNormalize(self.monitor, **normalize)
        self.curve: list[dict[str, float]] = []
        self.summary: dict[str, Any] = {}
        self.seconds, self.resumed = 0.0, 0

    def run(self, saved: dict[str, Any] | None) -> dict[str, Any]:
        if saved is None:
            self.model = self.make_model()
        else:
            self.curve, self.seconds = saved["curve"], saved["seconds"]
            self.resumed = saved["resumed"] + 1
            self.model, self.envs = restore_training(
                saved, self.kind, self.monitor, self.monitor, self.arms
            )
        self.model.set_logger(Logger(None, []))
        left = self.wanted["steps"] - self.model.num_timesteps
        self.begun = time.process_time()
        self.model.learn(left, callback=self, reset_num_timesteps=saved is None)
        # More than one where rollouts are too long for so many evaluations.
        while len(self.curve) < self.wanted["evaluations"]:
            self.evaluate()
        return self.summary

    def make_model(self) -> Any:
        name, seed = self.wanted["algorithm"], self.wanted["seed"]
        arguments = self.given.model_arguments()
        try:
            return self.kind(self.given.policy, self.envs, seed=seed, device="cpu", **arguments)
        except TypeError as error:
            raise ValueError(f"hyper-parameters of {name}: {error}") from None

    def _on_rollout_start(self) -> None:
        total, evaluations = self.wanted["steps"], self.wanted["evaluations"]
        number = len(self.curve) + 1
        if number < evaluations and self.num_done() >= total * number // evaluations:
            self.evaluate()

    def _on_step(self) -> bool:
        return True

    def num_done(self) -> int:
        """Steps of all environments together."""
        return int(self.model.num_timesteps)

    def evaluate(self) -> None:
        """Judge the policy as it is, and save all that the rest of the training depends on."""
        self.seconds += time.process_time() - self.begun
        wanted, done = self.wanted, self.num_done()
        training = {"algorithm": wanted["algorithm"], "seed": wanted["seed"], "steps": done}
        network = export_goal_network(self.model, self.envs)
        policy = GoalPolicy(network, self.arms.settings, training)
        judged = evaluate_reaching(policy, self.judged)
        self.curve.append({"steps": done, "seconds": round(self.seconds, 1), **judged})
        policy.training |= judged
        policy.save(self.out / "policy.npz")
        self.summary = {
            "algorithm": wanted["algorithm"],
            "seed": wanted["seed"],
            "steps": done,
            "envs": self.given.num_envs,
            "validation": wanted["validation"],
            "hyperparameters": wanted["hyperparameters"],
            "parameters": network.parameter_count,
            "curve": list(self.curve),
            "finished": done >= wanted["steps"],
            "resumed": self.resumed,
            "versions": package_versions(
                "octoarm-env", "octoarm-agents", "stable-baselines3", "torch", "numpy"
            ),
            "machine": describe_machine(),
        }
        write_json(self.out / "training.json", self.summary)
        state = {
            "training": wanted,
            "curve": self.curve,
            "seconds": self.seconds,
            "resumed": self.resumed,
            **training_state(self.model, self.envs, self.monitor, self.arms),
        }
        write_checkpoint(self.checkpoint, self.model, state)
        self.progress(self.curve[-1])
        self.begun = time.process_time()


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
