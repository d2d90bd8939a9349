"""Teaching in the loop: a readout learns from where it goes itself when it is disturbed.

Dataset aggregation (Ross, Gordon and Bagnell 2011, arXiv:1011.0686): the readout acts, the arm is
disturbed, what was seen is labelled with what a teacher would have done there, and the readout is
fitted again to all rows so far. The teacher knows the orbit and not the time: it finds the two
commands of the clock that are nearest to the last two and gives the one that followed them, so that
the target goes on at the nearest phase.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from typing import Any

import numpy as np
from scipy.spatial import KDTree
from threadpoolctl import threadpool_limits

from octoarm_agents.common.environment import SETTINGS
from octoarm_agents.common.whole import whole_number
from octoarm_agents.policies.policy import Policy
from octoarm_agents.policies.rollout import Episodes, Noise, Push, roll_out
from octoarm_agents.reservoir.policy import readout_network
from octoarm_agents.reservoir.readout import Readout
from octoarm_env import EpisodeSettings, OctoArmVectorEnv, TeacherPolicy
from octoarm_env.arrays import Float


def aggregated_policy(
    env: Mapping[str, Any] | None = None,
    *,
    rounds: int = 5,
    episodes: int = 16,
    periods: int = 500,
    noise: float = 1e-5,
    shake: float = 1.0,
    seed: int = 0,
) -> Policy:
    """Teach a readout in the loop, as an agent.

    In the first round the lead-compensated clock acts, in every further one the readout, which sees
    the lengths through noise. In all of them the base is shaken.

    Args:
        env: keyword arguments of ``gym.make("OctoArm-v0")``; None: its defaults.
        rounds: how often the readout is fitted.
        episodes: of each round, side by side.
        periods: control periods of each.
        noise: ν, half width of the uniform noise on the lengths that the readout sees, and that its
            fit allows for [m].
        shake: half width of the white noise on the commands [degrees].
        seed: of the episodes and of all noise.

    Returns:
        The policy of the last round. Its ``training`` tells the mean reward of a control period in
        each round, that of the clock first, and the environment steps.

    Raises:
        ValueError, TypeError: an argument that cannot be.
    """
    rounds, episodes = whole_number("rounds", rounds, 1), whole_number("episodes", episodes, 1)
    periods, seed = whole_number("periods", periods, 3), whole_number("seed", seed)
    for name, value in {"noise": noise, "shake": shake}.items():
        if not 0 <= value < float("inf"):
            raise ValueError(f"{name} = {value}: expected a number, not negative")
    settings = EpisodeSettings(**(env or {}))
    arguments = {name: getattr(settings, name) for name in settings.to_dict()}
    shaken = Push(shake, 0, periods, white=True)
    readout = Readout("noise", noise=noise, bias=True)
    rows: list[Float] = []
    labels: list[Float] = []
    rewards: list[float] = []
    with (
        closing(OctoArmVectorEnv(episodes, **arguments, max_episode_steps=None)) as envs,
        threadpool_limits(1),  # sums split over threads are rounded otherwise
    ):
        names = ("amplitude", "action_range")
        settings = EpisodeSettings(**arguments | {name: envs.get_attr(name)[0] for name in names})
        kept = {name: getattr(settings, name) for name in SETTINGS}
        clock = roll_out(TeacherPolicy(envs), envs, seed=seed, steps=periods).actions
        phases = KDTree(_pairs(clock).reshape(-1, 4))
        following = clock[2:].reshape(-1, 2)
        policy: TeacherPolicy | Policy = TeacherPolicy(envs)
        for turn in range(1, rounds + 1):
            seen = Noise(noise) if rows else None
            acting = Episodes(
                policy, envs, seed=seed + turn, steps=periods, push=shaken, noise=seen
            )
            lengths = []
            for _ in range(periods):
                lengths.append(acting.lengths)
                acting.step()
            done = acting.rollout
            alive = done.alive[2:]
            rewards.append(float(done.rewards.mean()))
            rows.append(np.stack(lengths)[2:][alive])
            labels.append(following[phases.query(_pairs(done.actions)[alive])[1]])
            readout.fit(np.concatenate(rows), np.concatenate(labels))
            training = {
                "rounds": turn,
                "noise": noise,
                "shake": shake,
                "rewards": list(rewards),
                "training_error": readout.training_error_,
                "steps": (turn + 1) * episodes * periods,
            }
            network = readout_network(readout)
            policy = Policy(network, "readout", settings.arm, kept, training, seed)
    assert isinstance(policy, Policy)
    return policy


def _pairs(commands: Float) -> Float:
    """The two commands before each but the first two, (T - 2, n, 4)."""
    return np.concatenate((commands[:-2], commands[1:-1]), axis=2)
