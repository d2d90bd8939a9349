"""The agents that are compared, and how each comes about."""

from __future__ import annotations

import hashlib
import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from octoarm_agents.common.environment import TARGETS
from octoarm_agents.common.files import write_json
from octoarm_agents.common.progress import progress_bar
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.whole import whole_fields
from octoarm_agents.comparison.linear_search import LinearSearch, search_linear
from octoarm_agents.policies.evaluation import (
    JUDGED_EPISODES,
    JUDGING_SEED,
    TRIVIAL,
    evaluate_policy,
)
from octoarm_agents.reservoir import Readout, ReadoutPolicy, train_policy
from octoarm_env import ArmParameters

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

_SLOW_FIRST = ("tqc", "sac", "recurrent_ppo", "ppo", "linear_search", *READOUTS)


@dataclass(frozen=True)
class TrainingRun:
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


def train_all(
    runs: list[TrainingRun], jobs: int, progress: bool | None
) -> dict[TrainingRun, dict[str, Any]]:
    """Make every agent, the slow ones first; give the summaries of their trainings."""
    from joblib import Parallel, delayed

    runs = sorted(runs, key=lambda run: _SLOW_FIRST.index(run.agent))
    summaries: dict[TrainingRun, dict[str, Any]] = {}
    with progress_bar(len(runs), "trainings", shown=progress) as bar:
        work = Parallel(n_jobs=min(jobs, max(len(runs), 1)), return_as="generator_unordered")
        for run, summary in work(delayed(_named)(run) for run in runs):
            summaries[run] = summary
            bar.set_postfix_str(f"{run.name}: {summary['best']['return']:.1f}")
            bar.update()
    return summaries


def _named(run: TrainingRun) -> tuple[TrainingRun, dict[str, Any]]:
    return run, make_agent(run)


def make_agent(run: TrainingRun) -> dict[str, Any]:
    """Train an agent, or take what an earlier call has trained; in one thread.

    Returns:
        The summary of the training: ``curve``, ``best``, ``seconds``, ``parameters``, …

    Raises:
        ValueError: the folder holds another training of this name.
    """
    from threadpoolctl import threadpool_limits

    # Sums split over threads are rounded otherwise.
    with threadpool_limits(1):
        return _train_network(run) if run.agent in NETWORKS else _find_linear(run)


def _train_network(run: TrainingRun) -> dict[str, Any]:
    from octoarm_agents.rl import Hyperparameters, Training, train

    steps = max(round(run.budget * Hyperparameters.load(run.agent).steps), 1)
    training = Training.make(run.agent, run.target, steps=steps, seed=run.seed)
    return train(training, run.policy.parent, resume=True, command=run.command)


def _find_linear(run: TrainingRun) -> dict[str, Any]:
    """A linear policy, fitted or searched, and its ``training.json``."""
    search = LinearSearch(run.target, max(round(run.budget * LinearSearch.steps), 1), run.seed)
    searching = run.agent == "linear_search"
    wanted = asdict(search) if searching else _teaching(run)
    file = run.policy.with_name("training.json")
    if file.exists():
        return _finished(file, wanted)
    file.parent.mkdir(parents=True, exist_ok=True)
    made = search_linear(search, file.parent) if searching else _teach_readout(run)
    versions = package_versions("octoarm-env", "octoarm-agents", "numpy", "scikit-learn", "cma")
    summary = {
        "training": wanted,
        **made,
        "final": made["curve"][-1],
        "machine": describe_machine(),
        "versions": versions,
    }
    write_json(file, summary)
    return summary


def _finished(file: Path, wanted: dict[str, Any]) -> dict[str, Any]:
    try:
        summary: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{file} is damaged: {error}") from None
    if summary.get("training") != wanted:
        raise ValueError(f"{file} is of another training: choose another folder")
    return summary


def _teaching(run: TrainingRun) -> dict[str, Any]:
    fit = {"method": "pinv"} if run.agent == "readout_pinv" else {"noise": RIDGE_NOISE}
    teaching = {"steps": TEACHING_STEPS, "seed": run.seed, "action_noise": ACTION_NOISE}
    return {"target": run.target, **teaching, **fit}


def _teach_readout(run: TrainingRun) -> dict[str, Any]:
    begun = time.perf_counter()
    noise = _teaching(run).get("noise", 0.0)
    policy = teach_readout(run.target, ACTION_NOISE, noise, run.seed)
    seconds = time.perf_counter() - begun
    judged = evaluate_policy(policy, policy, episodes=JUDGED_EPISODES, seed=JUDGING_SEED, threads=1)
    policy.save(run.policy)
    point = {"steps": TEACHING_STEPS, "seconds": seconds, "return": judged["return"]}
    return {
        "environment": policy.settings,
        "curve": [point],
        "best": point,
        "seconds": seconds,
        "parameters": policy.parameter_count,
    }


def teach_readout(
    target: str, action_noise: float, noise: float, seed: int, arm: ArmParameters | None = None
) -> ReadoutPolicy:
    """Teach a readout for `TEACHING_STEPS`.

    Args:
        target: of the environment.
        action_noise: κ, half width of the noise on the teacher's actions.
        noise: ν of the ridge [m]; 0: pseudo-inverse.
        seed: of the teaching.
        arm: the body; None: the default.
    """
    return train_policy(
        {"target": target, "max_episode_steps": TEACHING_STEPS, "arm": arm},
        steps=TEACHING_STEPS,
        action_noise=action_noise,
        seed=seed,
        readout=Readout("noise", noise=noise, bias=True) if noise else Readout("pinv", bias=True),
    )
