"""What a method without the body makes of In(t): the columns beside the arm's in Task 1.

Every baseline is a set of features of the input's past, known at t, to which the same linear
readout is fitted on the same rows as to the arm's spring lengths. The constant is among the
features of each: the arm, whose rest lengths are a constant, has one too.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from octoarm_agents.reservoir.inputs import PEAK
from octoarm_env.arrays import Float

Features = Callable[[Float, np.random.Generator], Float]

DELAYS = {2: tuple(range(0, 201, 20)), 3: tuple(range(0, 201, 40))}
"""Delays [timesteps] by degree: over the 200 that the Volterra series reaches back, as many as make
the monomials about the arm's 80 springs: 11 delays give 78 of degree 2, 6 give 84 of degree 3."""

ESN_NODES = 80

ESN_SETTINGS: dict[str, float] = {
    "leak": 0.3,
    "spectral_radius": 0.5,
    "input_scaling": 0.1,
}
"""What ``python -m octoarm_agents.experiments.emulation.esn_search`` ranks first."""

ESN_BIAS = 0.5
"""Size of the nodes' random biases; without them tanh is odd, and no even task can be done."""


def powers(signal: Float, degree: int) -> Float:
    """1, In / 0.2, …, (In / 0.2)^degree: all polynomials of In(t), without memory. (T, degree + 1).

    Those of degree 1 are the paper's linear regressor, a In(t) + b.
    """
    return np.vander(signal / PEAK, degree + 1, increasing=True)


def delay_features(signal: Float, delays: Sequence[int]) -> Float:
    """In(t - d) / 0.2 for each delay d; zero before t = 0.

    Args:
        signal: In, (T,).
        delays: d [timesteps], none negative.

    Returns:
        (T, delays).

    Raises:
        ValueError: a negative delay.
    """
    if any(delay < 0 for delay in delays):
        raise ValueError(f"delays = {list(delays)}: expected none negative")
    features = np.zeros((len(signal), len(delays)))
    for column, delay in enumerate(delays):
        features[delay:, column] = signal[: max(len(signal) - delay, 0)] / PEAK
    return features


def delayed_polynomial(signal: Float, degree: int) -> Float:
    """All monomials up to a degree, 2 or 3, of In at the delays of `DELAYS`. (T, 78) or (T, 84).

    Numbers are scaled to [-1, 1] before they are multiplied, so that the columns are of like size.
    """
    from sklearn.preprocessing import PolynomialFeatures

    monomials: Float = PolynomialFeatures(degree).fit_transform(
        delay_features(signal, DELAYS[degree])
    )
    return monomials


def echo_state_network(
    signal: Float,
    random: np.random.Generator,
    *,
    leak: float = ESN_SETTINGS["leak"],
    spectral_radius: float = ESN_SETTINGS["spectral_radius"],
    input_scaling: float = ESN_SETTINGS["input_scaling"],
) -> Float:
    """States of a random network of 80 leaky tanh nodes (Jaeger 2001), and the constant.

    x(t) = (1 - a) x(t-1) + a tanh(W x(t-1) + W_in In(t) / 0.2 + b), from x = 0 before t = 0. W is
    sparse (a tenth of its entries), normal, and scaled to the spectral radius; W_in is dense, with
    entries ± the input scaling; b has entries ±0.5.

    Args:
        signal: In, (T,).
        random: gives W, W_in and b.
        leak: a, in (0, 1].
        spectral_radius: of W.
        input_scaling: size of the entries of W_in.

    Returns:
        (T, 81).
    """
    with warnings.catch_warnings():
        # Its docstrings hold backslashes that Python warns of when it compiles them.
        warnings.simplefilter("ignore", SyntaxWarning)
        warnings.simplefilter("ignore", DeprecationWarning)  # the same, before Python 3.12
        from reservoirpy.mat_gen import bernoulli
        from reservoirpy.nodes import Reservoir

    reservoir: Any = Reservoir(
        units=ESN_NODES,
        lr=leak,
        sr=spectral_radius,
        input_scaling=input_scaling,
        input_connectivity=1.0,
        rc_connectivity=0.1,
        bias=bernoulli(input_scaling=ESN_BIAS),
        seed=random,
    )
    states = reservoir.run(signal[:, np.newaxis] / PEAK)
    return np.hstack((np.ones((len(signal), 1)), states))


BASELINES: dict[str, Features] = {
    "linear_regressor": lambda signal, random: powers(signal, 1),
    "mean_predictor": lambda signal, random: powers(signal, 0),
    "cubic": lambda signal, random: powers(signal, 3),
    "delay2": lambda signal, random: delayed_polynomial(signal, 2),
    "delay3": lambda signal, random: delayed_polynomial(signal, 3),
    "esn80": echo_state_network,
}
"""Features by the baseline's name; only the last draws anything."""
