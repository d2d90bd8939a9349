"""The agents that are compared, and how each comes about."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from octoarm_agents.common.environment import TARGETS
from octoarm_agents.common.whole import whole_fields
from octoarm_agents.comparison.linear_search import LinearSearch, search_linear
from octoarm_agents.policies import Policy
from octoarm_agents.policies.evaluation import (
    JUDGED_EPISODES,
    JUDGING_SEED,
    TRIVIAL,
    evaluate_policy,
)
from octoarm_agents.reservoir import (
    Readout,
    aggregated_policy,
    design_policy,
    train_policy,
    weighted_policy,
)

READOUTS = (
    "readout_pinv",
    "readout_ridge",
    "readout_noise",
    "readout_weighted",
    "readout_aggregated",
    "readout_designed",
    "readout_past",
)
NETWORKS = {
    "ppo": ("ppo", 0.0),
    "ppo_noise": ("ppo", 3e-5),
    "sac": ("sac", 0.0),
    "tqc": ("tqc", 0.0),
    "recurrent_ppo": ("recurrent_ppo", 0.0),
}
"""Algorithm of each, and half width of the white noise on the lengths in its training [m]."""

TRAINED = (*READOUTS, "linear_search", *NETWORKS)
AGENTS = (*TRAINED, *TRIVIAL)
"""In the order of the tables."""

TEACHING_STEPS = 3500
"""Control periods that a fitted readout learns from: 35 s of the teacher."""

ACTION_NOISE = 0.01
"""Half width of the noise on the teacher's actions, so that the body is seen beside its orbit."""

RIDGE_NOISES = {
    "readout_pinv": 0.0,
    "readout_ridge": 1e-8,
    "readout_noise": 1e-5,
    "readout_past": 1e-5,
}
"""ν of the fitted readouts [m]: the fit allows for white noise in [-ν, ν] on the lengths."""

PAST = 4
"""Past lengths of each spring that `readout_past` reads."""

SLOW_FIRST = (
    *("recurrent_ppo", "tqc", "sac", "ppo_noise", "ppo", "linear_search"),
    *(*READOUTS[::-1], *TRIVIAL),
)
"""In the order of their trainings, so that no process idles at the end."""


@dataclass(frozen=True)
class TrainingRun:
    """One training, or none of an agent that is not trained.

    Attributes:
        agent: one of `AGENTS`.
        target: one of `TARGETS`.
        seed: of the training.
        budget: factor of the environment steps; 1 is the comparison's own. Readouts take what they
            need.
        folder: in which all trainings are.
        env: further arguments of the environment, as they read in JSON.
    """

    agent: str
    target: str
    seed: int
    budget: float
    folder: Path
    env: dict[str, Any] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        if self.agent not in AGENTS:
            raise ValueError(f"agent = {self.agent!r}: expected one of {AGENTS}")
        if self.target not in TARGETS:
            raise ValueError(f"target = {self.target!r}: expected one of {TARGETS}")
        whole_fields(self, seed=0)
        if not 0 < self.budget < float("inf"):
            raise ValueError(f"budget = {self.budget}: expected a positive number")

    @property
    def name(self) -> str:
        """Of the folder of this training."""
        return f"{self.agent}-{self.target}-{self.seed}"

    @property
    def policy(self) -> Path:
        """File of the agent."""
        return self.folder / self.name / "best.npz"

    @property
    def arguments(self) -> dict[str, Any]:
        """Of the environment."""
        return {"target": self.target, **self.env}

    @property
    def command(self) -> str:
        """What makes this very agent on the default body."""
        if self.agent in NETWORKS:
            algorithm, noise = NETWORKS[self.agent]
            noisy = f" --noise {noise:g}" if noise else ""
            return f"octoarm train {algorithm} --target {self.target} --seed {self.seed}{noisy}"
        return (
            f"octoarm compare --agents {self.agent} --targets {self.target} --seeds {self.seed + 1}"
        )


def make_agent(run: TrainingRun) -> dict[str, Any] | None:
    """Train an agent, or go on with what an earlier call has begun; in one thread.

    Returns:
        Of the training: ``curve``, ``best``, ``final``, ``seconds``, ``parameters``; None of an
        agent that is not trained.

    Raises:
        ValueError: the folder holds another training of this name.
    """
    if run.agent in TRIVIAL:
        return None
    if run.agent in NETWORKS:
        made = _train_network(run)
    elif run.agent == "linear_search":
        steps = max(round(run.budget * LinearSearch.steps), 1)
        made = search_linear(LinearSearch(run.target, steps, run.seed, run.env), run.policy.parent)
    else:
        made = _make_readout(run)
    kept = {name: made[name] for name in ("curve", "best", "seconds", "parameters")}
    return {**kept, "final": made["curve"][-1]}


def _train_network(run: TrainingRun) -> dict[str, Any]:
    from octoarm_agents.rl import Hyperparameters, Training, train

    algorithm, noise = NETWORKS[run.agent]
    steps = max(round(run.budget * Hyperparameters.load(algorithm).steps), 1)
    training = Training.make(
        algorithm, run.target, steps=steps, seed=run.seed, noise=noise, env=run.env
    )
    return train(training, run.policy.parent, resume=True, command=run.command)


def _make_readout(run: TrainingRun) -> dict[str, Any]:
    begun = time.perf_counter()
    policy = _fit_readout(run)
    seconds = time.perf_counter() - begun
    judged = evaluate_policy(policy, policy, episodes=JUDGED_EPISODES, seed=JUDGING_SEED, threads=1)
    run.policy.parent.mkdir(parents=True, exist_ok=True)
    policy.save(run.policy)
    point = {"steps": policy.training["steps"], "seconds": seconds, "return": judged["return"]}
    parameters = policy.parameter_count
    return {"curve": [point], "best": point, "seconds": seconds, "parameters": parameters}


def _fit_readout(run: TrainingRun) -> Policy:
    if run.agent == "readout_weighted":
        return weighted_policy(run.arguments, seed=run.seed)
    if run.agent == "readout_aggregated":
        return aggregated_policy(run.arguments, seed=run.seed)
    if run.agent == "readout_designed":
        return design_policy(run.arguments, seed=run.seed)
    noise = RIDGE_NOISES[run.agent]
    return train_policy(
        {**run.arguments, "max_episode_steps": TEACHING_STEPS},
        steps=TEACHING_STEPS,
        action_noise=ACTION_NOISE,
        seed=run.seed,
        readout=Readout("noise", noise=noise, bias=True) if noise else Readout("pinv", bias=True),
        past=PAST if run.agent == "readout_past" else 0,
    )
