"""All that an agent is compared by, measured in one place, the same for every agent."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from octoarm_agents.common.environment import make_vector_env
from octoarm_agents.common.whole import whole_fields
from octoarm_agents.policies import load_policy
from octoarm_agents.policies.evaluation import TRIVIAL, Trivial, acting, evaluate_policy
from octoarm_agents.policies.measures import TargetOrbit, recovery
from octoarm_agents.policies.rollout import Noise, PolicyPredictor, Push, Rollout, roll_out
from octoarm_env import ArmParameters

PUSHES = (5.0, 10.0, 20.0)
"""Sizes of the push of the base [degrees]; a quarter, a half, all of the amplitude."""

NOISES = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3)
"""Half widths of the white noise on the lengths that the agent sees [m]; a spring has 0.02 m."""

BURSTS = (1e-5, 1e-4, 1e-3)
"""The same, for a second only, after which the arm must find back."""

_BURST = (100, 100)
"""First step and number of steps of a burst; a push begins as late, and is a fifth as long."""

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
    return body.replace(
        longitudinal_stiffness=stiffness * body.longitudinal_stiffness,
        transverse_stiffness=stiffness * body.transverse_stiffness,
        longitudinal_damping=damping * body.longitudinal_damping,
        transverse_damping=damping * body.transverse_damping,
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
    parameters: ArmParameters,
    *,
    agent: str,
    settings: dict[str, Any],
    policy: str | None,
    digest: str | None,
    plan: dict[str, Any],
) -> dict[str, Any]:
    """Measure an agent; a trial for `run_trials`.

    Args:
        parameters: the body.
        agent: its name; ``"hold"`` and ``"clock"`` need no policy.
        settings: of the environment.
        policy: its file.
        digest: of that file, so that stored results are those of this very policy.
        plan: arguments of `TestPlan`.

    Returns:
        Plain numbers: ``return``, ``tracking_error``, ``orbit_distance``, ``period``, ``held``,
        ``survival``, and for every size or body ``pushes``, ``bursts``, ``noises``, ``bodies``.
    """
    del digest
    given = TestPlan(**plan)
    chosen: PolicyPredictor | Trivial
    if policy is not None:
        chosen = load_policy(policy, settings=settings)
    elif agent in TRIVIAL:
        chosen = agent
    else:
        raise ValueError(f"agent = {agent!r} needs the file of its policy")
    test = AgentTest(chosen, parameters, settings, given)
    standard = test.measures()
    long = test.measures(given.long_steps, given.long_steps // 3)
    bodies: list[dict[str, Any]] = []
    for stiffness, damping in BODIES:
        body = changed_body(parameters, stiffness, damping)
        found = AgentTest(chosen, body, settings, given).measures()
        kept = _selected(found, "return", "orbit_distance", "period")
        bodies.append({"stiffness": stiffness, "damping": damping, **kept})
    noises = [
        {"size": size, **_selected(test.measures(noise=Noise(size)), "return", "orbit_distance")}
        for size in NOISES
    ]
    return {
        **_selected(standard, "return", "tracking_error"),
        **_selected(long, "orbit_distance", "period", "held", "survival"),
        "pushes": [{"size": size, **test.recovery(push=Push(size))} for size in PUSHES],
        "bursts": [{"size": size, **test.recovery(noise=Noise(size, *_BURST))} for size in BURSTS],
        "noises": noises,
        "bodies": bodies,
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
