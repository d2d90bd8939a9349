"""Proximal policy optimisation by RLlib: the arms of one training shared out among Ray's workers.

RLlib (its new API stack) steps the native batch and learns; the hyper-parameters are those of
`octoarm train ppo`, and what is kept is the same policy file. Lengths are normalised by constants
that are measured before the training: all workers agree on them, and they are part of the policy.
"""

from __future__ import annotations

import json
import pickle
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import VectorEnv, VectorObservationWrapper
from numpy.typing import NDArray

try:
    import ray
    from ray.rllib.algorithms.algorithm import Algorithm
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.algorithms.ppo.torch.default_ppo_torch_rl_module import DefaultPPOTorchRLModule
    from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
    from ray.rllib.core.rl_module.rl_module import RLModuleSpec
    from ray.tune.registry import register_env
except ImportError as error:
    raise ImportError(
        f'{error}. RLlib needs more packages: pip install "octoarm-agents[ray,rllib]"'
    ) from error


from octoarm_agents.common.environment import ENV_ID
from octoarm_agents.common.files import atomic_file
from octoarm_agents.common.whole import whole_number
from octoarm_agents.common.workers import check_installed, installed
from octoarm_agents.policies.network import Network
from octoarm_agents.rl.export import layers_of
from octoarm_agents.rl.hyperparameters import Hyperparameters
from octoarm_agents.rl.judging import Judge, Progress
from octoarm_agents.rl.task import Training, check_same, open_folder

NORMALISED = "OctoArmNormalised"
"""The name under which Ray knows `make_arms`."""

_SCALE_ARMS, _SCALE_STEPS = 32, 100
_CLIP = 10.0


class _NormalisedArms(VectorObservationWrapper):
    """Lengths less their mean, over their deviation; and no two workers see the same episodes."""

    def __init__(self, arms: VectorEnv[Any, Any, Any], mean: Any, scale: Any) -> None:
        super().__init__(arms)
        self.mean, self.scale = mean, scale
        self.single_observation_space = gym.spaces.Box(-_CLIP, _CLIP, mean.shape)
        self.observation_space = gym.vector.utils.batch_space(
            self.single_observation_space, self.num_envs
        )

    def reset(self, *, seed: Any = None, options: Any = None) -> Any:
        # RLlib's workers begin with consecutive seeds, and so does each of their arms.
        return super().reset(seed=None if seed is None else seed * self.num_envs, options=options)

    def observations(self, observations: Any) -> Any:
        lengths = (observations - self.mean) * self.scale
        return np.clip(lengths, -_CLIP, _CLIP).astype(np.float32)


def make_arms(config: Mapping[str, Any]) -> VectorEnv[Any, Any, Any]:
    """Make a worker's arms.

    Args:
        config: ``num_envs``; ``mean`` [m] and ``scale`` [1/m] of the lengths, both (springs,); what
            `installed` gave where the training began; and arguments of ``OctoArm-v0``.
    """
    arguments = dict(config)
    check_installed(arguments.pop("installed"))
    mean, scale = arguments.pop("mean"), arguments.pop("scale")
    arms = gym.make_vec(ENV_ID, vectorization_mode="vector_entry_point", **arguments)
    return _NormalisedArms(arms, mean, scale)


def measure_scales(
    arguments: Mapping[str, Any], seed: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean [m] and inverse deviation [1/m] of the lengths, both (springs,), at random actions.

    Args:
        arguments: of ``OctoArm-v0``.
        seed: of actions and episodes.
    """
    arms = gym.make_vec(
        ENV_ID, num_envs=_SCALE_ARMS, vectorization_mode="vector_entry_point", **arguments
    )
    arms.action_space.seed(seed)
    rows = [arms.reset(seed=seed)[0].copy()]
    rows += [arms.step(arms.action_space.sample())[0].copy() for _ in range(_SCALE_STEPS)]
    arms.close()
    lengths = np.concatenate(rows)
    return lengths.mean(axis=0), 1 / lengths.std(axis=0)


class _Module(DefaultPPOTorchRLModule):  # type: ignore[misc]
    """RLlib's own network; the hyper-parameters give the first deviation of its actions."""

    def setup(self) -> None:
        super().setup()
        with torch.no_grad():
            self.pi.log_std.fill_(self.model_config["log_std_init"])


def ppo_config(training: Training, workers: int) -> PPOConfig:
    """RLlib's configuration of a training, to be built, or changed first.

    What the hyper-parameters say of `VecNormalize` does not count: lengths are scaled by
    `measure_scales`, rewards are left as they are.

    Args:
        training: of "ppo", whose arms the workers share equally.
        workers: processes that step arms; 0: the process that learns steps them too.

    Raises:
        ValueError: another algorithm, or hyper-parameters that are not translated; arms that the
            workers cannot share.
    """
    given = Hyperparameters.from_entries(training.hyperparameters)
    shares = max(whole_number("workers", workers), 1)
    if training.num_envs % shares:
        raise ValueError(
            f"num_envs = {training.num_envs}: expected a multiple of {shares}, the workers"
        )
    arguments, kwargs = dict(given.arguments), dict(given.arguments.get("policy_kwargs", {}))
    arguments.pop("policy_kwargs", None)
    rate = arguments.pop("learning_rate", 3e-4)
    if isinstance(rate, str):
        rate = [[0, float(rate.removeprefix("lin_"))], [training.steps, 0.0]]
    model = DefaultModelConfig(
        fcnet_hiddens=kwargs.pop("net_arch", [64, 64]),
        fcnet_activation="tanh",
        free_log_std=True,
        vf_share_layers=False,
    )
    deviation = {"log_std_init": kwargs.pop("log_std_init", 0.0)}
    learning = {
        "train_batch_size_per_learner": training.num_envs * arguments.pop("n_steps", 2048),
        "minibatch_size": arguments.pop("batch_size", 64),
        "num_epochs": arguments.pop("n_epochs", 10),
        "gamma": arguments.pop("gamma", 0.99),
        "lambda_": arguments.pop("gae_lambda", 0.95),
        "clip_param": arguments.pop("clip_range", 0.2),
        "entropy_coeff": arguments.pop("ent_coef", 0.0),
        "vf_loss_coeff": arguments.pop("vf_coef", 0.5),
        "grad_clip": arguments.pop("max_grad_norm", 0.5),
    }
    for name, value, expected in (
        ("algorithm", training.algorithm, "ppo"),
        ("policy", given.policy, "MlpPolicy"),
        ("further hyper-parameters", {**arguments, **kwargs}, {}),
        ("schedules", [key for key, each in learning.items() if isinstance(each, str)], []),
    ):
        if value != expected:
            raise ValueError(f"{name} = {value!r}: with RLlib expected {expected!r}")
    env = {"target": training.target, **training.env}
    mean, scale = measure_scales(env, training.seed)
    config = {**given.env, **env, "length_noise": training.noise, "installed": installed()}
    config |= {"mean": mean, "scale": scale}
    register_env(NORMALISED, make_arms)
    return (
        PPOConfig()
        .environment(NORMALISED, env_config={"threads": 1, **config})
        .env_runners(
            num_env_runners=workers,
            num_envs_per_env_runner=training.num_envs // shares,
            gym_env_vectorize_mode=gym.VectorizeMode.VECTOR_ENTRY_POINT,
        )
        .training(lr=rate, use_kl_loss=False, vf_clip_param=float("inf"), **learning)
        .rl_module(
            rl_module_spec=RLModuleSpec(
                module_class=_Module, model_config=asdict(model) | deviation
            )
        )
        .debugging(seed=training.seed, log_level="ERROR")
    )


def export_network(algorithm: Algorithm) -> Network:
    """Take the deterministic actor out of what `ppo_config` built, with its normalisation."""
    module: Any = algorithm.get_module()
    layers, activation = layers_of([*module.encoder.actor_encoder.net.mlp, *module.pi.net.mlp])
    given: Any = algorithm.config
    mean, scale = given.env_config["mean"], given.env_config["scale"]
    return Network(mean, scale, _CLIP, layers, activation)


def train(
    training: Training,
    out: Path,
    *,
    workers: int = 2,
    resume: bool = False,
    progress: Progress | None = None,
    command: str | None = None,
) -> dict[str, Any]:
    """Train an agent by PPO on Ray: the cluster that this process is connected to, or this machine.

    Writes ``best.npz``, ``final.npz`` and ``training.json`` as `octoarm_agents.rl.train` does, and
    a checkpoint at every evaluation. Workers answer when they can, so nothing promises
    that the same seed gives the same bits.

    Args:
        training: what to train.
        out: folder; made if it is not there.
        workers: as of `ppo_config`.
        resume: go on from the last checkpoint in `out`; begin where there is none. A training that
            is finished is not trained again.
        progress: called after every iteration with the steps done and the last evaluated return.
        command: what was typed, to be kept in the files.

    Returns:
        What ``training.json`` holds.

    Raises:
        ValueError: as of `ppo_config`; a folder that holds another training, or this one without
            `resume`.
        OSError: the folder cannot be written to.
    """
    checkpoint = open_folder(out, "rllib", resume)
    saved = None
    if checkpoint.exists():
        saved = _load(checkpoint, training)
        if (out / "training.json").exists():
            # It has been trained to its end.
            summary: dict[str, Any] = json.loads((out / "training.json").read_text("utf-8"))
            return summary
    config = ppo_config(training, workers)
    started = not ray.is_initialized()
    if started:
        ray.init(num_cpus=workers + 1, include_dashboard=False, log_to_driver=False)
    algorithm = None
    try:
        algorithm = config.build_algo()
        judge = Judge(training, out, command)
        steps = 0
        if saved is not None:
            judge.curve, judge.seconds, steps = (
                saved[key] for key in ("curve", "seconds", "steps")
            )
            algorithm.set_state(saved["algorithm"])
        while True:
            if judge.due(steps):
                judge.judge(export_network(algorithm), steps)
                _save(checkpoint, judge, steps, algorithm)
                judge.start()
            if progress is not None:
                progress(steps, judge.curve[-1]["return"] if judge.curve else float("nan"))
            if steps >= training.steps:
                break
            steps = int(algorithm.train()["env_runners"]["num_env_steps_sampled_lifetime"])
        policy = judge.judge(export_network(algorithm), steps)
        made = judge.finish(policy, ("ray", "torch"), engine="rllib", workers=workers)
        _save(checkpoint, judge, steps, algorithm)
        return made
    finally:
        if algorithm is not None:
            algorithm.stop()
        if started:
            ray.shutdown()


def _load(file: Path, training: Training) -> dict[str, Any]:
    """What `_save` wrote of this training."""
    try:
        saved: dict[str, Any] = pickle.loads(file.read_bytes())
    except Exception as error:
        raise ValueError(f"{file} is damaged: {error}") from None
    check_same(file, saved["training"], training.plain())
    return saved


def _save(file: Path, judge: Judge, steps: int, algorithm: Algorithm) -> None:
    """Write all that the rest of the training depends on, but for the arms: they begin anew."""
    state = {
        "training": judge.training.plain(),
        "curve": judge.curve,
        "seconds": judge.seconds,
        "steps": steps,
        "algorithm": algorithm.get_state(),
    }
    with atomic_file(file) as path:
        path.write_bytes(pickle.dumps(state))
