"""A trained network as an agent: its deterministic actor alone, computed with NumPy.

What stable-baselines3 trains holds critics, optimisers and the means to explore. To act takes the
actor's mean and the normalisation of its input; that much is kept here, needs no PyTorch, and takes
microseconds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from octoarm_agents.common.environment import SETTINGS
from octoarm_env import ArmParameters

__all__ = ["ACTIVATIONS", "OUTPUTS", "Lstm", "Network", "NetworkPolicy"]

Single = NDArray[np.float32]
State = tuple[Single, Single]


def _relu(values: Single) -> Single:
    return np.maximum(values, np.float32(0))


def _identity(values: Single) -> Single:
    return values


ACTIVATIONS: dict[str, Callable[[Single], Single]] = {"tanh": np.tanh, "relu": _relu}
"""Between the layers."""

OUTPUTS: dict[str, Callable[[Single], Single]] = {"clip": _identity, "tanh": np.tanh}
"""After the last layer; both end within [-1, 1]."""


@dataclass(frozen=True, eq=False)
class Lstm:
    """A layer of long short-term memory, gates in PyTorch's order (input, forget, cell, output).

    Attributes:
        input_weights: (4 H, inputs).
        hidden_weights: (4 H, H).
        bias: (4 H,).
    """

    input_weights: Single
    hidden_weights: Single
    bias: Single

    @property
    def size(self) -> int:
        """H, numbers of memory."""
        return int(self.hidden_weights.shape[1])

    def step(self, inputs: Single, state: State) -> State:
        """Advance the memory (hidden, cell), both (n, H), by one observation (n, inputs)."""
        hidden, cell = state
        gates = inputs @ self.input_weights.T + hidden @ self.hidden_weights.T + self.bias
        taken, kept, candidate, shown = np.split(gates, 4, axis=1)
        cell = _sigmoid(kept) * cell + _sigmoid(taken) * np.tanh(candidate)
        return _sigmoid(shown) * np.tanh(cell), cell


@dataclass(frozen=True, eq=False)
class Network:
    """From spring lengths to the two entries of an action.

    Lengths are normalised, (length - mean) · scale, limited to ±`clip`; then pass the memory, if
    there is one, and layer after layer.

    Attributes:
        mean: (springs,) [m], float64.
        scale: (springs,) [1/m], float64.
        clip: limit of a normalised length.
        layers: weights (out, in) and bias (out,) of each, from the first to the last.
        activation: one of `ACTIVATIONS`.
        output: one of `OUTPUTS`.
        lstm: memory before the first layer, or None.
    """

    mean: NDArray[np.float64]
    scale: NDArray[np.float64]
    clip: float
    layers: tuple[tuple[Single, Single], ...]
    activation: str
    output: str
    lstm: Lstm | None = None

    def __post_init__(self) -> None:
        if self.activation not in ACTIVATIONS:
            raise ValueError(
                f"activation = {self.activation!r}: expected one of {sorted(ACTIVATIONS)}"
            )
        if self.output not in OUTPUTS:
            raise ValueError(f"output = {self.output!r}: expected one of {sorted(OUTPUTS)}")
        if not self.clip > 0:
            raise ValueError(f"clip = {self.clip}: expected a positive number")
        if self.mean.ndim != 1 or self.mean.shape != self.scale.shape:
            raise ValueError(
                f"mean and scale have shapes {self.mean.shape}, {self.scale.shape}, "
                "expected (springs,)"
            )
        width = self.mean.size
        if self.lstm is not None:
            size = self.lstm.size
            shapes = [each.shape for each in vars(self.lstm).values()]
            if shapes != [(4 * size, width), (4 * size, size), (4 * size,)]:
                raise ValueError(f"lstm has shapes {shapes}, which do not fit {width} springs")
            width = size
        if not self.layers:
            raise ValueError("layers is empty: expected at least one")
        for index, (weights, bias) in enumerate(self.layers):
            if weights.ndim != 2 or weights.shape[1] != width or bias.shape != weights.shape[:1]:
                raise ValueError(
                    f"layers[{index}] has shapes {weights.shape} and {bias.shape}, "
                    f"expected {width} inputs"
                )
            width = len(weights)
        if width != 2:
            raise ValueError(f"layers lead to {width} outputs, expected 2")
        arrays: list[NDArray[Any]] = [
            self.mean,
            self.scale,
            *(each for layer in self.layers for each in layer),
        ]
        arrays += [] if self.lstm is None else list(vars(self.lstm).values())
        if not all(np.isfinite(each).all() for each in arrays):
            raise ValueError("the network holds numbers that are not finite")

    @property
    def springs(self) -> int:
        """Number of lengths that it takes."""
        return self.mean.size

    @property
    def parameter_count(self) -> int:
        """Trained numbers that the action depends on; the normalisation is not counted."""
        count = sum(weights.size + bias.size for weights, bias in self.layers)
        if self.lstm is not None:
            count += sum(each.size for each in vars(self.lstm).values())
        return count

    def initial_state(self, count: int) -> State | None:
        """Give the memory at the begin of `count` episodes."""
        if self.lstm is None:
            return None
        shape = (count, self.lstm.size)
        return np.zeros(shape, np.float32), np.zeros(shape, np.float32)

    def actions(
        self, lengths: NDArray[np.float64], state: State | None
    ) -> tuple[Single, State | None]:
        """Act on lengths (n, springs) [m]; actions (n, 2) in [-1, 1], and the next memory."""
        normalised = np.clip((lengths - self.mean) * self.scale, -self.clip, self.clip)
        values = normalised.astype(np.float32)
        if self.lstm is not None:
            state = self.lstm.step(values, state or _missing())
            values = state[0]
        activation = ACTIVATIONS[self.activation]
        *hidden, (weights, bias) = self.layers
        for hidden_weights, hidden_bias in hidden:
            values = activation(values @ hidden_weights.T + hidden_bias)
        values = OUTPUTS[self.output](values @ weights.T + bias)
        return np.clip(values, np.float32(-1), np.float32(1)), state


class NetworkPolicy:
    """Acts by a trained network; signature of a stable-baselines3 policy.

    Args:
        network: from the spring lengths to the action.
        algorithm: what trained it: ``"ppo"``, …
        parameters: the body it was trained on.
        settings: the environment it was trained in: `target`, `amplitude` [degrees],
            `control_period` [s], `actuator` and `action_range` [degrees], as in
            `octoarm_env.OctoArmEnv`.
        training: how it was trained, names with plain numbers and texts.
        seed: of the training.

    Raises:
        ValueError: a network for another number of springs, or settings that are not these.
    """

    def __init__(
        self,
        network: Network,
        algorithm: str,
        parameters: ArmParameters,
        settings: Mapping[str, Any],
        training: Mapping[str, Any] | None = None,
        seed: int | None = None,
    ) -> None:
        springs = 4 * parameters.compartments
        if network.springs != springs:
            raise ValueError(
                f"network takes {network.springs} lengths, the body has {springs} springs"
            )
        if set(settings) != set(SETTINGS):
            raise ValueError(f"settings holds {sorted(settings)}, expected {sorted(SETTINGS)}")
        self.network = network
        self.algorithm = algorithm
        self.parameters = parameters
        self.settings = dict(settings)
        self.training = dict(training or {})
        self.seed = seed

    @property
    def parameter_count(self) -> int:
        """Trained numbers that the action depends on."""
        return self.network.parameter_count

    def predict(
        self,
        observation: ArrayLike | dict[str, Any],
        state: Any = None,
        episode_start: ArrayLike | None = None,
        deterministic: bool = True,
    ) -> tuple[Single, Any]:
        """Act on one observation, or on one of each of n environments.

        Args:
            observation: spring lengths, (springs,) or (n, springs) [m].
            state: the memory that the last call gave back; None: an episode begins. Networks
                without memory give it back as it is.
            episode_start: which episodes begin now, (n,) bool; their memory is emptied.
            deterministic: not used, the policy always is.

        Returns:
            The action, (2,) or (n, 2) float32 in [-1, 1], and the state.

        Raises:
            ValueError: an observation of another shape, or with numbers that are not finite.
        """
        del deterministic
        lengths = np.asarray(observation, dtype=np.float64)
        springs = self.network.springs
        if lengths.ndim not in (1, 2) or lengths.shape[-1] != springs:
            raise ValueError(
                f"observation has shape {lengths.shape}, expected ({springs},) or (n, {springs})"
            )
        if not np.isfinite(lengths).all():
            raise ValueError("observation holds numbers that are not finite")
        rows = np.atleast_2d(lengths)
        if self.network.lstm is not None:
            state = self._memory(state, episode_start, len(rows))
        actions, state = self.network.actions(rows, state)
        return (actions if lengths.ndim == 2 else actions[0]), state

    def _memory(self, state: Any, episode_start: Any, count: int) -> State | None:
        if state is None:
            return self.network.initial_state(count)
        hidden, cell = state
        if episode_start is not None:
            going_on = 1 - np.asarray(episode_start, dtype=np.float32).reshape(-1, 1)
            hidden, cell = hidden * going_on, cell * going_on
        return hidden, cell


def _sigmoid(values: Single) -> Single:
    # Exact like 1 / (1 + exp(-x)), and never overflows.
    half = np.float32(0.5)
    result: Single = half * np.tanh(half * values) + half
    return result


def _missing() -> State:
    raise ValueError("state is None: a network with memory needs its initial_state first")
