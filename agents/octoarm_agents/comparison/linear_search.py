"""A linear policy found without a teacher and without gradients: CMA-ES over its weights.

The same 2 · (80 + 1) weights as a readout with bias, but all that guides them is the return
(Hansen 2016, arXiv:1604.00772).
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import cma
import numpy as np
from gymnasium.vector import AutoresetMode

from octoarm_agents.common.environment import inspect_env, make_vector_env
from octoarm_agents.common.whole import whole_fields
from octoarm_agents.policies import Network, Policy
from octoarm_agents.policies.evaluation import JUDGED_EPISODES, JUDGING_SEED
from octoarm_agents.policies.rollout import roll_out
from octoarm_env import OctoArmEnv, OctoArmVectorEnv
from octoarm_env.arrays import Float


@dataclass(frozen=True)
class LinearSearch:
    """What is searched and how.

    Attributes:
        target: of the environment.
        steps: environment steps, all candidates and the recording of the scales together.
        seed: of the search and of the episodes.
        env: further arguments of the environment.
        population: candidates of a generation.
        episodes: of each candidate, the same phases for all candidates of a generation.
        episode_steps: of each of these episodes; like the networks' trainings shorter than the
            standard episode, so that more of them begin on the orbit.
        sigma: first step size, in units of an action over a spring's standard deviation.
        evaluations: of the mean candidate, on the seeds on which networks are judged too.
    """

    target: str
    steps: int = 2_000_000
    seed: int = 0
    env: dict[str, Any] = field(default_factory=dict)
    population: int = 24
    episodes: int = 8
    episode_steps: int = 100
    sigma: float = 0.02
    evaluations: int = 20

    def __post_init__(self) -> None:
        whole_fields(
            self, population=4, episodes=1, episode_steps=1, evaluations=1, steps=1, seed=0
        )
        if not self.sigma > 0:
            raise ValueError(f"sigma = {self.sigma}: expected a positive number")


def search_linear(search: LinearSearch, out: Path) -> dict[str, Any]:
    """Search, and write ``best.npz`` into a folder, made if need be.

    Returns:
        ``curve`` and ``best`` of it, ``seconds``, ``parameters``.
    """
    out.mkdir(parents=True, exist_ok=True)
    parameters, settings = inspect_env(OctoArmEnv(search.target, **search.env))
    judges = make_vector_env(JUDGED_EPISODES, parameters, settings, steps=500, threads=1)
    arms = OctoArmVectorEnv(
        search.population * search.episodes,
        search.target,
        **search.env,
        max_episode_steps=None,
        autoreset_mode=AutoresetMode.DISABLED,
        threads=1,
    )
    begun = time.perf_counter()
    mean, scale, done = _scales(search, arms)
    springs = mean.size
    strategy = cma.CMAEvolutionStrategy(
        np.zeros(2 * (springs + 1)),
        search.sigma,
        {"seed": search.seed + 1, "popsize": search.population, "verbose": -9},
    )
    curve: list[dict[str, Any]] = []
    best: dict[str, Any] | None = None
    seconds, generation = 0.0, 0
    cost = search.population * search.episodes * search.episode_steps
    while True:
        last = done + cost > search.steps
        interval = search.steps / search.evaluations
        due = (done // interval) > (curve[-1]["steps"] // interval if curve else 0)
        if due or last:
            seconds += time.perf_counter() - begun
            network = _network(strategy.mean, mean, scale)
            training = asdict(search) | {"trained_steps": done}
            policy = Policy(network, "linear_search", parameters, settings, training, search.seed)
            returns = roll_out(policy, judges, seed=JUDGING_SEED).returns
            curve.append({"steps": done, "seconds": seconds, "return": float(returns.mean())})
            if best is None or curve[-1]["return"] > best["return"]:
                best = curve[-1]
                policy.training["return"] = best["return"]
                policy.save(out / "best.npz")
            begun = time.perf_counter()
        if last:
            break
        candidates = strategy.ask()
        losses = -_returns(search, arms, np.array(candidates), mean, scale, generation)
        strategy.tell(candidates, losses.tolist())
        done += cost
        generation += 1
    return {
        "curve": curve,
        "best": best,
        "seconds": seconds,
        "parameters": 2 * (springs + 1),
    }


def _scales(search: LinearSearch, arms: OctoArmVectorEnv) -> tuple[Float, Float, int]:
    """Mean [m] and inverse spread [1/m] of the springs while the base does anything at random."""
    random = np.random.default_rng(search.seed)
    lengths, _ = arms.reset(seed=_episode_seeds(search, 0))
    rows = [lengths]
    for _ in range(search.episode_steps):
        actions = random.uniform(-1, 1, (arms.num_envs, 2)).astype(np.float32)
        lengths, *_ = arms.step(actions)
        rows.append(lengths)
    recorded = np.concatenate(rows)
    steps = arms.num_envs * search.episode_steps
    return recorded.mean(axis=0), 1 / recorded.std(axis=0), steps


def _episode_seeds(search: LinearSearch, generation: int) -> list[int]:
    """The same episodes for every candidate, other ones in every generation."""
    first = (search.seed * 1_000_003 + generation * search.episodes) % 2**31
    return [first + episode for episode in range(search.episodes)] * search.population


def _returns(
    search: LinearSearch,
    arms: OctoArmVectorEnv,
    candidates: Float,
    mean: Float,
    scale: Float,
    generation: int,
) -> Float:
    """Mean return of each candidate."""
    weights = candidates.reshape(len(candidates), -1, 2)
    springs, bias = weights[:, :-1], weights[:, np.newaxis, -1]
    running = np.ones(arms.num_envs, dtype=bool)
    total = np.zeros(arms.num_envs)
    lengths, _ = arms.reset(seed=_episode_seeds(search, generation))
    for _ in range(search.episode_steps):
        inputs = ((lengths - mean) * scale).reshape(len(candidates), search.episodes, -1)
        actions = np.clip(inputs @ springs + bias, -1, 1).astype(np.float32)
        lengths, rewards, terminated, _, _ = arms.step(actions.reshape(-1, 2))
        total += np.where(running, rewards, 0.0)
        running &= ~terminated
        if terminated.any():
            # An arm that has failed earns nothing more; it only must be able to go on.
            arms.reset(options={"reset_mask": terminated})
    means: Float = total.reshape(len(candidates), -1).mean(axis=1)
    return means


def _network(solution: Float, mean: Float, scale: Float) -> Network:
    weights = solution.reshape(-1, 2)
    springs = np.ascontiguousarray(weights[:-1].T, dtype=np.float32)
    layer = (springs, weights[-1].astype(np.float32))
    return Network(mean, scale, 1e6, (layer,), "tanh", "clip")
