"""A linear readout as an agent of the environment ``OctoArm-v0``, and how a teacher makes one."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager, closing, nullcontext
from typing import Any

import gymnasium as gym
import numpy as np

from octoarm_agents.common.environment import ENV_ID, Env, check_spaces, inspect_env
from octoarm_agents.common.whole import whole_number
from octoarm_agents.policies.network import Network, Past
from octoarm_agents.policies.policy import Policy
from octoarm_agents.reservoir.readout import Readout
from octoarm_env import TeacherPolicy
from octoarm_env.arrays import Float

ReadoutPolicy = Policy
"""Its name before networks were the same."""


def readout_network(readout: Readout, past: int = 0) -> Network:
    """Give a fitted readout, from the spring lengths [m] to the two entries of an action, as layer.

    It has no clock and no memory: the body alone tells it the phase of the motion.

    Args:
        readout: fitted.
        past: k, if it reads the last k lengths of each spring too, the latest first. That is a
            memory outside the body.

    Raises:
        ValueError: a readout that is not fitted, or has other than two outputs.
    """
    if not hasattr(readout, "weights_"):
        raise ValueError("readout is not fitted: expected one after fit")
    inputs = readout.n_features_in_
    springs = inputs // (past + 1)
    # A view, so that its numbers keep their places: in another order they are summed otherwise.
    layer = readout.weights_[:inputs].T, readout.weights_[inputs:].sum(axis=0)
    limit = float(np.finfo(np.float64).max)
    memory = Past(past) if past else None
    return Network(np.zeros(springs), np.ones(springs), limit, (layer,), memory=memory)


def train_policy(
    env: Env | Mapping[str, Any] | None = None,
    *,
    steps: int = 3500,
    action_noise: float = 0.01,
    noise: float = 1e-8,
    seed: int = 0,
    readout: Readout | None = None,
    past: int = 0,
) -> Policy:
    """Teach a readout to do what the lead-compensated clock does, from the lengths alone.

    The clock's actions are followed with noise, so that the readout sees the body beside its orbit
    too: taught on the orbit alone it fits perfectly and may still be unstable in the loop. Its
    labels are the clock's actions without the noise.

    Args:
        env: an ``OctoArm-v0`` environment, however wrapped, as long as its observations are the
            lengths and its actions the fractions of `action_range`; it is reset with `seed` and
            whenever an episode ends, and left in the middle of one. Or the keyword arguments of
            ``gym.make("OctoArm-v0")``; None: its defaults.
        steps: control periods to learn from, at least one for each spring.
        action_noise: half width of the uniform noise on the actions, 0 to 1.
        noise: ν, half width of the noise on the lengths that the fit allows for [m], see `Readout`.
        seed: of the environment and of the noise on the actions.
        readout: fit this one instead of ``Readout("noise", noise=noise)``; it is fitted in place.
        past: k, past lengths of each spring that it reads too, a memory outside the body; the last
            k control periods.

    Returns:
        The policy, with the environment's settings.

    Raises:
        ValueError: an argument outside its range, or an environment wrapped otherwise.
        TypeError: not an ``OctoArm-v0`` environment.
    """
    opened: AbstractContextManager[Env]
    if isinstance(env, gym.Env):
        opened = nullcontext(env)
    elif env is None or isinstance(env, Mapping):
        opened = closing(gym.make(ENV_ID, **(env or {})))
    else:
        raise TypeError(
            "env must be an OctoArm-v0 environment or the arguments to make one, "
            f"not {type(env).__name__}"
        )
    readout = Readout("noise", noise=noise) if readout is None else readout
    readout.check_parameters()
    if not 0 <= action_noise <= 1:
        raise ValueError(f"action_noise = {action_noise}: expected a number from 0 to 1")
    seed = whole_number("seed", seed)
    with opened as used:
        parameters, settings = inspect_env(used)
        check_spaces(used)
        # At least one for each number that is read.
        past = whole_number("past", past)
        steps = whole_number("steps", steps, 4 * parameters.compartments * (past + 1))
        lengths, actions = _follow_teacher(used, steps, action_noise, seed)
    # The latest first; a row that reaches back beyond an episode's begin is one of many.
    read = [lengths[past - back : steps - back] for back in range(past + 1)]
    readout.fit(np.hstack(read), actions[past:])
    training = {
        "steps": steps,
        "action_noise": action_noise,
        "readout": readout.get_params(),
        "rank": readout.rank_,
        "training_error": readout.training_error_,
        "past": past,
    }
    return Policy(readout_network(readout, past), "readout", parameters, settings, training, seed)


def _follow_teacher(env: Env, steps: int, action_noise: float, seed: int) -> tuple[Float, Float]:
    """Lengths (steps, springs) [m] before each of the teacher's actions (steps, 2)."""
    teacher, random = TeacherPolicy(env), np.random.default_rng(seed)
    observation, _ = env.reset(seed=seed)
    lengths, actions = np.empty((steps, len(observation))), np.empty((steps, 2))
    for step in range(steps):
        lengths[step] = observation
        actions[step], _ = teacher.predict()
        noisy = actions[step] + action_noise * random.uniform(-1, 1, 2)
        observation, _, terminated, truncated, _ = env.step(
            np.clip(noisy, -1.0, 1.0).astype(np.float32)
        )
        if terminated or truncated:
            observation, _ = env.reset()
    return lengths, actions
