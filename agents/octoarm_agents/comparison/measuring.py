"""All that an agent is compared by, measured in one place, the same for every agent."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from octoarm_agents.common.environment import inspect_env, make_vector_env
from octoarm_agents.common.whole import whole_fields
from octoarm_agents.policies import load_policy
from octoarm_agents.policies.evaluation import TRIVIAL, Trivial, acting, evaluate_policy
from octoarm_agents.policies.measures import TargetOrbit, recovery
from octoarm_agents.policies.rollout import Noise, PolicyPredictor, Push, Rollout, roll_out
from octoarm_env import ArmParameters, OctoArmEnv, OctoArmVectorEnv

PUSHES = (5.0, 10.0, 20.0)
"""Sizes of the push of the base [degrees]."""

SHAKES = (10.0,)
"""Half widths of the white noise on the base's command for a second, the paper's ε [degrees]."""

NOISES = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3)
"""Half widths of the white noise on the lengths that the agent sees [m]; a spring has 0.02 m."""

BURSTS = (1e-5, 1e-4, 1e-3)
"""The same, for a second only, after which the arm must find back."""

_BURST = (100, 100)
"""First step and number of steps of a burst; a push begins as late, and is a fifth as long."""

_SHOWN = 200
"""Control periods of a phase portrait: about three turns."""

BODIES = ((0.8, 0.8), (0.8, 1.2), (1.2, 0.8), (1.2, 1.2))
"""Factors of all stiffnesses and of all dampings of the changed bodies."""


@dataclass(frozen=True)
class TestPlan:
    """How much is measured.

    Attributes:
        seed: of the first evaluated episode; no agent was trained or chosen on these.
        episodes: side by side, in each test.
        steps: control periods of an episode; those of the standard environment.
        long_steps: of the test that lets the arm swing on by itself.
        after: steps that follow a disturbance, in which to recover; at least ten turns.
    """

    seed: int = 10_000
    episodes: int = 16
    steps: int = 500
    long_steps: int = 3000
    after: int = 800

    __test__ = False  # for pytest, which collects classes of such names

    def __post_init__(self) -> None:
        whole_fields(self, seed=0, episodes=1, steps=1, long_steps=1, after=1)


def changed_body(body: ArmParameters, stiffness: float, damping: float) -> ArmParameters:
    """Give a body whose stiffnesses and dampings are multiplied by a factor each."""
    return body.scaled(
        longitudinal_stiffness=stiffness,
        transverse_stiffness=stiffness,
        longitudinal_damping=damping,
        transverse_damping=damping,
    )


@dataclass
class AgentTest:
    """An agent on a body, always from the same episodes on.

    Attributes:
        policy: the agent.
        parameters: the body of its arms.
        settings: of the environment.
        plan: how much is measured.
    """

    policy: PolicyPredictor | Trivial
    parameters: ArmParameters
    settings: dict[str, Any]
    plan: TestPlan

    def run(self, steps: int, push: Push | None = None, noise: Noise | None = None) -> Rollout:
        """Let the agent act for so many control periods."""
        plan = self.plan
        envs = make_vector_env(
            plan.episodes, self.parameters, self.settings, steps=steps, threads=1
        )
        self.target = TargetOrbit.of(envs)
        try:
            policy = acting(self.policy, envs)
            return roll_out(policy, envs, seed=plan.seed, steps=steps, push=push, noise=noise)
        finally:
            envs.close()

    def measures(
        self, steps: int | None = None, window: int | None = None, noise: Noise | None = None
    ) -> dict[str, Any]:
        """What `evaluate_policy` gives.

        Args:
            steps: control periods; None: the plan's.
            window: last steps that count; None: the second half.
            noise: disturbs what the agent sees.
        """
        steps = steps or self.plan.steps
        return evaluate_policy(
            self.policy,
            self,
            episodes=self.plan.episodes,
            steps=steps,
            seed=self.plan.seed,
            noise=noise,
            window=max(window or steps // 2, 1),
            threads=1,
        )

    def recovery(
        self, push: Push | None = None, noise: Noise | None = None
    ) -> dict[str, float | None]:
        """`recovery` after a push or a burst of noise."""
        disturbance = push or noise
        assert disturbance is not None
        assert disturbance.steps is not None
        end = disturbance.begin + disturbance.steps
        return recovery(self.run(end + self.plan.after, push, noise), self.target, end)


def measure_agent(
    agent: str, policy: Path | None, arguments: Mapping[str, Any], plan: TestPlan
) -> dict[str, Any]:
    """Measure an agent, in one thread.

    Args:
        agent: its name; ``"hold"`` and ``"clock"`` need no policy.
        policy: its file.
        arguments: of the environment.
        plan: how much is measured.

    Returns:
        Plain numbers: ``return``, ``tracking_error``, ``orbit_distance``, ``period``, ``held``,
        ``survival``; for every size or body ``pushes``, ``shakes``, ``bursts``, ``noises``,
        ``bodies``; ``inference_us``, the time of an action; and ``portrait``, the base's angles at
        the end of the first episode [degrees].
    """
    parameters, settings = inspect_env(OctoArmEnv(**arguments))
    chosen: PolicyPredictor | Trivial
    if policy is not None:
        chosen = load_policy(policy, settings=settings)
    elif agent in TRIVIAL:
        chosen = agent
    else:
        raise ValueError(f"agent = {agent!r} needs the file of its policy")
    test = AgentTest(chosen, parameters, settings, plan)
    standard = test.measures()
    long = test.measures(plan.long_steps, plan.long_steps // 3)
    bodies: list[dict[str, Any]] = []
    for stiffness, damping in BODIES:
        body = changed_body(parameters, stiffness, damping)
        found = AgentTest(chosen, body, settings, plan).measures()
        kept = _selected(found, "return", "orbit_distance", "period")
        bodies.append({"stiffness": stiffness, "damping": damping, **kept})
    noises = [
        {"size": size, **_selected(test.measures(noise=Noise(size)), "return", "orbit_distance")}
        for size in NOISES
    ]
    shakes = [Push(size, *_BURST, white=True) for size in SHAKES]
    alone = replace(plan, episodes=1)
    shown = AgentTest(chosen, parameters, settings, alone).run(plan.steps)
    with closing(OctoArmVectorEnv(1, **arguments, threads=1)) as envs:
        envs.reset(seed=0)
        microseconds = inference_time(acting(chosen, envs), 4 * parameters.compartments)
    return {
        **_selected(standard, "return", "tracking_error"),
        **_selected(long, "orbit_distance", "period", "held", "survival"),
        "pushes": [{"size": size, **test.recovery(push=Push(size))} for size in PUSHES],
        "shakes": [{"size": push.size, **test.recovery(push=push)} for push in shakes],
        "bursts": [{"size": size, **test.recovery(noise=Noise(size, *_BURST))} for size in BURSTS],
        "noises": noises,
        "bodies": bodies,
        "inference_us": microseconds,
        "portrait": shown.angles[-_SHOWN:, 0].round(2).tolist(),
    }


def _selected(measures: dict[str, Any], *names: str) -> dict[str, Any]:
    return {name: measures[name] for name in names}


def inference_time(policy: PolicyPredictor, springs: int, *, calls: int = 2000) -> float:
    """Microseconds of a call of `predict` on one observation: the median over calls."""
    lengths = 0.02 + 1e-4 * np.random.default_rng(0).normal(size=springs)
    state, times = None, np.empty(calls)
    for index in range(calls):
        begun = time.perf_counter()
        _, state = policy.predict(lengths, state=state, deterministic=True)
        times[index] = time.perf_counter() - begun
    return float(1e6 * np.median(times))
