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
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.whole import whole_fields
from octoarm_agents.reservoir import Readout, orbit_distance
from octoarm_agents.reservoir.closed_loop import (
    FORCED_STEPS,
    WINDOW_STEPS,
    ClosedLoop,
    describe_domain_error,
    recovery_steps,
    score_window,
)
from octoarm_agents.reservoir.cycles import CYCLES, PAPER_BURSTS
from octoarm_agents.reservoir.teaching import Teaching, teach
from octoarm_env import LIMIT_CYCLES, Arm, ArmParameters, DomainError, LimitCycle

__all__ = ["FORCED_STEPS", "DemoResult", "DemoSettings", "run_demo"]

Float = NDArray[np.float64]
Advance = Callable[[str, int], None]

BURST_STEPS = 1_000
"""Section 3.2."""

MINIMUM_STEPS = 2 * (WINDOW_STEPS + BURST_STEPS)
"""Closed-loop steps that leave a whole window on both sides of the burst."""

_CHUNK = 1_000
"""Physics steps of teacher forcing between two reports of progress."""

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


@dataclass
class DemoResult:
    """What the demonstration found; arrays are as long as the run went.

    Attributes:
        settings: what was asked for.
        parameters: the body.
        orbit: (K, 2), one turn of the target [degrees].
        forced: (FORCED_STEPS, 2), the target's approach to its orbit [degrees].
        readout: the fitted readout, None if the arm left its domain while it was taught.
        outputs: (T, 2), the readout's outputs in closed loop, without the burst's noise [degrees].
        distances: (T,), of the outputs to the orbit, in units of the amplitude.
        shapes: (phases, N + 1, 3), plane centres at equal intervals of one turn [m].
        failure: what ended the run early, None if it went to its end.
        physics_steps: physics steps made after the teaching.
        physics_seconds: wall-clock seconds these took.
        wall_seconds: wall-clock seconds of all, target and fit and scores included.
    """

    settings: DemoSettings
    parameters: ArmParameters
    orbit: Float
    forced: Float
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

    def scores(self) -> dict[str, Any]:
        """The figures: distances by window, held, recovered, recovery time, period, amplitude.

        A window is None where the run did not reach its end.
        """
        begin, end = self.settings.burst_begin, self.settings.burst_end
        before = self._window(begin - WINDOW_STEPS, begin)
        burst = self._window(begin, end)
        after = self._window(self.settings.steps - WINDOW_STEPS, self.settings.steps)
        held = before is not None and before["held"]
        recovered = held and after is not None and after["held"]
        return {
            "before": before,
            "burst": burst,
            "after": after,
            "held": held,
            "recovered": recovered,
            "recovery_time": self._recovery_time(before) if before and recovered else None,
        }

    def to_dict(self) -> dict[str, Any]:
        """Everything but the long arrays, as plain numbers for a JSON file; units in the keys."""
        simulated = self.physics_steps * self.parameters.timestep
        seconds = self.physics_seconds
        return {
            "settings": {
                "target": self.settings.teaching.target,
                "actuator": self.settings.teaching.actuator,
                "amplitude_degrees": self.settings.teaching.amplitude,
                "noise_metres": self.settings.teaching.noise,
                "noise_sampled": self.settings.teaching.sampled,
                "disturbances_degrees": list(self.settings.teaching.disturbances),
                "burst_degrees": self.settings.burst,
                "burst_steps": [self.settings.burst_begin, self.settings.burst_end],
                "training_steps": self.settings.teaching.steps,
                "washout_steps": self.settings.teaching.washout,
                "forced_steps": FORCED_STEPS,
                "closed_loop_steps": self.settings.steps,
                "window_steps": WINDOW_STEPS,
                "seed": self.settings.seed,
            },
            "scores": self.scores(),
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
        turn = self.target_period / self.parameters.timestep
        return score_window(self.outputs[begin:end], self.orbit, turn, self.distances[begin:end])

    def _recovery_time(self, before: dict[str, Any]) -> float:
        """Seconds from the burst's end until the cycle is reached again."""
        since = self.distances[self.settings.burst_end :]
        return recovery_steps(since, before["max_distance"]) * self.parameters.timestep


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
    teaching = settings.teaching
    cycle = LIMIT_CYCLES[teaching.target]
    signal = cycle.signal(FORCED_STEPS, teaching.amplitude)
    arm = Arm(parameters, teaching.actuator)
    result = DemoResult(settings, arm.parameters, cycle.orbit(teaching.amplitude), signal)
    run = _Run(arm, result, advance or (lambda stage, steps: None))
    try:
        run.stage = "teaching"
        result.readout = teach(arm.parameters, teaching).readout
        run.advance(teaching.steps)
        run.follow("swinging in", signal)
        _close_loop(run, cycle, result.readout)
    except DomainError as error:
        result.failure = {"stage": run.stage} | describe_domain_error(error)
    result.distances = orbit_distance(result.outputs, result.orbit) / teaching.amplitude
    result.wall_seconds = time.perf_counter() - started
    return result


def _close_loop(run: _Run, cycle: LimitCycle, readout: Readout) -> None:
    settings = run.result.settings
    random = np.random.default_rng(settings.seed)
    burst = random.uniform(-settings.burst, settings.burst, (BURST_STEPS, 2))
    # The demonstration shows what happens, jumps and rest too; only the domain ends it.
    loop = ClosedLoop(
        run.arm,
        readout.weights_,
        settings.teaching.amplitude,
        jump=None,
        rest=None,
        advance=run.advance,
    )
    turn = cycle.period / run.arm.parameters.timestep
    try:
        for stage, steps, noise in (
            ("alone", settings.burst_begin, None),
            ("disturbed", BURST_STEPS, burst),
            ("alone again", settings.steps - settings.burst_end, None),
        ):
            if stage == "disturbed":
                run.result.shapes = _shapes(run.arm, readout, turn)
            run.stage = stage
            run.timed(loop.run, steps, noise)
            if loop.failure is not None:
                run.result.failure = {"stage": stage} | loop.failure
                break
    finally:
        run.result.outputs = loop.outputs


class _Run:
    """Moves the arm in chunks, keeps time, counts and reports the steps."""

    def __init__(self, arm: Arm, result: DemoResult, advance: Advance) -> None:
        self.arm = arm
        self.result = result
        self.stage = ""
        self._advance = advance

    def advance(self, steps: int) -> None:
        """Report physics steps just made."""
        self._advance(self.stage, steps)

    def follow(self, stage: str, angles: Float) -> None:
        """Command (T, 2) angles [degrees]."""
        self.stage = stage
        for begin in range(0, len(angles), _CHUNK):
            chunk = angles[begin : begin + _CHUNK]
            self.timed(self.arm.run, chunk)
            self.advance(len(chunk))

    def timed(self, move: Callable[..., Any], *arguments: Any) -> Any:
        """Call what moves the arm; its steps and seconds are added to the result's."""
        before = self.arm.state.steps
        started = time.perf_counter()
        try:
            return move(*arguments)
        finally:
            self.result.physics_seconds += time.perf_counter() - started
            self.result.physics_steps += self.arm.state.steps - before


def _shapes(arm: Arm, readout: Readout, period: float) -> Float:
    """Plane centres over the coming turn, (phases, N + 1, 3) [m]; the arm itself stays."""
    probe = copy.deepcopy(arm)
    shapes = [probe.positions]
    steps = np.diff(np.round(np.arange(_SHAPES) * period / _SHAPES).astype(int))
    for count in steps:
        probe.run_closed_loop(readout.weights_, int(count))
        shapes.append(probe.positions)
    return np.stack(shapes)
