"""All that an agent is compared by, measured in one place, the same for every agent."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octoarm_agents.common.environment import make_vector_env
from octoarm_agents.common.whole import whole_fields
from octoarm_agents.policies import load_policy
from octoarm_agents.policies.evaluation import TRIVIAL, Trivial, acting
from octoarm_agents.policies.measures import orbit_measures, recovery, tracking_measures
from octoarm_agents.policies.rollout import Noise, PolicyPredictor, Push, Rollout, roll_out
from octoarm_env import ArmParameters, OctoArmVectorEnv

__all__ = [
    "BODIES",
    "BURSTS",
    "NOISES",
    "PUSHES",
    "Protocol",
    "changed_body",
    "inference_time",
    "measure_agent",
    "phase_portrait",
]

Float = NDArray[np.float64]

PUSHES = (5.0, 10.0, 20.0)
"""Sizes of the push of the base [degrees]; a quarter, a half, all of the amplitude."""

NOISES = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3)
"""Half widths of the white noise on the lengths that the agent sees [m]; a spring has 0.02 m."""

BURSTS = (1e-5, 1e-4, 1e-3)
"""The same, for a second only, after which the arm must find back."""

BODIES = ((0.8, 0.8), (0.8, 1.2), (1.2, 0.8), (1.2, 1.2))
"""Factors of all stiffnesses and of all dampings of the changed bodies."""


@dataclass(frozen=True)
class Protocol:
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

    def __post_init__(self) -> None:
        whole_fields(self, seed=0, episodes=1, steps=1, long_steps=1, after=1)


_BEGIN = 100
"""Step at which a disturbance begins: after a second."""

_PUSHED, _BURST = 20, 100
"""Steps that a push and a burst of noise last."""


def changed_body(body: ArmParameters, stiffness: float, damping: float) -> ArmParameters:
    """Give a body whose stiffnesses and dampings are multiplied by a factor each."""
    return body.replace(
        longitudinal_stiffness=stiffness * body.longitudinal_stiffness,
        transverse_stiffness=stiffness * body.transverse_stiffness,
        longitudinal_damping=damping * body.longitudinal_damping,
        transverse_damping=damping * body.transverse_damping,
    )


def measure_agent(
    parameters: ArmParameters,
    *,
    agent: str,
    settings: dict[str, Any],
    policy: str | None,
    digest: str | None,
    protocol: dict[str, Any],
) -> dict[str, Any]:
    """Measure an agent; a trial for `run_trials`.

    Args:
        parameters: the body.
        agent: its name; ``"hold"`` and ``"clock"`` need no policy.
        settings: of the environment.
        policy: its file.
        digest: of that file, so that stored results are those of this very policy.
        protocol: arguments of `Protocol`.

    Returns:
        Plain numbers: ``return``, ``tracking_error``, ``orbit_distance``, ``period``, ``held``,
        ``survival``, and for every size or body ``pushes``, ``bursts``, ``noises``, ``bodies``.
    """
    del digest
    given = Protocol(**protocol)
    chosen: PolicyPredictor | Trivial
    if policy is not None:
        chosen = load_policy(policy, settings=settings)
    elif agent in TRIVIAL:
        chosen = agent
    else:
        raise ValueError(f"agent = {agent!r} needs the file of its policy")
    test = _Test(chosen, parameters, settings, given)
    standard = test.run(given.steps)
    tracking = tracking_measures(standard)
    long = orbit_measures(
        test.run(given.long_steps),
        test.orbit,
        amplitude=test.amplitude,
        period=test.period,
        control_period=settings["control_period"],
        window=max(given.long_steps // 3, 1),
    )
    bodies = []
    for stiffness, damping in BODIES:
        other = _Test(chosen, changed_body(parameters, stiffness, damping), settings, given)
        rollout = other.run(given.steps)
        bodies.append(
            {
                "stiffness": stiffness,
                "damping": damping,
                "return": tracking_measures(rollout)["return"],
                **other.settled(rollout),
            }
        )
    noises = []
    for size in NOISES:
        rollout = test.run(given.steps, noise=Noise(size))
        noises.append(
            {
                "size": size,
                "return": tracking_measures(rollout)["return"],
                "orbit_distance": test.settled(rollout)["orbit_distance"],
            }
        )
    return {
        **tracking,
        **{name: long[name] for name in ("orbit_distance", "period", "held", "survival")},
        "returns": standard.returns.tolist(),
        "pushes": [
            {"size": size, **test.recovery(Push(size, _BEGIN, _PUSHED), None)} for size in PUSHES
        ],
        "bursts": [
            {"size": size, **test.recovery(None, Noise(size, _BEGIN, _BURST))} for size in BURSTS
        ],
        "noises": noises,
        "bodies": bodies,
    }


class _Test:
    """An agent on a body."""

    def __init__(
        self,
        policy: PolicyPredictor | Trivial,
        parameters: ArmParameters,
        settings: dict[str, Any],
        protocol: Protocol,
    ) -> None:
        self.policy = policy
        self.parameters = parameters
        self.settings = settings
        self.protocol = protocol
        envs = self._envs(1)
        self.orbit = np.array(envs.get_attr("orbit")[0])
        self.amplitude = float(envs.get_attr("amplitude")[0])
        self.period = float(envs.get_attr("period")[0])
        envs.close()

    def _envs(self, steps: int) -> OctoArmVectorEnv:
        return make_vector_env(
            self.protocol.episodes, self.parameters, self.settings, steps=steps, threads=1
        )

    def run(self, steps: int, *, push: Push | None = None, noise: Noise | None = None) -> Rollout:
        envs = self._envs(steps)
        try:
            return roll_out(
                acting(self.policy, envs),
                envs,
                seed=self.protocol.seed,
                steps=steps,
                push=push,
                noise=noise,
            )
        finally:
            envs.close()

    def recovery(self, push: Push | None, noise: Noise | None) -> dict[str, float | None]:
        end = _BEGIN + (_PUSHED if push is not None else _BURST)
        return recovery(
            self.run(end + self.protocol.after, push=push, noise=noise),
            self.orbit,
            amplitude=self.amplitude,
            control_period=self.settings["control_period"],
            end=end,
        )

    def settled(self, rollout: Rollout) -> dict[str, float | None]:
        """Distance from the orbit, in amplitudes, and period, over the second half."""
        found = orbit_measures(
            rollout,
            self.orbit,
            amplitude=self.amplitude,
            period=self.period,
            control_period=self.settings["control_period"],
            window=max(len(rollout.rewards) // 2, 1),
        )
        return {name: found[name] for name in ("orbit_distance", "period")}


def inference_time(policy: PolicyPredictor, springs: int, *, calls: int = 2000) -> float:
    """Microseconds of a call of `predict` on one observation: the median over calls."""
    lengths = 0.02 + 1e-4 * np.random.default_rng(0).normal(size=springs)
    state, times = None, np.empty(calls)
    for index in range(calls):
        begun = time.perf_counter()
        _, state = policy.predict(lengths, state=state, deterministic=True)
        times[index] = time.perf_counter() - begun
    return float(1e6 * np.median(times))


def phase_portrait(
    policy: PolicyPredictor | Trivial,
    parameters: ArmParameters,
    settings: dict[str, Any],
    *,
    seed: int,
    steps: int,
) -> Float:
    """Base angles of one episode, (steps, 2) [degrees]."""
    envs = make_vector_env(1, parameters, settings, steps=steps, threads=1)
    try:
        return roll_out(acting(policy, envs), envs, seed=seed, steps=steps).angles[:, 0]
    finally:
        envs.close()
