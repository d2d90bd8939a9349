"""What a policy computes, in NumPy: a normalisation and layers, from spring lengths to an action.

What stable-baselines3 trains holds critics, optimisers and the means to explore. To act takes the
actor's mean and the normalisation of its input; that much is kept here, needs no PyTorch, and takes
microseconds. A linear readout is the least of these networks: one layer, no normalisation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.floating[Any]]
State = tuple[Numbers, Numbers]
"""The memory of n episodes, (hidden, cell), both (n, H)."""

ACTIVATIONS: dict[str, Callable[[Numbers], Numbers]] = {
    "tanh": np.tanh,
    "relu": lambda values: np.maximum(values, 0),
}
"""Between the layers."""

OUTPUTS: dict[str, Callable[[Numbers], Numbers]] = {"clip": lambda values: values, "tanh": np.tanh}
"""After the last layer; both end within [-1, 1]."""

_NORMALISATION = ("mean", "scale")


@dataclass(frozen=True, eq=False)
class Lstm:
    """A layer of long short-term memory, gates in PyTorch's order (input, forget, cell, output).

    Attributes:
        input_weights: (4 H, inputs).
        hidden_weights: (4 H, H).
        bias: (4 H,).
    """

    input_weights: Numbers
    hidden_weights: Numbers
    bias: Numbers

    @property
    def size(self) -> int:
        """H, numbers of memory."""
        return int(self.hidden_weights.shape[1])

    def step(self, inputs: Numbers, state: State | None) -> State:
        """Advance the memory by one observation (n, inputs); None: the memory is still empty."""
        empty = np.zeros((len(inputs), self.size), self.bias.dtype)
        hidden, cell = (empty, empty) if state is None else state
        gates = inputs @ self.input_weights.T + hidden @ self.hidden_weights.T + self.bias
        taken, kept, candidate, shown = np.split(gates, 4, axis=1)
        cell = _sigmoid(kept) * cell + _sigmoid(taken) * np.tanh(candidate)
        return _sigmoid(shown) * np.tanh(cell), cell


@dataclass(frozen=True)
class Past:
    """The last observations beside the present one: a memory that is not the body's.

    Attributes:
        count: k, past observations.
    """

    count: int

    def step(self, inputs: Numbers, state: State | None) -> State:
        """Put an observation (n, inputs) before the last k; at the begin it stands for them too."""
        rows, width = inputs.shape
        seen = np.tile(inputs, self.count + 1)
        if state is not None:
            # Of an episode that has just begun it is empty.
            going_on = state[0].any(axis=1)
            seen[going_on, width:] = state[0][going_on, : self.count * width]
        return seen, np.zeros((rows, 0))


@dataclass(frozen=True, eq=False)
class Network:
    """From spring lengths to the two entries of an action.

    Lengths are normalised, (length - mean) · scale, limited to ±`clip`; then pass the memory, if
    there is one, and layer after layer. From the first layer on the precision is that of its
    weights: single for a trained network, double for a readout, whose weights are large and cancel
    each other.

    Attributes:
        mean: (springs,) [m], float64.
        scale: (springs,) [1/m], float64.
        clip: limit of a normalised length.
        layers: weights (out, in) and bias (out,) of each, from the first to the last.
        activation: one of `ACTIVATIONS`.
        output: one of `OUTPUTS`.
        memory: before the first layer, or None.
    """

    mean: NDArray[np.float64]
    scale: NDArray[np.float64]
    clip: float
    layers: tuple[tuple[Numbers, Numbers], ...]
    activation: str = "tanh"
    output: str = "clip"
    memory: Lstm | Past | None = None

    def __post_init__(self) -> None:
        for name, known in (("activation", ACTIVATIONS), ("output", OUTPUTS)):
            if getattr(self, name) not in known:
                raise ValueError(
                    f"{name} = {getattr(self, name)!r}: expected one of {sorted(known)}"
                )
        if not self.clip > 0:
            raise ValueError(f"clip = {self.clip}: expected a positive number")
        if self.mean.ndim != 1 or self.mean.shape != self.scale.shape:
            raise ValueError(
                f"mean and scale have shapes {self.mean.shape}, {self.scale.shape}, "
                "expected (springs,)"
            )
        width = self.springs
        if isinstance(self.memory, Past):
            width *= 1 + self.memory.count
        elif self.memory is not None:
            size = self.memory.size
            shapes = [each.shape for each in vars(self.memory).values()]
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
        if not all(np.isfinite(each).all() for each in self.arrays().values()):
            raise ValueError("the network holds numbers that are not finite")

    @property
    def outputs(self) -> int:
        """Entries of an action."""
        return len(self.layers[-1][0])

    @property
    def springs(self) -> int:
        """Number of lengths that it takes."""
        return self.mean.size

    @property
    def parameter_count(self) -> int:
        """Trained numbers that the action depends on.

        Neither the normalisation counts nor what is zero throughout, as a bias that is not there.
        """
        trained = (each for name, each in self.arrays().items() if name not in _NORMALISATION)
        return sum(each.size for each in trained if each.any())

    def actions(
        self, lengths: NDArray[np.float64], state: State | None
    ) -> tuple[NDArray[np.float32], State | None]:
        """Act on lengths (n, springs) [m]; actions (n, outputs) in [-1, 1], the next memory."""
        normalised = np.clip((lengths - self.mean) * self.scale, -self.clip, self.clip)
        values: Numbers = normalised.astype(self.layers[0][0].dtype)
        if self.memory is not None:
            state = self.memory.step(values, state)
            values = state[0]
        *hidden, (weights, bias) = self.layers
        for hidden_weights, hidden_bias in hidden:
            values = ACTIVATIONS[self.activation](values @ hidden_weights.T + hidden_bias)
        values = OUTPUTS[self.output](values @ weights.T + bias)
        return np.clip(values, -1, 1).astype(np.float32), state

    def arrays(self) -> dict[str, Numbers]:
        """All its arrays, by their names in a policy's file."""
        found: dict[str, Numbers] = {"mean": self.mean, "scale": self.scale}
        for index, (weights, bias) in enumerate(self.layers):
            found |= {f"weights_{index}": weights, f"bias_{index}": bias}
        if isinstance(self.memory, Lstm):
            found |= {f"lstm_{name}": each for name, each in vars(self.memory).items()}
        return found

    def describe(self) -> dict[str, Any]:
        """What a policy's file must know beside the arrays."""
        return {
            "activation": self.activation,
            "output": self.output,
            "clip": self.clip,
            "layers": len(self.layers),
            "memory": self.memory.size if isinstance(self.memory, Lstm) else 0,
            "past": self.memory.count if isinstance(self.memory, Past) else 0,
        }

    @classmethod
    def restore(cls, description: Mapping[str, Any], arrays: Mapping[str, Any]) -> Network:
        """Make the network of which `describe` and `arrays` gave these.

        Raises:
            ValueError: something is missing, or does not fit together; the message names it.
        """
        count = description.get("layers")
        if not isinstance(count, int) or not 0 < count <= 64:
            raise ValueError(f"network: layers = {count!r}, expected 1 to 64")
        try:
            memory: Lstm | Past | None = None
            past = description.get("past", 0)
            if past:
                if not isinstance(past, int) or not 0 < past <= 1000:
                    raise ValueError(f"network: past = {past!r}, expected 0 to 1000")
                memory = Past(past)
            elif description["memory"]:
                memory = Lstm(*(arrays[f"lstm_{field.name}"] for field in fields(Lstm)))
            return cls(
                mean=arrays["mean"],
                scale=arrays["scale"],
                clip=float(description["clip"]),
                layers=tuple((arrays[f"weights_{k}"], arrays[f"bias_{k}"]) for k in range(count)),
                activation=description["activation"],
                output=description["output"],
                memory=memory,
            )
        except KeyError as error:
            raise ValueError(f"{error} is missing") from None


def _sigmoid(values: Numbers) -> Numbers:
    # Exact like 1 / (1 + exp(-x)), and never overflows.
    result: Numbers = 0.5 * np.tanh(0.5 * values) + 0.5
    return result
