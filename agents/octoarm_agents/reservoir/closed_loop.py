"""The closed loop of task 2: a readout drives the base, and nothing else does (section 2.2.2).

From rest, the teacher forces the arm for 5000 steps (`release`); then the readout's outputs are the
base's commands (`ClosedLoop`, Eqs. 24-26). Distances are those of the outputs to the nearest point
of the target's orbit, in units of the amplitude R.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from octoarm_agents.common.orbit import is_held, orbit_distance, steps_to_return, turn_time
from octoarm_agents.common.whole import whole_number
from octoarm_agents.reservoir.readout import readout_outputs
from octoarm_env import LIMIT_CYCLES, Arm, ArmParameters, DomainError
from octoarm_env.arrays import Float

FORCED_STEPS = 5_000
"""Steps for which the teacher forces the resting arm before the loop is closed."""

WINDOW_STEPS = 5_000
"""Steps over which a run is scored, and in which an arm at rest is recognised as such."""

JUMP = 10.0
"""Section 3.2 discards runs in which an output changes by more than this in a step [degrees]."""

REST = 0.05
"""An arm whose outputs stay below this part of the amplitude for a window has come to rest."""

HELD_DISTANCE = 0.05
HELD_PERIOD = 0.01
HELD_AMPLITUDE = 0.1
"""A cycle counts as held if the mean distance in the window is at most 5 % of the amplitude, the
period right within 1 % and the amplitude within 10 %. The distance alone would not do: an arm at
rest has distance zero from the Lissajous curve, which passes through the origin."""

_CHUNK = 1_000
"""Physics steps between two reports of progress; also bounds the memory for the lengths."""


def release(
    parameters: ArmParameters,
    target: str,
    amplitude: float,
    actuator: Literal["direct", "servo"] = "direct",
) -> Arm:
    """Give an arm that started at rest and that the teacher has just let go.

    Args:
        parameters: the body.
        target: name of the limit cycle.
        amplitude: R, its largest angle [degrees].
        actuator: how the base follows its command, see `octoarm_env.Arm`.

    Raises:
        ValueError: an unknown target or actuator, an amplitude that is not positive.
        DomainError: the arm cannot follow the teacher.
    """
    if target not in LIMIT_CYCLES:
        raise ValueError(f"target = {target!r}: expected one of {sorted(LIMIT_CYCLES)}")
    arm = Arm(parameters, actuator)
    arm.run(LIMIT_CYCLES[target].signal(FORCED_STEPS, amplitude))
    return arm


class ClosedLoop:
    """An arm whose base follows the outputs of a readout, until something goes wrong.

    What goes wrong is not raised but noted, as a result like any other: `failure` then holds
    ``reason``, ``message``, ``step`` (steps of the loop made until then), ``time`` (of the arm,
    since its reset [s]), and what the reason adds. Reasons are

    - ``"domain"``: the arm left its domain; ``limit``, ``compartment``, ``value``, ``low`` and
      ``high`` as in `octoarm_env.DomainError`;
    - ``"jump"``: an output changed by more than `jump` in a step; ``value`` [degrees]. Steps under
      a perturbation are exempt: noise on the commands makes the outputs jump by itself;
    - ``"rest"``: the outputs stayed below `rest` times the amplitude for `WINDOW_STEPS`.

    Args:
        arm: moved by the loop; should be on its way along the cycle, see `release`.
        weights: (springs, 2), or (springs + 1, 2) with the bias last [degrees/m].
        amplitude: R of the target [degrees].
        jump: largest change of an output in a step [degrees]; None: any.
        rest: part of the amplitude below which an arm is at rest; None: it may come to rest.
        advance: called with the number of physics steps just made.

    Attributes:
        outputs: (T, 2), the readout's outputs so far, without perturbation [degrees].
        failure: what ended the loop, None if nothing did.

    Raises:
        ValueError: weights of another shape, limits that are not positive.
    """

    def __init__(
        self,
        arm: Arm,
        weights: Float,
        amplitude: float,
        *,
        jump: float | None = JUMP,
        rest: float | None = REST,
        advance: Callable[[int], None] | None = None,
    ) -> None:
        springs = len(arm.lengths)
        if weights.shape not in ((springs, 2), (springs + 1, 2)):
            raise ValueError(
                f"weights has shape {weights.shape}, expected ({springs}, 2) or ({springs + 1}, 2)"
            )
        for name, value in (("amplitude", amplitude), ("jump", jump), ("rest", rest)):
            if value is not None and not value > 0:
                raise ValueError(f"{name} = {value}: expected a positive number")
        self.arm = arm
        self.weights = weights
        self.failure: dict[str, Any] | None = None
        self._jump = math.inf if jump is None else jump
        self._quiet = None if rest is None else rest * amplitude
        self._advance = advance or (lambda steps: None)
        self._chunks: list[Float] = []
        self._start = arm.state.steps
        self._steps = 0
        self._last_loud = 0
        """Steps made when an output was last above `_quiet`."""
        self._previous: Float | None = None
        """The last output, where the next one may be compared with it."""

    @property
    def outputs(self) -> Float:
        """The readout's outputs so far, (T, 2) [degrees]."""
        if len(self._chunks) != 1:
            self._chunks = [np.concatenate((np.empty((0, 2)), *self._chunks))]
        return self._chunks[0]

    def run(self, steps: int, perturbation: Float | None = None) -> Float:
        """Go on for `steps` physics steps, or to the failure; after a failure nothing moves.

        Args:
            steps: how many.
            perturbation: (steps, 2), added to the outputs on their way to the base [degrees].

        Returns:
            The outputs of the steps made, (at most steps, 2) [degrees].
        """
        return self._run(steps, perturbation, None)

    def record(self, steps: int) -> tuple[Float, Float]:
        """Go on as `run` does, and keep the lengths too.

        Returns:
            Outputs [degrees] and lengths after each step [m] of the steps made, (T, 2) and
            (T, springs).
        """
        kept: list[Float] = [np.empty((0, len(self.arm.lengths)))]
        outputs = self._run(steps, None, kept)
        return outputs, np.concatenate(kept)

    def _run(self, steps: int, perturbation: Float | None, kept: list[Float] | None) -> Float:
        steps = whole_number("steps", steps)
        before = len(self.outputs)
        for begin in range(0, steps, _CHUNK):
            if self.failure is not None:
                break
            count = min(_CHUNK, steps - begin)
            noise = None if perturbation is None else perturbation[begin : begin + count]
            outputs, lengths = self._move(count, noise)
            self._chunks.append(outputs)
            if kept is not None:
                kept.append(lengths)
            self._advance(len(outputs))
        return self.outputs[before:]

    def _move(self, count: int, noise: Float | None) -> tuple[Float, Float]:
        """One chunk; sets `failure` and cuts off what came after it."""
        ended = False
        try:
            outputs, lengths = self.arm.run_closed_loop(self.weights, count, noise)
        except DomainError as error:
            if error.outputs is None or error.lengths is None:
                raise
            outputs, lengths, ended = error.outputs, error.lengths, True
            self._fail(describe_domain_error(error), len(outputs))
        if noise is None:
            outputs = self._find_jump(outputs, ended)
            lengths = lengths[: len(outputs)]
        self._previous = outputs[-1] if noise is None and len(outputs) else None
        self._find_rest(outputs)
        self._steps += len(outputs)
        return outputs, lengths

    def _find_jump(self, outputs: Float, ended: bool) -> Float:
        """Outputs up to the first jump; that of the step which the arm refused counts too."""
        said = [] if self._previous is None else [self._previous[np.newaxis]]
        said.append(outputs)
        if ended:
            said.append(readout_outputs(self.arm.lengths, self.weights)[np.newaxis])
        changes = np.abs(np.diff(np.concatenate(said), axis=0)).max(axis=1, initial=0.0)
        jumps = np.flatnonzero(changes > self._jump)
        if len(jumps) == 0:
            return outputs
        made = int(jumps[0]) + 1 - (self._previous is not None)
        change = float(changes[jumps[0]])
        message = f"an output jumped by {change:.4g} degrees in a step, allowed {self._jump:g}"
        self._fail(
            {"reason": "jump", "message": message, "value": change, "high": self._jump}, made
        )
        return outputs[:made]

    def _find_rest(self, outputs: Float) -> None:
        if self._quiet is None or self.failure is not None:
            return
        loud = np.flatnonzero(np.abs(outputs).max(axis=1, initial=0.0) >= self._quiet)
        if len(loud):
            self._last_loud = self._steps + int(loud[-1]) + 1
        if self._steps + len(outputs) - self._last_loud >= WINDOW_STEPS:
            message = (
                f"the arm came to rest: its outputs stayed below {self._quiet:.4g} degrees"
                f" for {WINDOW_STEPS} steps"
            )
            self._fail({"reason": "rest", "message": message, "low": self._quiet}, len(outputs))

    def _fail(self, failure: dict[str, Any], made: int) -> None:
        """Note the failure `made` steps into the present chunk."""
        step = self._steps + made
        time = (self._start + step) * self.arm.parameters.timestep
        self.failure = {"step": step, "time": time} | failure


def describe_domain_error(error: DomainError) -> dict[str, Any]:
    """A domain error as plain numbers for a JSON file; None for what is not finite."""
    names = ("limit", "compartment", "value", "low", "high", "time")
    described = {"reason": "domain", "message": str(error)}
    return described | {name: _finite(getattr(error, name)) for name in names}


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def score_window(
    outputs: Float, orbit: Float, turn: float, distances: Float | None = None
) -> dict[str, Any]:
    """How well the outputs of some steps follow the target.

    Args:
        outputs: (T, 2), several turns [degrees].
        orbit: (K, 2), one turn of the target [degrees].
        turn: the target's period [steps].
        distances: (T,), those of the outputs to the orbit in units of R, if they are known.

    Returns:
        ``mean_distance`` and ``max_distance`` in units of R; ``period_ratio``, to that of the
        target, None if the outputs do not turn; ``amplitude_ratio``; and whether the cycle is
        ``held``, see `HELD_DISTANCE`.

    Raises:
        ValueError: no outputs.
    """
    if len(outputs) == 0:
        raise ValueError("outputs has no rows: expected at least 1")
    amplitude = float(np.abs(orbit).max())
    if distances is None:
        distances = orbit_distance(outputs, orbit) / amplitude
    # x2 crosses zero upward once a turn on all three cycles.
    period = turn_time(outputs[:, 1]) / turn
    mean, ratio = distances.mean(), float(np.abs(outputs).max()) / amplitude
    held = is_held(mean, period, distance_limit=HELD_DISTANCE, period_limit=HELD_PERIOD)
    return {
        "mean_distance": float(mean),
        "max_distance": float(distances.max()),
        "period_ratio": period if math.isfinite(period) else None,
        "amplitude_ratio": ratio,
        "held": bool(abs(ratio - 1) <= HELD_AMPLITUDE and held),
    }


def recovery_steps(distances: Float, before: float) -> int:
    """Steps until the distance stays below twice what it was before a burst, or below 1 % of R.

    Args:
        distances: (T,), since the burst's end, in units of R.
        before: the largest before the burst, in units of R.
    """
    return int(steps_to_return(distances, max(2 * before, 0.01)))
