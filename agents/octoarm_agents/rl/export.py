"""From a model of stable-baselines3 to the policy that is kept of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecNormalize

from octoarm_agents.policies.network import Lstm, Network

_ACTIVATIONS = {torch.nn.Tanh: "tanh", torch.nn.ReLU: "relu"}


def export_network(model: Any, normalization: VecNormalize) -> Network:
    """Take the deterministic actor out of a model, with the normalisation it was trained with.

    Args:
        model: a PPO, RecurrentPPO, SAC or TQC with an "Mlp" policy.
        normalization: of its observations.

    Returns:
        A network that acts as ``model.predict(..., deterministic=True)`` does, to the rounding of
        single precision.

    Raises:
        ValueError: a model whose actor is made of other parts.
    """
    policy = model.policy
    lstm = None
    # On-policy policies have an action_net, the others an actor of their own.
    if hasattr(policy, "action_net"):
        parts = [*policy.mlp_extractor.policy_net, policy.action_net]
        output = "clip"
        if hasattr(policy, "lstm_actor"):
            lstm = _lstm(policy.lstm_actor)
    else:
        parts, output = [*policy.actor.latent_pi, policy.actor.mu], "tanh"
    layers, activation = layers_of(parts)
    mean, scale, clip = _normalization(normalization)
    return Network(mean, scale, clip, layers, activation, output, lstm)


def layers_of(parts: list[Any]) -> tuple[tuple[tuple[Any, Any], ...], str]:
    """Weights and biases of an actor's linear parts, and the activation between them.

    Raises:
        ValueError: parts of another kind.
    """
    linear = [part for part in parts if isinstance(part, torch.nn.Linear)]
    between = {type(part) for part in parts if not isinstance(part, torch.nn.Linear)}
    if not between:
        between = {torch.nn.Tanh}
    if len(between) != 1 or not between <= _ACTIVATIONS.keys():
        names = sorted(kind.__name__ for kind in between)
        raise ValueError(f"the actor holds {names}: expected layers with tanh or relu between")
    layers = tuple((_array(part.weight), _array(part.bias)) for part in linear)
    return layers, _ACTIVATIONS[between.pop()]


def _lstm(part: torch.nn.LSTM) -> Lstm:
    if part.num_layers != 1:
        raise ValueError(f"the memory has {part.num_layers} layers: expected 1")
    biases: Any = (part.bias_ih_l0, part.bias_hh_l0)
    return Lstm(_array(part.weight_ih_l0), _array(part.weight_hh_l0), _array(sum(biases)))


def _normalization(
    normalization: VecNormalize,
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    springs = normalization.observation_space.shape
    if springs is None or len(springs) != 1:
        raise ValueError(f"observations have shape {springs}: expected (springs,)")
    if not normalization.norm_obs:
        return np.zeros(springs), np.ones(springs), float(np.finfo(np.float32).max)
    statistics: Any = normalization.obs_rms
    scale = 1 / np.sqrt(statistics.var + normalization.epsilon)
    return statistics.mean.copy(), scale, float(normalization.clip_obs)


def _array(tensor: Any) -> NDArray[np.float32]:
    array: NDArray[np.float32] = tensor.detach().cpu().numpy().astype(np.float32, copy=True)
    return array
