"""The readout that stands noise, designed from how the arm in its loop answers to small errors.

A fit knows what the lengths are on the orbit; it does not know what becomes of an error. In the
loop an error of the command moves the arm, the lengths change, the readout answers, period after
period. To first order all of that is known beforehand. Let d(t) be what the base is told beside the
clock's command, and H(t, k) how the lengths of period t answer to d(k), k < t, which the
environment itself shows. A readout with weights W and bias b that reads the noise n has

    d(t) = Wᵀ (Σ_k H(t, k) d(k) + n(t)) + e(t),   e(t) = Wᵀ s(t) + b - u(t),

with the lengths s and the actions u along the clock's orbit. Over a whole episode that is

    d = D (e + Wᵀ n),   D = (1 - Wᵀ H)⁻¹,

Gaussian with a mean m(t) and a covariance Σ(t) that are known; and so is the expected return, since
the reward is a bell of the error:

    E exp(-|d|²/w²) = |1 + 2 Σ/w²|^(-1/2) exp(-mᵀ (w² + 2 Σ)⁻¹ m).

Its gradient by W and b is known too. Quasi-Newton steps (L-BFGS-B of SciPy), from the best of some
ridges on, find the readout that earns most at given levels of noise. To first order no readout
nearby earns more: what is found is a bound for linear readouts as well as one of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import lapack
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from octoarm_agents.common.environment import SETTINGS
from octoarm_agents.common.whole import whole_number
from octoarm_agents.policies.policy import Policy
from octoarm_agents.reservoir.policy import readout_network
from octoarm_agents.reservoir.readout import Readout
from octoarm_env import EpisodeSettings, OctoArmVectorEnv
from octoarm_env.arrays import Float

NOISES = (0.0, 1e-6, 1e-5, 3e-5)
"""Half widths of the noise on the lengths that a readout is designed for [m]."""

_RIDGES = (1e-7, 3e-7, 1e-6, 3e-6, 1e-5, 3e-5, 1e-4, 3e-4)
"""ν of the ridges of which the best is the begin [m]."""

_NUDGE = 1e-5
"""Size of the error whose consequences are watched [of the action range]. Errors a hundred times
larger turn the water's flow over at other moments, which bends the answer by some per cent."""


@dataclass(frozen=True)
class LoopModel:
    """How an arm about the clock's orbit answers to small errors of its command.

    Attributes:
        settings: of the environment; amplitude and action range as they are.
        lengths: s, (T, springs) [m], before each of the clock's actions.
        actions: u, (T, 2), the clock's.
        responses: H: of each period t, (springs, 2 t) [m]: what the lengths are off by for an error
            of 1 in each entry of the actions before.
    """

    settings: EpisodeSettings
    lengths: Float
    actions: Float
    responses: tuple[Float, ...]

    @classmethod
    def measure(cls, settings: EpisodeSettings, periods: int = 500, *, seed: int = 0) -> LoopModel:
        """Watch 2 T + 1 episodes side by side, one undisturbed and one for each small error.

        Args:
            settings: of the environment.
            periods: T, control periods of an episode.
            seed: draws the phase at which they begin.

        Raises:
            ValueError: a number out of its range, or an arm that leaves its domain.
        """
        periods, seed = whole_number("periods", periods, 2), whole_number("seed", seed)
        arguments = {name: getattr(settings, name) for name in settings.to_dict()}
        errors, responses = np.empty(2 * periods), []
        with closing(
            OctoArmVectorEnv(2 * periods + 1, **arguments, max_episode_steps=None)
        ) as envs:
            phase = float(np.random.default_rng(seed).uniform())
            seen, _ = envs.reset(seed=seed, options={"phase": phase})
            lengths, clock = np.empty((periods, seen.shape[1])), np.empty((periods, 2))
            for period in range(periods):
                answers = (seen[: 2 * period] - seen[-1]).T / errors[: 2 * period]
                responses.append(np.ascontiguousarray(answers))
                actions = envs.teacher_actions().astype(np.float32)
                lengths[period], clock[period] = seen[-1], actions[-1]
                for axis in range(2):
                    nudged, row = actions[2 * period + axis], 2 * period + axis
                    nudged[axis] -= np.float32(np.copysign(_NUDGE, nudged[axis]))
                    errors[row] = nudged[axis] - clock[period, axis]
                seen, _, terminated, _, _ = envs.step(actions)
                if terminated.any():
                    raise ValueError(f"an arm left its domain in period {period} of the clock")
            actual = {name: envs.get_attr(name)[0] for name in ("amplitude", "action_range")}
        return cls(EpisodeSettings(**arguments | actual), lengths, clock, tuple(responses))

    @property
    def steps(self) -> int:
        """Environment steps that were watched."""
        return len(self.lengths) * (2 * len(self.lengths) + 1)

    def policy(self, readout: Readout, training: Mapping[str, Any], seed: int) -> Policy:
        """Give a readout as an agent of this environment, with what is told of its making."""
        settings = {name: getattr(self.settings, name) for name in SETTINGS}
        network = readout_network(readout)
        training = {**training, "steps": self.steps}
        return Policy(network, "readout", self.settings.arm, settings, training, seed)

    @property
    def width(self) -> float:
        """w, the error at which the reward has fallen to 1/e [of the action range]."""
        settings = self.settings
        assert settings.amplitude is not None
        assert settings.action_range is not None
        return settings.reward_width * settings.amplitude / settings.action_range

    @np.errstate(over="ignore", invalid="ignore")  # of loops that explode
    def expected_share(self, weights: Float, noises: Sequence[float]) -> tuple[float, Float]:
        """Share of the possible return that a readout earns, to first order.

        The small cost of changing actions is left out.

        Args:
            weights: (springs + 1, 2), W and b as the last row [of the action range per metre].
            noises: ν, half widths of the uniform noise on the lengths [m]; the share is the mean
                over them.

        Returns:
            The share, and its gradient by the weights, (springs + 1, 2).
        """
        gains, periods = weights[:-1].T, len(self.lengths)
        size = 2 * periods
        loop = np.eye(size, order="F")
        for period, answers in enumerate(self.responses):
            loop[2 * period : 2 * period + 2, : 2 * period] = -gains @ answers
        # D: what errors come to.
        came = np.ascontiguousarray(lapack.dtrtri(loop, lower=1, unitdiag=1)[0])
        rows, parts = came.reshape(periods, 2, size), came.reshape(periods, 2, periods, 2)
        errors = (self.lengths @ weights[:-1] + weights[-1] - self.actions).ravel()
        mean = (came @ errors).reshape(periods, 2)
        spreading = (came.reshape(-1, 2) @ (gains @ gains.T)).reshape(periods, 2, size)
        covariance = spreading @ rows.transpose(0, 2, 1)
        if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
            return 0.0, np.zeros_like(weights)
        share, on_mean, on_covariance = 0.0, np.zeros_like(mean), np.zeros_like(covariance)
        for noise in noises:
            variance = noise**2 / 3
            bells, mean_slope, covariance_slope = _bells(mean, variance * covariance, self.width)
            share += float(bells.mean()) / len(noises)
            on_mean += mean_slope / periods / len(noises)
            on_covariance += variance * covariance_slope / periods / len(noises)
        # Backwards: D, then the loop, then the weights.
        carried = came.T @ on_mean.ravel()
        on_came = 2 * on_covariance @ spreading
        on_loop = came.T @ on_came.reshape(size, size) @ came.T + np.outer(carried, mean)
        weighted = (on_covariance @ rows).reshape(parts.shape)
        on_gains = 2 * np.einsum("taib,taid->bd", parts, weighted, optimize=True) @ gains
        for period, answers in enumerate(self.responses):
            on_gains += on_loop[2 * period : 2 * period + 2, : 2 * period] @ answers.T
        carried = carried.reshape(periods, 2)
        return share, np.vstack((self.lengths.T @ carried + on_gains.T, carried.sum(axis=0)))


def _bells(mean: Float, covariance: Float, width: float) -> tuple[Float, Float, Float]:
    """Expected rewards (T,) of Gaussian errors, and their slopes by mean and covariance."""
    sizes, axes = np.linalg.eigh(2 * covariance / width**2)
    shrunk = 1 / (1 + np.maximum(sizes, 0.0))
    along = (mean[:, np.newaxis] @ axes)[:, 0]
    pulled = (axes @ (shrunk * along)[:, :, np.newaxis])[..., 0]
    bells: Float = np.exp(-(shrunk * along**2).sum(axis=1) / width**2)
    bells *= np.sqrt(shrunk.prod(axis=1))
    inverse = (axes * shrunk[:, np.newaxis]) @ axes.transpose(0, 2, 1)
    outer = pulled[:, :, np.newaxis] * pulled[:, np.newaxis] / width**2
    on_mean = -2 / width**2 * bells[:, np.newaxis] * pulled
    on_covariance = 2 / width**2 * bells[:, np.newaxis, np.newaxis] * (outer - inverse / 2)
    return bells, on_mean, on_covariance


def design(model: LoopModel, noises: Sequence[float] = NOISES, *, iterations: int = 150) -> Readout:
    """Find the readout that earns most on average over levels of noise, to first order.

    Args:
        model: the arm in its loop.
        noises: ν, half widths of the uniform noise on the lengths [m].
        iterations: of L-BFGS-B, at most.

    Returns:
        A readout with a bias, fitted: from lengths [m] to the entries of an action.

    Raises:
        ValueError: no noises, or one that is not a number of metres.
    """
    if len(noises) == 0 or not all(0 <= noise < 1 for noise in noises):
        raise ValueError(f"noises = {tuple(noises)}: expected numbers of metres from 0 to 1")
    iterations = whole_number("iterations", iterations)
    # Sums split over threads are rounded otherwise.
    with threadpool_limits(1):
        ridges = [
            Readout("noise", noise=noise, bias=True).fit(model.lengths, model.actions)
            for noise in _RIDGES
        ]
        readout = max(ridges, key=lambda each: model.expected_share(each.weights_, noises)[0])
        first: Float = readout.weights_
        # Steps are as long in every direction as the change of the action that they make.
        centre = model.lengths.mean(axis=0)
        deviations = model.lengths - centre
        moments = deviations.T @ deviations / len(deviations)
        moments += readout.noise**2 / 3 * np.eye(len(centre))
        values, vectors = np.linalg.eigh(moments)
        small = 0.1 * model.width
        steps = small * vectors / np.sqrt(values)

        def weights(numbers: Float) -> Float:
            moved = numbers.reshape(-1, 2)
            changes = steps @ moved[:-1]
            moved_bias = small * moved[-1] - centre @ changes
            changed: Float = first + np.vstack((changes, moved_bias))
            return changed

        def loss(numbers: Float) -> tuple[float, Float]:
            share, gradient = model.expected_share(weights(numbers), noises)
            by_changes = gradient[:-1] - np.outer(centre, gradient[-1])
            return -share, -np.vstack((steps.T @ by_changes, small * gradient[-1])).ravel()

        options = {"maxiter": iterations, "maxcor": 30}
        found = minimize(loss, np.zeros(first.size), jac=True, method="L-BFGS-B", options=options)
        readout.weights_ = weights(found.x)
    return readout


def design_policy(
    env: Mapping[str, Any] | None = None,
    *,
    noises: Sequence[float] = NOISES,
    periods: int = 500,
    iterations: int = 150,
    seed: int = 0,
) -> Policy:
    """Design a readout that stands noise on the lengths, as an agent.

    Args:
        env: keyword arguments of ``gym.make("OctoArm-v0")``; None: its defaults.
        noises: ν, half widths of the uniform noise on the lengths [m].
        periods: T, control periods of the episodes that are watched.
        iterations: of L-BFGS-B, at most.
        seed: draws the phase at which the episodes begin.

    Returns:
        The policy. Its ``training`` tells the share of the possible return that is expected at each
        noise, to first order, and the environment steps that were watched.

    Raises:
        ValueError, TypeError: an argument that cannot be.
    """
    model = LoopModel.measure(EpisodeSettings(**(env or {})), periods, seed=seed)
    readout = design(model, noises, iterations=iterations)
    shares = [model.expected_share(readout.weights_, (noise,))[0] for noise in noises]
    training = {
        "noises": list(noises),
        "expected_shares": shares,
        "iterations": iterations,
    }
    return model.policy(readout, training, seed)


def weighted_policy(
    env: Mapping[str, Any] | None = None,
    *,
    noise: float = 1e-5,
    error: float = 1e-2,
    periods: int = 200,
    seed: int = 0,
) -> Policy:
    """Fit a ridge weighted by the body's own deviations, as an agent.

    Beside white noise on the lengths the fit allows for what the lengths are off by when the
    command is, every period by a random error of its own.

    Args:
        env: keyword arguments of ``gym.make("OctoArm-v0")``; None: its defaults.
        noise: ν, half width of the noise on the lengths [m].
        error: κ, root mean square of the errors of the command [of the action range].
        periods: T, control periods of the episodes that are watched; the answers to errors are
            taken from the second half.
        seed: draws the phase at which the episodes begin.

    Raises:
        ValueError, TypeError: an argument that cannot be.
    """
    if not 0 <= error < 1:
        raise ValueError(f"error = {error}: expected a part of the action range, from 0 to 1")
    model = LoopModel.measure(EpisodeSettings(**(env or {})), periods, seed=seed)
    answers = np.concatenate([each.T for each in model.responses[periods // 2 :]])
    # As many in effect as the rows of the orbit.
    answers *= error * np.sqrt(periods / (periods - periods // 2))
    with threadpool_limits(1):
        readout = Readout("noise", noise=noise, bias=True)
        readout.fit(model.lengths, model.actions, penalty=np.linalg.qr(answers, mode="r"))
    return model.policy(readout, {"noise": noise, "error": error}, seed)
