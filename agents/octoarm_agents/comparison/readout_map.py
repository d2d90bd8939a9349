"""What a readout trades when it is taught otherwise: return for calm in noise and after pushes."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

from octoarm_agents.comparison.agents import teach_readout
from octoarm_agents.comparison.measuring import NOISES, PUSHES, AgentTest, TestPlan
from octoarm_agents.policies.rollout import Noise, Push
from octoarm_env import ArmParameters

_ACTION_NOISES = (0.01, 0.05, 0.1)
"""κ, half widths of the noise on the teacher's actions."""

_RIDGE_NOISES = (0.0, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4)
"""ν, half widths of the noise on the lengths that the fit allows for [m]; 0: pseudo-inverse."""


def map_settings(targets: Sequence[str]) -> list[dict[str, Any]]:
    """Give all points of the map: ``target``, ``action_noise``, ``noise``."""
    points = itertools.product(targets, _ACTION_NOISES, _RIDGE_NOISES)
    return [dict(zip(("target", "action_noise", "noise"), point, strict=True)) for point in points]


def map_readout(
    parameters: ArmParameters,
    *,
    target: str,
    action_noise: float,
    noise: float,
    seed: int,
    plan: dict[str, Any],
) -> dict[str, Any]:
    """Teach a readout and measure it; a trial for `run_trials`.

    Args:
        parameters: the body.
        target: of the environment.
        action_noise: κ.
        noise: ν [m].
        seed: of the teaching.
        plan: arguments of `TestPlan`.

    Returns:
        ``return``, ``held`` (over 30 s), ``recovered`` after a push of half the amplitude, and
        ``noises``: for every size the ``return``.
    """
    policy = teach_readout(target, action_noise, noise, seed, parameters)
    test = AgentTest(policy, parameters, policy.settings, TestPlan(**plan))
    return {
        "return": test.measures()["return"],
        "held": test.measures(test.plan.long_steps)["held"],
        "recovered": test.recovery(push=Push(PUSHES[1]))["recovered"],
        "noises": [
            {"size": size, "return": test.measures(noise=Noise(size))["return"]} for size in NOISES
        ],
    }
