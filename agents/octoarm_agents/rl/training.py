"""Training on the native batch: evaluated on seeds of its own, and taken up where it was killed."""

from __future__ import annotations

import json
import random
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from warnings import warn

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger, configure
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from octoarm_agents.common.environment import inspect_env, make_vector_env
from octoarm_agents.common.files import write_atomically, write_json
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.whole import whole_number
from octoarm_agents.policies.evaluation import JUDGED_EPISODES, JUDGING_SEED
from octoarm_agents.policies.policy import Policy
from octoarm_agents.policies.rollout import roll_out
from octoarm_agents.rl.checkpoint import read_checkpoint, write_checkpoint
from octoarm_agents.rl.export import export_network
from octoarm_agents.rl.hyperparameters import Hyperparameters, algorithm_class
from octoarm_agents.rl.sb3_vec_env import Sb3VecEnv, make_sb3_vec_env

__all__ = ["CHECKPOINT", "SUMMARY", "Training", "train"]

CHECKPOINT = "checkpoint.zip"
SUMMARY = "training.json"

Progress = Callable[[int, float], None]


@dataclass(frozen=True)
class Training:
    """What is to be trained.

    Attributes:
        algorithm: one of `octoarm_agents.rl.ALGORITHMS`.
        target: of the environment.
        steps: environment steps over all environments.
        seed: of networks, exploration and environments.
        num_envs: environments that are stepped together.
        evaluations: number of evaluations, at equal intervals.
        episodes: of each evaluation.
        env: further arguments of the environment.
        hyperparameters: as in their file, under the environment's id.
    """

    algorithm: str
    target: str
    steps: int
    seed: int
    num_envs: int
    evaluations: int
    episodes: int
    env: dict[str, Any]
    hyperparameters: dict[str, Any]

    @classmethod
    def make(
        cls,
        algorithm: str,
        target: str,
        *,
        steps: int | None = None,
        seed: int = 0,
        num_envs: int | None = None,
        evaluations: int = 20,
        episodes: int = JUDGED_EPISODES,
        env: Mapping[str, Any] | None = None,
        hyperparameters: Hyperparameters | None = None,
    ) -> Training:
        """Describe a training; what is not given stands in the algorithm's own file.

        Raises:
            ValueError: a number out of its range, or an unknown algorithm.
        """
        algorithm_class(algorithm)
        given = hyperparameters or Hyperparameters.load(algorithm)
        steps = given.steps if steps is None else steps
        num_envs = given.num_envs if num_envs is None else num_envs
        return cls(
            algorithm,
            target,
            whole_number("steps", steps, 1),
            whole_number("seed", seed),
            whole_number("num_envs", num_envs, 1),
            whole_number("evaluations", evaluations, 1),
            whole_number("episodes", episodes, 1),
            dict(env or {}),
            given.entries(),
        )


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
    out.mkdir(parents=True, exist_ok=True)
    checkpoint = out / CHECKPOINT
    saved = None
    if checkpoint.exists():
        if not resume:
            raise ValueError(f"{out} holds a training: resume it, or choose another folder")
        saved = read_checkpoint(checkpoint)
        extended = extend and saved["training"].get("steps", training.steps) < training.steps
        _check_same(checkpoint, saved["training"], _plain(training), extended)
        finished = _finished(out, saved, training.steps)
        if finished is not None:
            return finished
        if extended and saved["started"]:
            _extend(saved, training)
    # Sums that threads share are rounded otherwise, and networks so small gain nothing by them.
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        run = _Run(training, out, command)
        try:
            return run.run(saved, tensorboard, progress)
        finally:
            run.envs.close()
    finally:
        torch.set_num_threads(threads)


class _Run:
    """A training under way."""

    def __init__(self, training: Training, out: Path, command: str | None) -> None:
        self.training = training
        self.out = out
        self.command = command
        arguments = {"target": training.target, **training.env}
        given = Hyperparameters.from_entries(training.hyperparameters)
        self.hyperparameters = given
        self.arms: Sb3VecEnv = make_sb3_vec_env(
            training.num_envs, seed=training.seed, **{"threads": 1, **given.env, **arguments}
        )
        self.monitor = VecMonitor(self.arms)
        normalize = {"gamma": given.arguments.get("gamma", 0.99), **given.normalize}
        self.envs = VecNormalize(self.monitor, **normalize)
        self.parameters, self.settings = _inspect(arguments)
        self.judges = make_vector_env(
            training.episodes, self.parameters, self.settings, steps=500, threads=1
        )
        self.curve: list[dict[str, Any]] = []
        self.best: dict[str, Any] | None = None
        self.seconds = 0.0
        self.resumed = 0
        self.extended: list[dict[str, Any]] = []
        self.model: Any = None

    def run(
        self, saved: dict[str, Any] | None, tensorboard: bool, progress: Progress | None
    ) -> dict[str, Any]:
        kind = algorithm_class(self.training.algorithm)
        if saved is None:
            try:
                self.model = kind(
                    self.hyperparameters.policy,
                    self.envs,
                    seed=self.training.seed,
                    device="cpu",
                    **self.hyperparameters.model_arguments(),
                )
            except TypeError as error:
                raise ValueError(
                    f"hyper-parameters of {self.training.algorithm}: {error}"
                ) from None
            # Before the first step, so that a training killed early can be resumed too.
            self.checkpoint(started=False)
        else:
            self.restore(kind, saved)
        if tensorboard:
            logger = configure(str(self.out / "tensorboard"), ["tensorboard"])
        else:
            logger = Logger(None, [])
        self.model.set_logger(logger)
        left = self.training.steps - self.model.num_timesteps
        self.begun = time.perf_counter()
        self.model.learn(
            left,
            callback=_Watcher(self, progress),
            reset_num_timesteps=saved is None or not saved["started"],
        )
        self.evaluate()
        return self.finish()

    @property
    def elapsed(self) -> float:
        """Seconds of training, evaluations not counted."""
        return self.seconds + time.perf_counter() - self.begun

    def policy(self) -> Policy:
        training = {
            **_plain(self.training),
            "trained_steps": self.model.num_timesteps,
            "command": self.command,
            "extended": self.extended,
        }
        return Policy(
            export_network(self.model, self.envs),
            self.training.algorithm,
            self.parameters,
            self.settings,
            training,
            self.training.seed,
        )

    def evaluate(self) -> None:
        """Let the policy act as it will be kept; keep it if it is the best so far."""
        self.seconds = self.elapsed
        policy = self.policy()
        returns = roll_out(policy, self.judges, seed=JUDGING_SEED).returns
        point = {
            "steps": self.model.num_timesteps,
            "seconds": self.seconds,
            "return": float(returns.mean()),
            "lowest": float(returns.min()),
            "highest": float(returns.max()),
        }
        self.curve.append(point)
        if self.best is None or point["return"] > self.best["return"]:
            self.best = point
            policy.training["return"] = point["return"]
            policy.save(self.out / "best.npz")
        self.model.logger.record("eval/return", point["return"])
        self.begun = time.perf_counter()

    def finish(self) -> dict[str, Any]:
        policy = self.policy()
        policy.training["return"] = self.curve[-1]["return"]
        policy.save(self.out / "final.npz")
        write_atomically(self.out / "final_model.zip", self.model.save)
        write_atomically(self.out / "vecnormalize.pkl", lambda file: self.envs.save(str(file)))
        summary = self.summary()
        write_json(self.out / SUMMARY, summary)
        self.checkpoint(started=True)
        return summary

    def summary(self) -> dict[str, Any]:
        return {
            "training": _plain(self.training),
            "command": self.command,
            "environment": self.settings,
            "curve": self.curve,
            "best": self.best,
            "final": self.curve[-1],
            "seconds": self.seconds,
            "resumed": self.resumed,
            "extended": self.extended,
            "parameters": self.policy().parameter_count,
            "machine": describe_machine(),
            "versions": package_versions(
                "octoarm-env",
                "octoarm-agents",
                "stable-baselines3",
                "sb3-contrib",
                "torch",
                "numpy",
            ),
        }

    def checkpoint(self, *, started: bool) -> None:
        """Save all that the rest of the training depends on."""
        self.model.policy.set_training_mode(False)
        write_checkpoint(
            self.out / CHECKPOINT,
            self.model,
            {
                "training": _plain(self.training),
                "started": started,
                "curve": self.curve,
                "best": self.best,
                "seconds": self.seconds,
                "resumed": self.resumed,
                "extended": self.extended,
                "normalization": self.envs if started else None,
                "normalized_returns": self.envs.returns,
                "episode_returns": self.monitor.episode_returns if started else None,
                "episode_lengths": self.monitor.episode_lengths if started else None,
                "memory": getattr(self.model, "_last_lstm_states", None),
                "arms": self.arms.vector_env.unwrapped.snapshot() if started else None,
                "python_random": random.getstate(),
                "numpy_random": np.random.get_state(),  # noqa: NPY002, stable-baselines3 draws here
                "torch_random": torch.get_rng_state(),
                "action_random": self.model.action_space.np_random.bit_generator.state,
            },
        )

    def restore(self, kind: Any, saved: dict[str, Any]) -> None:
        self.curve, self.best = saved["curve"], saved["best"]
        self.seconds, self.resumed = saved["seconds"], saved["resumed"] + 1
        self.extended = saved.get("extended", [])
        if saved["started"]:
            # The arms must have begun before they can go on.
            self.monitor.reset()
            self.envs = saved["normalization"]
            self.envs.set_venv(self.monitor)
        self.model = saved["load"](kind, self.envs)
        if saved["started"]:
            self.arms.vector_env.unwrapped.restore(saved["arms"])
            self.envs.returns = saved["normalized_returns"]
            self.monitor.episode_returns = saved["episode_returns"]
            self.monitor.episode_lengths = saved["episode_lengths"]
            if saved["memory"] is not None:
                self.model._last_lstm_states = saved["memory"]
        random.setstate(saved["python_random"])
        np.random.set_state(saved["numpy_random"])  # noqa: NPY002
        torch.set_rng_state(saved["torch_random"])
        self.model.action_space.np_random.bit_generator.state = saved["action_random"]


class _Watcher(BaseCallback):
    """Evaluates and saves between rollouts, when nothing is half done."""

    def __init__(self, run: _Run, progress: Progress | None) -> None:
        super().__init__()
        self._run = run
        self._progress = progress

    def _on_rollout_start(self) -> None:
        run = self._run
        done, training = self.model.num_timesteps, run.training
        last = run.curve[-1]["steps"] if run.curve else 0
        interval = training.steps / training.evaluations
        if done // interval > last // interval and done < training.steps:
            run.evaluate()
            run.checkpoint(started=True)
            run.begun = time.perf_counter()
        if self._progress is not None:
            self._progress(done, run.curve[-1]["return"] if run.curve else float("nan"))

    def _on_step(self) -> bool:
        return True


def _inspect(arguments: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    import gymnasium as gym

    env = gym.make("OctoArm-v0", **arguments)
    try:
        return inspect_env(env)
    finally:
        env.close()


def _plain(training: Training) -> dict[str, Any]:
    """A training as it reads in JSON."""
    content = asdict(training)
    if "arm" in content["env"]:
        content["env"] = {**training.env, "arm": training.env["arm"].to_dict()}
    plain: dict[str, Any] = json.loads(json.dumps(content, allow_nan=False))
    return plain


def _check_same(file: Path, saved: dict[str, Any], wanted: dict[str, Any], extended: bool) -> None:
    """Raise a ValueError where two trainings differ, but for their length if one is extended."""
    if extended:
        saved, wanted = (_without_length(each) for each in (saved, wanted))
    found = [
        f"{name} is {saved.get(name)!r} there and {value!r} here"
        for name, value in wanted.items()
        if saved.get(name) != value
    ]
    if found:
        raise ValueError(f"{file} is of another training: {'; '.join(found)}")


def _without_length(training: dict[str, Any]) -> dict[str, Any]:
    """A training but for what says how long it is and how often it is looked at."""
    rest = {key: training[key] for key in training if key not in ("steps", "evaluations")}
    given = rest["hyperparameters"]
    return rest | {"hyperparameters": {key: given[key] for key in given if key != "n_timesteps"}}


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


def _finished(out: Path, saved: dict[str, Any], steps: int) -> dict[str, Any] | None:
    """What a training that has ended left; None if it has not made so many steps."""
    curve = saved["curve"]
    if not curve or curve[-1]["steps"] < steps:
        return None
    try:
        summary: dict[str, Any] = json.loads((out / SUMMARY).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return summary
