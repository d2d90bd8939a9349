"""Training on the native batch: evaluated on seeds of its own, and taken up where it was killed."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Any
from warnings import warn

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger, configure
from stable_baselines3.common.vec_env import VecEnvWrapper, VecMonitor, VecNormalize

from octoarm_agents.common.files import write_atomically
from octoarm_agents.policies.policy import Policy
from octoarm_agents.rl.checkpoint import (
    read_checkpoint,
    restore_training,
    training_state,
    write_checkpoint,
)
from octoarm_agents.rl.export import export_network
from octoarm_agents.rl.hyperparameters import Hyperparameters, algorithm_class
from octoarm_agents.rl.judging import Judge, Progress
from octoarm_agents.rl.sb3_vec_env import make_sb3_vec_env
from octoarm_agents.rl.task import (
    CHECKPOINTS,
    Training,
    check_same,
    finished_summary,
    open_folder,
)

_PACKAGES = ("stable-baselines3", "sb3-contrib", "torch")
"""Their versions are written down too."""


def train(
    training: Training,
    out: Path,
    *,
    resume: bool = False,
    extend: bool = False,
    tensorboard: bool = False,
    progress: Progress | None = None,
    command: str | None = None,
) -> dict[str, Any]:
    """Train an agent; one thread computes, so that the same seed gives the same curve.

    Writes into `out`: ``best.npz`` and ``final.npz`` (policies for `load_policy`), the model of
    stable-baselines3 they come from (``final_model.zip``, ``vecnormalize.pkl``), the curve
    (``training.json``), a checkpoint at every evaluation and, if asked for, logs for TensorBoard.
    Every file appears whole or not at all: killed at any moment, the training goes on from its
    last checkpoint, and what it then computes is what it would have computed.

    Args:
        training: what to train.
        out: folder; made if it is not there.
        resume: go on with the training in `out` from its last checkpoint; begin it if it has none.
            One that is finished is not trained again.
        extend: with `resume`, go on with a training of fewer steps too, finished or not; it may
            have had another number of evaluations. What is then computed is what a training of so
            many steps would have computed from the beginning, with one exception: a hyper-parameter
            that falls over the training (``lin_0.001``) has fallen faster so far, and now stands
            where a training of so many steps would have it. A UserWarning names these. The curve
            keeps its points; further ones are at the new intervals.
        tensorboard: write logs into ``out/tensorboard``.
        progress: called after every rollout with the steps done and the last evaluated return.
        command: what was typed, to be kept in the files.

    Returns:
        What ``training.json`` holds: the training, the curve, the best return.

    Raises:
        ValueError: `extend` without `resume`; a target or setting that the environment refuses; a
            folder that holds another training, or this one without `resume`; a checkpoint that is
            damaged.
        OSError: the folder cannot be written to.
    """
    if extend and not resume:
        raise ValueError("extend = True: expected resume = True too")
    checkpoint = open_folder(out, "sb3", resume)
    saved = None
    if checkpoint.exists():
        saved = read_checkpoint(checkpoint)
        extended = extend and saved["training"].get("steps", training.steps) < training.steps
        check_same(checkpoint, saved["training"], training.plain(), extended)
        finished = finished_summary(out, saved, training.steps)
        if finished is not None:
            return finished
        if extended:
            _extend(saved, training)
    # Sums that threads share are rounded otherwise, and networks so small gain nothing by them.
    with ExitStack() as stack:
        stack.callback(torch.set_num_threads, torch.get_num_threads())
        torch.set_num_threads(1)
        run = _Run(training, out, progress, command)
        stack.callback(run.arms.close)
        return run.run(saved, tensorboard)


class _NoisyLengths(VecEnvWrapper):
    """White noise on every length, drawn where stable-baselines3 draws, and so saved with it."""

    def __init__(self, venv: Any, size: float) -> None:
        super().__init__(venv)
        self.size = size

    def reset(self) -> Any:
        return self._noisy(self.venv.reset())

    def step_wait(self) -> Any:
        lengths, *rest = self.venv.step_wait()
        return self._noisy(lengths), *rest

    def _noisy(self, lengths: Any) -> Any:
        drawn = np.random.uniform(-self.size, self.size, lengths.shape)  # noqa: NPY002
        return (lengths + drawn).astype(lengths.dtype)


class _Run(BaseCallback):
    """A training under way; it evaluates and saves between rollouts, when nothing is half done."""

    model: Any

    def __init__(
        self, training: Training, out: Path, progress: Progress | None, command: str | None
    ) -> None:
        super().__init__()
        self.training, self.out, self.command = training, out, command
        self.progress = progress or (lambda done, value: None)
        arguments = {"target": training.target, **training.env}
        self.hyperparameters = given = Hyperparameters.from_entries(training.hyperparameters)
        self.arms = make_sb3_vec_env(
            training.num_envs, seed=training.seed, **{"threads": 1, **given.env, **arguments}
        )
        self.monitor = VecMonitor(self.arms)
        self.seen = _NoisyLengths(self.monitor, training.noise) if training.noise else self.monitor
        normalize = {"gamma": given.arguments.get("gamma", 0.99), **given.normalize}
        self.envs = VecNormalize(self.seen, **normalize)
        self.judge = Judge(training, out, command)
        self.resumed = 0

    def run(self, saved: dict[str, Any] | None, tensorboard: bool) -> dict[str, Any]:
        kind = algorithm_class(self.training.algorithm)
        if saved is not None:
            self.restore(kind, saved)
        else:
            try:
                self.model = kind(
                    self.hyperparameters.policy,
                    self.envs,
                    seed=self.training.seed,
                    device="cpu",
                    **self.hyperparameters.model_arguments(),
                )
            except TypeError as error:
                name = self.training.algorithm
                raise ValueError(f"hyper-parameters of {name}: {error}") from None
        logs = str(self.out / "tensorboard")
        self.model.set_logger(configure(logs, ["tensorboard"]) if tensorboard else Logger(None, []))
        left = self.training.steps - self.model.num_timesteps
        self.judge.start()
        self.model.learn(left, callback=self, reset_num_timesteps=saved is None)
        policy = self.evaluate()
        write_atomically(self.out / "final_model.zip", self.model.save)
        write_atomically(self.out / "vecnormalize.pkl", lambda file: self.envs.save(str(file)))
        summary = self.judge.finish(policy, _PACKAGES, resumed=self.resumed)
        self.checkpoint()
        return summary

    def _on_rollout_start(self) -> None:
        done, curve = self.model.num_timesteps, self.judge.curve
        if self.judge.due(done):
            self.evaluate()
            self.checkpoint()
            self.judge.start()
        self.progress(done, curve[-1]["return"] if curve else float("nan"))

    def _on_step(self) -> bool:
        return True

    def evaluate(self) -> Policy:
        """Judge the policy as it is."""
        network = export_network(self.model, self.envs)
        policy = self.judge.judge(network, self.model.num_timesteps)
        self.model.logger.record("eval/return", policy.training["return"])
        return policy

    def checkpoint(self) -> None:
        """Save all that the rest of the training depends on."""
        arms = self.arms.vector_env.unwrapped
        state = {
            "training": self.training.plain(),
            "curve": self.judge.curve,
            "seconds": self.judge.seconds,
            "resumed": self.resumed,
            "extended": self.judge.extended,
            **training_state(self.model, self.envs, self.monitor, arms),
        }
        write_checkpoint(self.out / CHECKPOINTS["sb3"], self.model, state)

    def restore(self, kind: Any, saved: dict[str, Any]) -> None:
        judge = self.judge
        judge.curve, judge.seconds = saved["curve"], saved["seconds"]
        self.resumed, judge.extended = saved["resumed"] + 1, saved.get("extended", [])
        arms = self.arms.vector_env.unwrapped
        self.model, self.envs = restore_training(saved, kind, self.seen, self.monitor, arms)


def _extend(saved: dict[str, Any], training: Training) -> None:
    """Note in a checkpoint's state that it goes on for longer; warn of what depends on that."""
    schedules = Hyperparameters.from_entries(training.hyperparameters).schedules
    before = saved["training"]["steps"]
    entry = {"from_steps": before, "to_steps": training.steps, "schedules": schedules}
    saved["extended"] = [*saved.get("extended", []), entry]
    if schedules:
        warn(
            f"{', '.join(schedules)} of {training.algorithm} falls to zero over the whole training,"
            f" of {before:,} steps so far and now of {training.steps:,}: the result is not that of"
            f" a training of {training.steps:,} steps from the beginning",
            stacklevel=3,
        )
