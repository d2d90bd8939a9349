"""The demonstration: the body learns a limit cycle and holds it alone (section 2.2.2, task 2).

1. *Teacher forcing.* The base follows the target; the spring lengths are recorded.
2. *Fit.* A linear readout without bias learns to give the target's next value from the lengths,
   and not to answer to what disturbances do to them (`octoarm_agents.reservoir.teaching`).
3. *Closed loop.* From rest again, the target forces the arm a while; then the readout's outputs
   drive the base and nothing else does. Half-way, white noise is added to both outputs.

Distances are those of the outputs to the nearest point of the target's orbit, in units of the
amplitude R.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.whole import whole_fields
from octoarm_agents.reservoir import Readout, orbit_distance
from octoarm_agents.reservoir.closed_loop import (
    FORCED_STEPS,
    WINDOW_STEPS,
    ClosedLoop,
    describe_domain_error,
    recovery_steps,
    release,
    score_window,
)
from octoarm_agents.reservoir.cycles import CYCLES, PAPER_BURSTS
from octoarm_agents.reservoir.teaching import Teaching, teach
from octoarm_env import LIMIT_CYCLES, Arm, ArmParameters, DomainError
from octoarm_env.arrays import Float

Advance = Callable[[str, int], None]

BURST_STEPS = 1_000
"""Section 3.2."""

MINIMUM_STEPS = 2 * (WINDOW_STEPS + BURST_STEPS)
"""Closed-loop steps that leave a whole window on both sides of the burst."""

_SHAPES = 8


@dataclass(frozen=True)
class DemoSettings:
    """What the demonstration does.

    Attributes:
        teaching: how the readout is taught: cycle, amplitude, actuator, noise.
        burst: ε, the half width of the noise on the outputs during the burst [degrees].
        steps: closed-loop physics steps, at least `MINIMUM_STEPS`.
        seed: of the burst's noise.
    """

    teaching: Teaching = CYCLES["quadratic"]["weighted"]
    burst: float = PAPER_BURSTS["quadratic"][0]
    steps: int = 20_000
    seed: int = 0

    def __post_init__(self) -> None:
        whole_fields(self, steps=MINIMUM_STEPS, seed=0)
        if not (self.burst >= 0 and math.isfinite(self.burst)):
            raise ValueError(f"burst = {self.burst}: expected a number of degrees, not negative")

    @property
    def burst_begin(self) -> int:
        """First closed-loop step with noise on the outputs."""
        return self.steps // 2

    @property
    def burst_end(self) -> int:
        """First closed-loop step after the noise."""
        return self.burst_begin + BURST_STEPS


@dataclass(frozen=True)
class DemoScores:
    """How well the cycle was held.

    Attributes:
        before: scores of the last window before the burst, see `score_window`; None: the run did
            not get so far. `burst` is the same of the burst, `after` of the run's last window.
        held: whether the cycle was held before the burst.
        recovered: whether it was held then, and again in the end.
        recovery_time: from the burst's end until the cycle is reached again [s]; None: it is not.
    """

    before: dict[str, Any] | None
    burst: dict[str, Any] | None
    after: dict[str, Any] | None
    held: bool
    recovered: bool
    recovery_time: float | None


@dataclass
class DemoResult:
    """What the demonstration found; arrays are as long as the run went.

    Attributes:
        settings: what was asked for.
        parameters: the body.
        orbit: (K, 2), one turn of the target [degrees].
        readout: the fitted readout, None if the arm left its domain while it was taught.
        outputs: (T, 2), the readout's outputs in closed loop, without the burst's noise [degrees].
        distances: (T,), of the outputs to the orbit, in units of the amplitude.
        shapes: (phases, N + 1, 3), plane centres at equal intervals of one turn [m].
        failure: what ended the run early, None if it went to its end.
        physics_steps: physics steps made after the teaching; 0 if the loop was never closed.
        physics_seconds: wall-clock seconds these took.
        wall_seconds: wall-clock seconds of all, target and fit and scores included.
    """

    settings: DemoSettings
    parameters: ArmParameters
    orbit: Float
    readout: Readout | None = None
    outputs: Float = field(default_factory=lambda: np.empty((0, 2)))
    distances: Float = field(default_factory=lambda: np.empty(0))
    shapes: Float = field(default_factory=lambda: np.empty((0, 0, 3)))
    failure: dict[str, Any] | None = None
    physics_steps: int = 0
    physics_seconds: float = 0.0
    wall_seconds: float = 0.0

    @property
    def target_period(self) -> float:
        """Period of the target [s]."""
        return LIMIT_CYCLES[self.settings.teaching.target].period

    @property
    def turn(self) -> float:
        """Period of the target [steps]."""
        return self.target_period / self.parameters.timestep

    def scores(self) -> DemoScores:
        """Judge the run."""
        begin, end = self.settings.burst_begin, self.settings.burst_end
        steps = self.settings.steps
        before = self._window(begin - WINDOW_STEPS, begin)
        after = self._window(steps - WINDOW_STEPS, steps)
        held = before is not None and before["held"]
        recovered = held and after is not None and after["held"]
        time = None
        if before is not None and recovered:
            made = recovery_steps(self.distances[end:], before["max_distance"])
            time = made * self.parameters.timestep
        return DemoScores(before, self._window(begin, end), after, held, recovered, time)

    def to_dict(self) -> dict[str, Any]:
        """Everything but the long arrays, as plain numbers for a JSON file; units in the keys."""
        settings, teaching = self.settings, self.settings.teaching
        simulated = self.physics_steps * self.parameters.timestep
        seconds = self.physics_seconds
        return {
            "settings": {
                "target": teaching.target,
                "actuator": teaching.actuator,
                "amplitude_degrees": teaching.amplitude,
                "noise_metres": teaching.noise,
                "noise_sampled": teaching.sampled,
                "disturbances_degrees": list(teaching.disturbances),
                "burst_degrees": settings.burst,
                "burst_steps": [settings.burst_begin, settings.burst_end],
                "training_steps": teaching.steps,
                "washout_steps": teaching.washout,
                "forced_steps": FORCED_STEPS,
                "closed_loop_steps": settings.steps,
                "window_steps": WINDOW_STEPS,
                "seed": settings.seed,
            },
            "scores": asdict(self.scores()),
            "failure": self.failure,
            "closed_loop_steps_made": len(self.outputs),
            "target_period_seconds": self.target_period,
            "speed": {
                "physics_steps": self.physics_steps,
                "physics_seconds": seconds,
                "microseconds_per_step": 1e6 * seconds / max(self.physics_steps, 1),
                "times_real_time": simulated / seconds if seconds > 0 else None,
                "wall_seconds": self.wall_seconds,
            },
            "readout": None
            if self.readout is None
            else {
                "training_error_degrees": self.readout.training_error_,
                "weights_degrees_per_metre": self.readout.weights_.tolist(),
            },
            "body": self.parameters.to_dict(),
            "versions": package_versions("octoarm-env", "octoarm-agents", "numpy", "matplotlib"),
            "machine": describe_machine(),
        }

    def _window(self, begin: int, end: int) -> dict[str, Any] | None:
        """Scores of the closed-loop steps from `begin` to `end`; None if they were not all made."""
        if len(self.outputs) < end:
            return None
        own, distances = self.outputs[begin:end], self.distances[begin:end]
        return score_window(own, self.orbit, self.turn, distances)


def run_demo(
    settings: DemoSettings,
    parameters: ArmParameters | None = None,
    advance: Advance | None = None,
) -> DemoResult:
    """Teach the arm, let it go, disturb it.

    Args:
        settings: what to do.
        parameters: the body; the default is ``ArmParameters()``.
        advance: called with the name of the stage and the number of physics steps just made.

    Returns:
        The result; if the arm left its domain, up to there, with `failure` set.
    """
    started = time.perf_counter()
    report = advance or (lambda stage, steps: None)
    teaching, body = settings.teaching, parameters or ArmParameters()
    result = DemoResult(settings, body, LIMIT_CYCLES[teaching.target].orbit(teaching.amplitude))
    stage = "teaching"
    try:
        readout = result.readout = teach(body, teaching).readout
        report(stage, teaching.steps)
        stage = "swinging in"
        begun = time.perf_counter()
        arm = release(body, teaching.target, teaching.amplitude, teaching.actuator)
        result.physics_seconds = time.perf_counter() - begun
        report(stage, FORCED_STEPS)
        _close_loop(arm, readout, result, report)
    except DomainError as error:
        result.failure = {"stage": stage} | describe_domain_error(error)
    result.distances = orbit_distance(result.outputs, result.orbit) / teaching.amplitude
    result.wall_seconds = time.perf_counter() - started
    return result


def _close_loop(arm: Arm, readout: Readout, result: DemoResult, report: Advance) -> None:
    """Let the readout drive the arm. Only the domain ends it: jumps and rest are to be seen too."""
    settings = result.settings
    random = np.random.default_rng(settings.seed)
    burst = random.uniform(-settings.burst, settings.burst, (BURST_STEPS, 2))
    stage = ""
    loop = ClosedLoop(
        arm,
        readout.weights_,
        settings.teaching.amplitude,
        jump=None,
        rest=None,
        advance=lambda steps: report(stage, steps),
    )
    for stage, steps, noise in (
        ("alone", settings.burst_begin, None),
        ("disturbed", BURST_STEPS, burst),
        ("alone again", settings.steps - settings.burst_end, None),
    ):
        if noise is not None:
            result.shapes = _shapes(arm, readout, result.turn)
        begun = time.perf_counter()
        loop.run(steps, noise)
        result.physics_seconds += time.perf_counter() - begun
        if loop.failure is not None:
            result.failure = {"stage": stage} | loop.failure
            break
    result.outputs, result.physics_steps = loop.outputs, arm.state.steps


def _shapes(arm: Arm, readout: Readout, period: float) -> Float:
    """Plane centres over the coming turn, (phases, N + 1, 3) [m]; the arm itself stays."""
    probe = copy.deepcopy(arm)
    shapes = [probe.positions]
    steps = np.diff(np.round(np.arange(_SHAPES) * period / _SHAPES).astype(int))
    for count in steps:
        probe.run_closed_loop(readout.weights_, int(count))
        shapes.append(probe.positions)
    return np.stack(shapes)
