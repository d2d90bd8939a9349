"""A training judged as it goes, and what every engine keeps of it alike."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym

from octoarm_agents.common.environment import ENV_ID, inspect_env, make_vector_env
from octoarm_agents.common.files import write_json
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.policies.evaluation import JUDGING_SEED
from octoarm_agents.policies.network import Network
from octoarm_agents.policies.policy import Policy
from octoarm_agents.policies.rollout import roll_out
from octoarm_agents.rl.task import Training

JUDGED_STEPS = 500
"""Control periods of the episodes that a policy is evaluated in: those of the standard episode."""

_BODIES = ("vary", "bodies", "body_seed")

Progress = Callable[[int, float], None]
"""Told of a training under way: the steps done, and the last evaluated return or NaN."""


class Judge:
    """Lets policies act as they will be kept, on seeds that none is trained on; keeps the best.

    Attributes:
        curve: a point for each evaluation: steps, seconds, and mean, lowest and highest return.
        seconds: of training, evaluations not among them.
        extended: how the training was made longer, if it was.
    """

    def __init__(self, training: Training, out: Path, command: str | None) -> None:
        self.training, self.out, self.command = training, out, command
        env = gym.make(ENV_ID, target=training.target, **training.env)
        self.parameters, self.settings = inspect_env(env)
        # Where bodies vary, it is judged on these.
        bodies = {name: training.env[name] for name in _BODIES if name in training.env}
        home = self.settings | bodies
        self.judges = make_vector_env(
            training.episodes, self.parameters, home, steps=JUDGED_STEPS, threads=1
        )
        self.curve: list[dict[str, Any]] = []
        self.seconds = 0.0
        self.extended: list[dict[str, Any]] = []
        self.start()

    def start(self) -> None:
        """Training goes on from here: count its seconds."""
        self._begun = time.perf_counter()

    @property
    def best(self) -> dict[str, Any]:
        """The first of the points with the highest return."""
        return max(self.curve, key=lambda point: float(point["return"]))

    def due(self, steps: int) -> bool:
        """Whether another of the training's evaluations, but for the last, is to come now."""
        interval = self.training.steps / self.training.evaluations
        last = self.curve[-1]["steps"] if self.curve else 0
        return steps // interval > last // interval and steps < self.training.steps

    def judge(self, network: Network, steps: int) -> Policy:
        """Let a network act after so many steps of training; keep it if it is the best so far."""
        self.seconds += time.perf_counter() - self._begun
        training = {
            **self.training.plain(),
            "trained_steps": steps,
            "command": self.command,
            "extended": self.extended,
        }
        algorithm, seed = self.training.algorithm, self.training.seed
        policy = Policy(network, algorithm, self.parameters, self.settings, training, seed)
        returns = roll_out(policy, self.judges, seed=JUDGING_SEED, steps=JUDGED_STEPS).returns
        point = {
            "steps": steps,
            "seconds": self.seconds,
            "return": float(returns.mean()),
            "lowest": float(returns.min()),
            "highest": float(returns.max()),
        }
        policy.training["return"] = point["return"]
        self.curve.append(point)
        if self.best is point:
            policy.save(self.out / "best.npz")
        return policy

    def finish(self, policy: Policy, packages: tuple[str, ...], **more: Any) -> dict[str, Any]:
        """Write the last policy, and ``training.json``; give what that holds."""
        policy.save(self.out / "final.npz")
        summary = {
            "training": self.training.plain(),
            "command": self.command,
            "environment": self.settings,
            "curve": self.curve,
            "best": self.best,
            "final": self.curve[-1],
            "seconds": self.seconds,
            "extended": self.extended,
            "parameters": policy.parameter_count,
            "machine": describe_machine(),
            "versions": package_versions("octoarm-env", "octoarm-agents", "numpy", *packages),
            **more,
        }
        write_json(self.out / "training.json", summary)
        return summary
