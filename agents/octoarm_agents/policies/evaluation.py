"""One agent, so many episodes: what it earns and how well it keeps to the orbit."""

from __future__ import annotations

from typing import Any, Literal, Protocol, get_args

import gymnasium as gym

from octoarm_agents.common.environment import make_vector_env
from octoarm_agents.common.whole import whole_number
from octoarm_agents.policies.measures import TargetOrbit, orbit_measures, tracking_measures
from octoarm_agents.policies.rollout import (
    HoldPolicy,
    Noise,
    PolicyPredictor,
    Push,
    RandomPolicy,
    roll_out,
)
from octoarm_env import ArmParameters, OctoArmVectorEnv, TeacherPolicy

JUDGING_SEED = 20_000
"""First seed of the episodes that choose the best policy of a training; neither trained nor
compared on."""

JUDGED_EPISODES = 16
"""Episodes of each such evaluation."""

Trivial = Literal["hold", "clock", "random"]
"""Agents by name: the base held still, the clock that knows the target, and random actions."""

NAMED: tuple[Trivial, ...] = get_args(Trivial)
"""All of these."""

TRIVIAL: tuple[Trivial, ...] = ("hold", "clock")
"""Those that stand beside every other agent."""


class Home(Protocol):
    """Where an agent belongs; `octoarm_agents.policies.Policy` has its own."""

    @property
    def parameters(self) -> ArmParameters:
        """The body."""

    @property
    def settings(self) -> dict[str, Any]:
        """The environment's, `octoarm_agents.common.environment.SETTINGS`."""


def acting(
    policy: PolicyPredictor | Trivial,
    envs: OctoArmVectorEnv | gym.Env[Any, Any],
    seed: int = 0,
) -> PolicyPredictor:
    """Give the agent itself, or one of the trivial ones by name.

    Args:
        policy: the agent, or its name.
        envs: where it is to act.
        seed: of the random actions.

    Raises:
        ValueError: an unknown name.
    """
    if not isinstance(policy, str):
        return policy
    if policy == "hold":
        return HoldPolicy()
    if policy == "clock":
        return TeacherPolicy(envs)
    if policy == "random":
        return RandomPolicy(seed)
    names = ", ".join(map(repr, NAMED))
    raise ValueError(f"policy = {policy!r}: expected {names} or an agent")


def evaluate_policy(
    policy: PolicyPredictor | Trivial,
    home: Home,
    *,
    episodes: int = 32,
    steps: int = 500,
    seed: int = 10_000,
    push: Push | None = None,
    noise: Noise | None = None,
    window: int | None = None,
    threads: int | None = None,
) -> dict[str, Any]:
    """Let an agent act.

    Args:
        policy: the agent, or ``"hold"``, ``"clock"`` or ``"random"``.
        home: whose body and environment are used; mostly `policy` itself.
        episodes: side by side.
        steps: of each.
        seed: of the first; episode i has seed + i.
        push: disturbs the base.
        noise: disturbs what the agent sees.
        window: last steps by which the orbit is measured; None: the second half.
        threads: that step the arms; the figures do not depend on it.

    Returns:
        `tracking_measures` of the whole, `orbit_measures` of the window, and ``returns``.

    Raises:
        ValueError: numbers out of range, or a body with another number of springs.
    """
    episodes, steps = whole_number("episodes", episodes, 1), whole_number("steps", steps, 1)
    envs = make_vector_env(episodes, home.parameters, home.settings, steps=steps, threads=threads)
    try:
        rollout = roll_out(
            acting(policy, envs, seed), envs, seed=seed, steps=steps, push=push, noise=noise
        )
        orbit = orbit_measures(
            rollout, TargetOrbit.of(envs), steps // 2 if window is None else window
        )
    finally:
        envs.close()
    return {**orbit, **tracking_measures(rollout), "returns": rollout.returns.tolist()}
