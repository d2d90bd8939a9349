"""What a readout trades when it is taught otherwise: return for calm in noise and after pushes."""

from __future__ import annotations

from typing import Any

from octoarm_agents.policies.evaluation import evaluate_policy
from octoarm_agents.policies.measures import recovery
from octoarm_agents.policies.rollout import Noise, Push, roll_out
from octoarm_env import ArmParameters

__all__ = ["ACTION_NOISES", "RIDGE_NOISES", "map_readout"]

ACTION_NOISES = (0.01, 0.05, 0.1)
"""κ, half widths of the noise on the teacher's actions."""

RIDGE_NOISES = (0.0, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4)
"""ν, half widths of the noise on the lengths that the fit allows for [m]; 0: pseudo-inverse."""


def map_readout(
    parameters: ArmParameters,
    *,
    target: str,
    action_noise: float,
    noise: float,
    steps: int,
    seed: int,
    episodes: int,
    noises: list[float],
    push: float,
) -> dict[str, Any]:
    """Teach a readout and measure it; a trial for `run_trials`.

    Args:
        parameters: the body.
        target: of the environment.
        action_noise: κ.
        noise: ν [m].
        steps: control periods of teaching.
        seed: of the teaching.
        episodes: of each test, on the comparison's seeds.
        noises: half widths of the noise on what the readout sees [m].
        push: size of the push [degrees].

    Returns:
        ``return``, ``held`` (over 30 s), ``noises``: a return for each, ``recovered`` after the
        push.
    """
    import numpy as np

    from octoarm_agents.common.environment import make_vector_env
    from octoarm_agents.reservoir import Readout, train_policy

    readout = Readout("noise", noise=noise, bias=True) if noise else Readout("pinv", bias=True)
    policy = train_policy(
        {"target": target, "max_episode_steps": steps, "arm": parameters},
        steps=steps,
        action_noise=action_noise,
        seed=seed,
        readout=readout,
    )
    common: dict[str, Any] = {"episodes": episodes, "threads": 1}
    plain = evaluate_policy(policy, policy, **common)
    long = evaluate_policy(policy, policy, steps=3000, **common)
    envs = make_vector_env(episodes, parameters, policy.settings, steps=920, threads=1)
    pushed = recovery(
        roll_out(policy, envs, seed=10_000, steps=920, push=Push(push)),
        np.array(envs.get_attr("orbit")[0]),
        amplitude=envs.get_attr("amplitude")[0],
        control_period=policy.settings["control_period"],
        end=120,
    )
    return {
        "return": plain["return"],
        "held": long["held"],
        "noises": [
            evaluate_policy(policy, policy, noise=Noise(size), **common)["return"]
            for size in noises
        ],
        "recovered": pushed["recovered"],
    }
