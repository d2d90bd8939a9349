"""The agents that are compared, and how each comes about."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from octoarm_agents.common.environment import TARGETS
from octoarm_agents.common.files import write_json
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.whole import whole_fields
from octoarm_agents.comparison.linear_search import LinearSearch, search_linear
from octoarm_agents.policies.evaluation import TRIVIAL

__all__ = ["AGENTS", "NETWORKS", "TRAINED", "TRIVIAL", "Cell", "make_agent"]

READOUTS = ("readout_pinv", "readout_ridge")
NETWORKS = ("ppo", "sac", "tqc", "recurrent_ppo")
TRAINED = (*READOUTS, "linear_search", *NETWORKS)
AGENTS = (*TRAINED, *TRIVIAL)
"""In the order of the tables."""

TEACHING_STEPS = 3500
"""Control periods that a readout learns from: 35 s of the teacher."""

ACTION_NOISE = 0.01
"""Half width of the noise on the teacher's actions, so that the body is seen beside its orbit."""

RIDGE_NOISE = 1e-8
"""ν of the ridge [m]: the fit allows for white noise in [-ν, ν] on the lengths."""


@dataclass(frozen=True)
class Cell:
    """One training.

    Attributes:
        agent: one of `TRAINED`.
        target: one of `TARGETS`.
        seed: of the training.
        budget: factor of the environment steps; 1 is the comparison's own. Readouts take what they
            need.
        folder: in which all trainings are.
    """

    agent: str
    target: str
    seed: int
    budget: float
    folder: Path

    def __post_init__(self) -> None:
        if self.agent not in TRAINED:
            raise ValueError(f"agent = {self.agent!r}: expected one of {TRAINED}")
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
    def digest(self) -> str:
        """Of that file."""
        return hashlib.sha256(self.policy.read_bytes()).hexdigest()

    @property
    def command(self) -> str:
        """What makes this very agent."""
        if self.agent in NETWORKS:
            return f"octoarm train {self.agent} --target {self.target} --seed {self.seed}"
        return (
            f"octoarm compare --agents {self.agent} --targets {self.target} --seeds {self.seed + 1}"
        )


def make_agent(cell: Cell, progress: Callable[[int, float], None] | None = None) -> dict[str, Any]:
    """Train an agent, or take what an earlier call has trained; in one thread.

    Returns:
        The summary of the training: ``curve``, ``best``, ``seconds``, ``parameters``, …

    Raises:
        ValueError: the folder holds another training of this name.
    """
    from threadpoolctl import threadpool_limits

    # Sums split over threads are rounded otherwise.
    with threadpool_limits(1):
        if cell.agent in NETWORKS:
            return _train_network(cell, progress)
        out = cell.folder / cell.name
        wanted = _wanted(cell)
        found = _finished(out / "training.json", wanted)
        if found is not None:
            return found
        if cell.agent == "linear_search":
            return search_linear(LinearSearch(**wanted), out, progress=progress)
        return _teach_readout(cell, wanted)


def _train_network(cell: Cell, progress: Callable[[int, float], None] | None) -> dict[str, Any]:
    from octoarm_agents.rl import Hyperparameters, Training, train

    steps = max(round(cell.budget * Hyperparameters.load(cell.agent).steps), 1)
    training = Training.make(cell.agent, cell.target, steps=steps, seed=cell.seed)
    return train(
        training,
        cell.folder / cell.name,
        resume=True,
        progress=progress,
        command=cell.command,
    )


def _wanted(cell: Cell) -> dict[str, Any]:
    """The training of a cell as its ``training.json`` describes it."""
    if cell.agent == "linear_search":
        steps = max(round(cell.budget * LinearSearch(cell.target).steps), 1)
        return vars(LinearSearch(cell.target, steps, cell.seed)).copy()
    fit = {"method": "pinv"} if cell.agent == "readout_pinv" else {"noise": RIDGE_NOISE}
    return {
        "target": cell.target,
        "steps": TEACHING_STEPS,
        "seed": cell.seed,
        "action_noise": ACTION_NOISE,
        **fit,
    }


def _finished(file: Path, wanted: dict[str, Any]) -> dict[str, Any] | None:
    try:
        summary: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except ValueError as error:
        raise ValueError(f"{file} is damaged: {error}") from None
    if summary.get("training") != wanted:
        raise ValueError(f"{file} is of another training: choose another folder")
    return summary


def _teach_readout(cell: Cell, wanted: dict[str, Any]) -> dict[str, Any]:
    from octoarm_agents.policies.evaluation import JUDGED_EPISODES, JUDGING_SEED, evaluate_policy
    from octoarm_agents.reservoir import Readout, train_policy

    readout = (
        Readout("pinv", bias=True)
        if cell.agent == "readout_pinv"
        else Readout("noise", noise=RIDGE_NOISE, bias=True)
    )
    begun = time.perf_counter()
    policy = train_policy(
        {"target": cell.target, "max_episode_steps": TEACHING_STEPS},
        steps=TEACHING_STEPS,
        action_noise=ACTION_NOISE,
        seed=cell.seed,
        readout=readout,
    )
    seconds = time.perf_counter() - begun
    judged = evaluate_policy(policy, policy, episodes=JUDGED_EPISODES, seed=JUDGING_SEED, threads=1)
    point = {"steps": TEACHING_STEPS, "seconds": seconds, "return": judged["return"]}
    cell.policy.parent.mkdir(parents=True, exist_ok=True)
    policy.save(cell.policy)
    summary = {
        "training": wanted,
        "environment": policy.settings,
        "curve": [point],
        "best": point,
        "final": point,
        "seconds": seconds,
        "parameters": policy.parameter_count,
        "machine": describe_machine(),
        "versions": package_versions("octoarm-env", "octoarm-agents", "numpy", "scikit-learn"),
    }
    write_json(cell.policy.parent / "training.json", summary)
    return summary
