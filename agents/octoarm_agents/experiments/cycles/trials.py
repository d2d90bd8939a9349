"""The trials of task 2: teach a cycle, hold it, disturb it (section 2.2.2, 3.2).

Every function here is a trial of `octoarm_agents.common.trials`: plain numbers in and out. A
teaching comes as the keyword arguments of `Teaching`, a taught loop as those of `TaughtLoop`.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from octoarm_agents.common.orbit import orbit_distance
from octoarm_agents.experiments.cycles.series import align_orbit, excerpt, phase_shift
from octoarm_agents.reservoir.closed_loop import (
    FORCED_STEPS,
    WINDOW_STEPS,
    ClosedLoop,
    describe_domain_error,
    recovery_steps,
    release,
    score_window,
)
from octoarm_agents.reservoir.teaching import Teaching, teach
from octoarm_env import LIMIT_CYCLES, Arm, ArmParameters, DomainError
from octoarm_env.arrays import Float

BURST_BEGIN, BURST_END = 6_000, 7_000
"""Steps of the closed loop between which noise is added to the outputs, anew each step."""

BURST_RUN = 30_000
"""Steps of a disturbed run: 23 s to come back in."""

NUDGE_STEP = 6_000
NUDGED_STEPS = 500
"""Step whose outputs alone are disturbed, and T, the steps over which that is followed."""

SHOWN_STEPS = 3_000
DISTURBED_EVERY = 10
"""Steps shown of the begin and of the end of a run; and every how many of a disturbed run."""

_DISTANCE_EVERY = 5
"""Steps between two distances when the way back after a burst is looked at."""


@dataclass(frozen=True)
class TaughtLoop:
    """A limit cycle and the readout that is to hold it.

    Attributes:
        target: name of the limit cycle.
        amplitude: R [degrees].
        actuator: of the base.
        weights: of the readout, (springs, 2) [degrees/m].
    """

    target: str
    amplitude: float
    actuator: Literal["direct", "servo"]
    weights: Sequence[Sequence[float]]

    @property
    def orbit(self) -> Float:
        """One turn of the target, (K, 2) [degrees]."""
        return LIMIT_CYCLES[self.target].orbit(self.amplitude)

    def teacher(self, steps: int) -> Float:
        """What the teacher would have gone on with after the release, (steps, 2) [degrees]."""
        signal = LIMIT_CYCLES[self.target].signal(FORCED_STEPS + steps, self.amplitude)
        return signal[FORCED_STEPS:]

    def close(self, parameters: ArmParameters, **limits: Any) -> ClosedLoop:
        """Let an arm go that the teacher has forced; `limits` are as in `ClosedLoop`.

        Raises:
            DomainError: the arm cannot follow the teacher.
        """
        arm = release(parameters, self.target, self.amplitude, self.actuator)
        return ClosedLoop(arm, np.array(self.weights), self.amplitude, **limits)


def teach_cycle(parameters: ArmParameters, *, teaching: Mapping[str, Any]) -> dict[str, Any]:
    """Teach a readout a cycle.

    Args:
        parameters: the body.
        teaching: keyword arguments of `Teaching`.

    Returns:
        ``failure`` (None, or the domain error of an arm that could not follow the teacher),
        ``weights`` (springs, 2), ``exponents`` [1/s] largest first, ``training_error_deg`` and
        ``teaching_seconds``.
    """
    started = time.perf_counter()
    try:
        taught = teach(parameters, Teaching(**teaching))
    except DomainError as error:
        return {"failure": {"stage": "teaching"} | describe_domain_error(error)}
    return {
        "failure": None,
        "weights": taught.readout.weights_.tolist(),
        "exponents": [each if math.isfinite(each) else None for each in taught.exponents.tolist()],
        "training_error_deg": taught.readout.training_error_,
        "teaching_seconds": time.perf_counter() - started,
    }


def hold_cycle(parameters: ArmParameters, *, loop: Mapping[str, Any], steps: int) -> dict[str, Any]:
    """Let a taught arm go for many steps.

    Args:
        parameters: the body.
        loop: keyword arguments of `TaughtLoop`.
        steps: of the closed loop.

    Returns:
        ``steps``, those made; ``survived``, whether these are all; ``failure``; ``scores`` of the
        last `WINDOW_STEPS` (None after a failure); ``largest_jump_deg``, of an output from a step
        to the next; ``seconds``; ``series``, the begin and the end of the run for the figure.
    """
    started = time.perf_counter()
    taught = TaughtLoop(**loop)
    # The paper discards runs whose outputs jump; here they go on, and their largest jump is told.
    closed = taught.close(parameters, jump=None)
    shown = min(SHOWN_STEPS, steps // 2)
    begin, begin_lengths = closed.record(shown)
    closed.run(steps - 2 * shown)
    end, end_lengths = closed.record(shown)
    outputs, orbit = closed.outputs, taught.orbit
    turn = LIMIT_CYCLES[taught.target].period / parameters.timestep
    series = [excerpt(0, begin, taught.teacher(len(begin)), begin_lengths)]
    if len(end):
        aligned = align_orbit(end, orbit, turn)
        series.append(excerpt(len(outputs) - len(end), end, aligned, end_lengths))
    held = closed.failure is None
    return {
        "steps": len(outputs),
        "survived": held,
        "failure": closed.failure,
        "largest_jump_deg": float(np.abs(np.diff(outputs, axis=0)).max(initial=0.0)),
        "scores": score_window(outputs[-WINDOW_STEPS:], orbit, turn) if held else None,
        "seconds": time.perf_counter() - started,
        "series": series,
    }


def disturb_cycle(
    parameters: ArmParameters,
    *,
    loop: Mapping[str, Any],
    burst: float,
    seed: int,
    trial: int,
    series: bool = False,
) -> dict[str, Any]:
    """Add white noise to the outputs for a while, and see whether the loop comes back.

    Args:
        parameters: the body.
        loop: keyword arguments of `TaughtLoop`.
        burst: ε, half width of the noise [degrees].
        seed: of the experiment.
        trial: number of the trial; its noise is the same, but for the size, for any ε.
        series: give the outputs, as always those of trial 0, for the figure.

    Returns:
        ``burst_deg``, ``trial``; ``failure``; ``held_before``; ``recovered``: the cycle is held
        before the noise, and again at the end of the run; if so, ``recovery_seconds`` after the
        noise and ``phase_shift``, by how much the turns are late [turns]; ``farthest``, the largest
        distance during the noise and after it in units of R (None after a failure); ``series``,
        where it is asked for.
    """
    taught = TaughtLoop(**loop)
    orbit, turn = taught.orbit, LIMIT_CYCLES[taught.target].period / parameters.timestep
    closed = taught.close(parameters)
    noise = np.random.default_rng([seed, trial]).uniform(-1.0, 1.0, (BURST_END - BURST_BEGIN, 2))
    closed.run(BURST_BEGIN)
    closed.run(len(noise), burst * noise)
    closed.run(BURST_RUN - BURST_END)
    outputs = closed.outputs
    result: dict[str, Any] = {
        "burst_deg": burst,
        "trial": trial,
        "failure": closed.failure,
        "held_before": False,
        "recovered": False,
    } | dict.fromkeys(("recovery_seconds", "phase_shift", "farthest"))
    if len(outputs) >= BURST_BEGIN:
        before = score_window(outputs[BURST_BEGIN - WINDOW_STEPS : BURST_BEGIN], orbit, turn)
        result["held_before"] = before["held"]
    if closed.failure is None:
        after = score_window(outputs[-WINDOW_STEPS:], orbit, turn)
        distances = orbit_distance(outputs[BURST_BEGIN::_DISTANCE_EVERY], orbit) / taught.amplitude
        since = distances[(BURST_END - BURST_BEGIN) // _DISTANCE_EVERY :]
        result["farthest"] = float(distances.max())
        result["recovered"] = before["held"] and after["held"]
        if result["recovered"]:
            way = _DISTANCE_EVERY * recovery_steps(since, before["max_distance"])
            result["recovery_seconds"] = way * parameters.timestep
            begin, end = BURST_BEGIN - WINDOW_STEPS, BURST_RUN - WINDOW_STEPS
            result["phase_shift"] = phase_shift(
                outputs[begin:BURST_BEGIN, 1], outputs[end:, 1], end - begin
            )
    if series or trial == 0:
        forced = taught.teacher(len(outputs))
        result["series"] = excerpt(0, outputs, forced, every=DISTURBED_EVERY)
    return result


def nudge_cycle(
    parameters: ArmParameters,
    *,
    loop: Mapping[str, Any],
    nudges: Sequence[float],
    seed: int,
    trial: int,
) -> dict[str, Any]:
    """Disturb the outputs of one single step, and follow what becomes of it (Figure 13A).

    Args:
        parameters: the body.
        loop: keyword arguments of `TaughtLoop`.
        nudges: ε, half widths of the noise [degrees].
        seed: of the experiment.
        trial: number of the trial; its noise is the same, but for the size, for any ε.

    Returns:
        ``failure`` of the undisturbed run, else for each of `nudges` the mean squares over
        `NUDGED_STEPS` of the differences to it: ``outputs`` ([O_1, O_2] [degrees²]) and ``springs``
        [m²]; None for both where the disturbed run failed.
    """
    closed = TaughtLoop(**loop).close(parameters)
    closed.run(NUDGE_STEP)
    if closed.failure is not None:
        return {"failure": closed.failure}
    direction = np.random.default_rng([seed, trial]).uniform(-1.0, 1.0, 2)
    try:
        undisturbed = _follow_nudge(closed.arm, closed.weights, np.zeros(2))
    except DomainError as error:
        return {"failure": describe_domain_error(error)}
    results: list[dict[str, Any]] = []
    for nudge in nudges:
        try:
            disturbed = _follow_nudge(closed.arm, closed.weights, nudge * direction)
        except DomainError:
            results.append({"outputs": None, "springs": None})
            continue
        outputs, springs = (np.square(b - a) for a, b in zip(undisturbed, disturbed, strict=True))
        results.append({"outputs": outputs.mean(axis=0).tolist(), "springs": float(springs.mean())})
    return {"failure": None, "results": results}


def _follow_nudge(start: Arm, weights: Float, nudge: Float) -> tuple[Float, Float]:
    """Outputs and lengths of the steps after one whose outputs are disturbed; `start` stays."""
    arm = copy.deepcopy(start)
    noise = np.zeros((NUDGED_STEPS + 1, 2))
    noise[0] = nudge
    outputs, lengths = arm.run_closed_loop(weights, len(noise), noise)
    # The outputs of the disturbed step itself were said before the noise; it moves the springs at
    # once, and the outputs from the next step on.
    return outputs[1:], lengths[:-1]
