"""Training on the native batch: evaluated on seeds of its own, and taken up where it was killed."""

from __future__ import annotations

import json
import random
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from warnings import warn

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger, configure
from stable_baselines3.common.vec_env import VecEnvWrapper, VecMonitor, VecNormalize

from octoarm_agents.common.environment import ENV_ID, inspect_env, make_vector_env
from octoarm_agents.common.files import write_atomically, write_json
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.whole import whole_fields
from octoarm_agents.policies.evaluation import JUDGED_EPISODES, JUDGING_SEED
from octoarm_agents.policies.policy import Policy
from octoarm_agents.policies.rollout import roll_out
from octoarm_agents.rl.checkpoint import read_checkpoint, write_checkpoint
from octoarm_agents.rl.export import export_network
from octoarm_agents.rl.hyperparameters import Hyperparameters, algorithm_class
from octoarm_agents.rl.sb3_vec_env import make_sb3_vec_env

JUDGED_STEPS = 500
"""Control periods of the episodes that a policy is evaluated in: those of the standard episode."""

_PACKAGES = ("octoarm-env", "octoarm-agents", "stable-baselines3", "sb3-contrib", "torch", "numpy")
"""Their versions are written down."""

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
        noise: half width of white noise on the lengths that are trained with [m]; evaluations have
            none.

    Raises:
        ValueError: a number out of its range, or an unknown algorithm.
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
    noise: float = 0.0

    def __post_init__(self) -> None:
        algorithm_class(self.algorithm)
        if not 0 <= self.noise < 1:
            raise ValueError(f"noise = {self.noise}: expected a number of metres from 0 to 1")
        whole_fields(self, steps=1, seed=0, num_envs=1, evaluations=1, episodes=1)

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
        noise: float = 0.0,
    ) -> Training:
        """Describe a training; what is not given stands in the algorithm's own file."""
        given = hyperparameters or Hyperparameters.load(algorithm)
        return cls(
            algorithm,
            target,
            given.steps if steps is None else steps,
            seed,
            given.num_envs if num_envs is None else num_envs,
            evaluations,
            episodes,
            dict(env or {}),
            given.entries(),
            noise,
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
    checkpoint = out / "checkpoint.zip"
    saved = None
    if checkpoint.exists():
        if not resume:
            raise ValueError(
                f"{out} holds a training: resume it (--resume), or choose another folder"
            )
        saved = read_checkpoint(checkpoint)
        extended = extend and saved["training"].get("steps", training.steps) < training.steps
        _check_same(checkpoint, saved["training"], _plain(training), extended)
        finished = _finished(out, saved, training.steps)
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
        self.parameters, self.settings = inspect_env(gym.make(ENV_ID, **arguments))
        self.judges = make_vector_env(
            training.episodes, self.parameters, self.settings, steps=JUDGED_STEPS, threads=1
        )
        self.curve: list[dict[str, Any]] = []
        self.seconds = 0.0
        self.resumed = 0
        self.extended: list[dict[str, Any]] = []

    @property
    def best(self) -> dict[str, Any]:
        """The first of the points with the highest return."""
        return max(self.curve, key=lambda point: float(point["return"]))

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
        self.begun = time.perf_counter()
        self.model.learn(left, callback=self, reset_num_timesteps=saved is None)
        policy = self.evaluate()
        policy.save(self.out / "final.npz")
        write_atomically(self.out / "final_model.zip", self.model.save)
        write_atomically(self.out / "vecnormalize.pkl", lambda file: self.envs.save(str(file)))
        summary = {
            "training": _plain(self.training),
            "command": self.command,
            "environment": self.settings,
            "curve": self.curve,
            "best": self.best,
            "final": self.curve[-1],
            "seconds": self.seconds,
            "resumed": self.resumed,
            "extended": self.extended,
            "parameters": policy.parameter_count,
            "machine": describe_machine(),
            "versions": package_versions(*_PACKAGES),
        }
        write_json(self.out / "training.json", summary)
        self.checkpoint()
        return summary

    def _on_rollout_start(self) -> None:
        done, interval = self.model.num_timesteps, self.training.steps / self.training.evaluations
        last = self.curve[-1]["steps"] if self.curve else 0
        if done // interval > last // interval and done < self.training.steps:
            self.evaluate()
            self.checkpoint()
            self.begun = time.perf_counter()
        self.progress(done, self.curve[-1]["return"] if self.curve else float("nan"))

    def _on_step(self) -> bool:
        return True

    def evaluate(self) -> Policy:
        """Let the policy act as it will be kept; keep it if it is the best so far."""
        self.seconds += time.perf_counter() - self.begun
        policy = Policy(
            export_network(self.model, self.envs),
            self.training.algorithm,
            self.parameters,
            self.settings,
            {
                **_plain(self.training),
                "trained_steps": self.model.num_timesteps,
                "command": self.command,
                "extended": self.extended,
            },
            self.training.seed,
        )
        returns = roll_out(policy, self.judges, seed=JUDGING_SEED, steps=JUDGED_STEPS).returns
        point = {
            "steps": self.model.num_timesteps,
            "seconds": self.seconds,
            "return": float(returns.mean()),
            "lowest": float(returns.min()),
            "highest": float(returns.max()),
        }
        policy.training["return"] = point["return"]
        self.curve.append(point)
        if self.best is point:
            policy.save(self.out / "best.npz")
        self.model.logger.record("eval/return", point["return"])
        return policy

    def checkpoint(self) -> None:
        """Save all that the rest of the training depends on."""
        self.model.policy.set_training_mode(False)
        state = {
            "training": _plain(self.training),
            "curve": self.curve,
            "seconds": self.seconds,
            "resumed": self.resumed,
            "extended": self.extended,
            "normalization": self.envs,
            "normalized_returns": self.envs.returns,
            "episode_returns": self.monitor.episode_returns,
            "episode_lengths": self.monitor.episode_lengths,
            "memory": getattr(self.model, "_last_lstm_states", None),
            "arms": self.arms.vector_env.unwrapped.snapshot(),
            "python_random": random.getstate(),
            "numpy_random": np.random.get_state(),  # noqa: NPY002, stable-baselines3 draws here
            "torch_random": torch.get_rng_state(),
            "action_random": self.model.action_space.np_random.bit_generator.state,
        }
        write_checkpoint(self.out / "checkpoint.zip", self.model, state)

    def restore(self, kind: Any, saved: dict[str, Any]) -> None:
        self.curve, self.seconds = saved["curve"], saved["seconds"]
        self.resumed, self.extended = saved["resumed"] + 1, saved.get("extended", [])
        # The arms must have begun before they can go on.
        self.monitor.reset()
        self.envs = saved["normalization"]
        self.envs.set_venv(self.seen)
        self.model = saved["load"](kind, self.envs)
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


def _plain(training: Training) -> dict[str, Any]:
    """A training as it reads in JSON."""
    content = asdict(training)
    if not isinstance(training.env.get("arm", ""), str):
        content["env"] = {**training.env, "arm": training.env["arm"].to_dict()}
    plain: dict[str, Any] = json.loads(json.dumps(content, allow_nan=False))
    return plain


def _check_same(file: Path, saved: dict[str, Any], wanted: dict[str, Any], extended: bool) -> None:
    """Raise a ValueError where two trainings differ, but for their length if one is extended."""
    saved = {"noise": 0.0, **saved}  # of before there was any
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
        summary: dict[str, Any] = json.loads((out / "training.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return summary
