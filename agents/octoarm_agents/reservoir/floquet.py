"""Does a closed loop come back? Floquet exponents about the orbit that the teacher forces.

The loop of Eqs. 24-26 can hold a cycle only if what pushes it off dies out. On the orbit that the
teacher forces, every small deviation x of the body's state (coordinates, rates, base) obeys a
linear equation with the orbit's period; its Floquet multipliers are the growth factors of x over a
turn, its Floquet exponents their logarithms divided by the period. One exponent, that of the phase,
is zero in a loop without a clock; all others must be negative.

The exponents are computed as Lyapunov exponents of the linearised loop: a few deviations are
propagated by finite differences and orthonormalised now and then (Benettin, Galgani, Giorgilli and
Strelcyn 1980, Meccanica 15:9-20). Neither a whole number of steps a turn nor the loop's own
stability is needed: the nominal arm is forced by the teacher, only the deviations see the readout.
"""

from __future__ import annotations

import copy
import dataclasses
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from octoarm_agents.whole import whole_number
from octoarm_env import LIMIT_CYCLES, Arm, ArmParameters, DomainError

__all__ = ["TeacherRun", "floquet_exponents"]

Float = NDArray[np.float64]

_SIZE = 1e-8
"""Deviation of the finite differences, in units of `_magnitudes`: far above rounding, and so small
that it hardly ever takes a strut across the jumps of the water's lift, which would pass for growth
(with 1e-6 and a direct base they do)."""

_CHUNK = 25
"""Steps between two orthonormalisations."""


class TeacherRun:
    """An arm from rest that the teacher forces along a limit cycle, and what its springs say.

    Attributes:
        parameters: the body.
        target: name of the limit cycle.
        amplitude: R, the largest angle of the target [degrees].
        actuator: ``"direct"`` or ``"servo"``.
        signal: (steps + 1, 2), the commands; row t+1 is what a readout must give for the lengths of
            row t [degrees].
        lengths: (steps, springs), after each step [m].
    """

    def __init__(
        self,
        parameters: ArmParameters,
        target: str,
        amplitude: float,
        actuator: Literal["direct", "servo"],
        steps: int,
    ) -> None:
        """Force the arm for `steps` physics steps.

        Raises:
            ValueError: an unknown target or actuator, an amplitude that is not positive.
            DomainError: the arm cannot follow the teacher.
        """
        if target not in LIMIT_CYCLES:
            raise ValueError(f"target = {target!r}: expected one of {sorted(LIMIT_CYCLES)}")
        self.parameters = parameters
        self.target = target
        self.amplitude = amplitude
        self.actuator = actuator
        self.signal = LIMIT_CYCLES[target].signal(steps + 1, amplitude)
        self.lengths = Arm(parameters, actuator).run(self.signal[:-1])

    def arm_after(self, steps: int) -> Arm:
        """A new arm, forced by the teacher for the first `steps` steps."""
        arm = Arm(self.parameters, self.actuator)
        arm.run(self.signal[:steps])
        return arm

    def offsets(self, weights: Float, begin: int, end: int) -> Float:
        """What a loop must add to its outputs to follow the teacher from step `begin` to `end`.

        With it, the teacher's orbit is a trajectory of the loop, and the readout acts on deviations
        from that orbit only.

        Returns:
            (end - begin, 2) [degrees], a perturbation for `Arm.run_closed_loop`.
        """
        springs = self.lengths.shape[1]
        outputs = self.lengths[begin - 1 : end - 1] @ weights[:springs]
        if len(weights) > springs:
            outputs += weights[springs]
        offsets: Float = self.signal[begin:end] - outputs
        return offsets


def floquet_exponents(
    run: TeacherRun,
    weights: Float,
    *,
    count: int = 5,
    steps: int = 3_000,
    skip: int = 1_000,
    begin: int = 5_000,
    seed: int = 0,
) -> Float:
    """Compute the leading Floquet exponents of the closed loop, linearised about a teacher's orbit.

    Args:
        run: the orbit.
        weights: (springs, 2), or (springs + 1, 2) with the bias last [degrees/m].
        count: how many exponents, at least 1.
        steps: physics steps over which growth is averaged; several turns of the cycle.
        skip: physics steps before that, in which the deviations turn to the leading directions.
        begin: first step of the run that is used; by then the cycle must be settled.
        seed: of the first deviations.

    Returns:
        (count,), largest first [1/s]; the phase's, about zero, is among them.

    Raises:
        ValueError: the run is too short, or a count below 1.
    """
    count, steps = whole_number("count", count, 1), whole_number("steps", steps, 1)
    skip, begin = whole_number("skip", skip), whole_number("begin", begin)
    end = begin + skip + steps
    if end > len(run.lengths):
        raise ValueError(
            f"the teacher's run has {len(run.lengths)} steps, "
            f"begin + skip + steps = {end} are needed"
        )
    arm = run.arm_after(begin)
    probe = copy.deepcopy(arm)
    magnitudes = _magnitudes(run.parameters)
    random = np.random.default_rng(seed)
    directions = np.linalg.qr(random.normal(size=(len(magnitudes), count)))[0]
    sums = np.zeros(count)
    time = begin
    chunk = _CHUNK
    while time < end:
        chunk = min(chunk, end - time)
        try:
            images = _propagate(run, weights, arm, probe, directions, magnitudes, time, chunk)
        except DomainError:
            # A loop of huge gain: the deviation outgrows the domain unless it is rescaled sooner.
            if chunk == 1:
                raise
            chunk //= 2
            continue
        directions, triangle = np.linalg.qr(images)
        time += chunk
        if time > begin + skip:
            sums += np.log(np.abs(np.diag(triangle)))
            counted = time - (begin + skip)
        arm.run(run.signal[time - chunk : time])
    exponents: Float = np.sort(sums / (counted * run.parameters.timestep))[::-1]
    return exponents


def _propagate(
    run: TeacherRun,
    weights: Float,
    arm: Arm,
    probe: Arm,
    directions: Float,
    magnitudes: Float,
    time: int,
    chunk: int,
) -> Float:
    """Images of deviations (n, count) after `chunk` steps of the loop; the arm itself stays."""
    offsets = run.offsets(weights, time, time + chunk)
    nominal = _vector(arm)
    probe.state = arm.state
    probe.run(run.signal[time : time + chunk])
    after = _vector(probe)
    images = np.empty_like(directions)
    for column, direction in enumerate(directions.T):
        _assign(probe, arm, nominal + _SIZE * magnitudes * direction)
        probe.run_closed_loop(weights, chunk, offsets)
        images[:, column] = (_vector(probe) - after) / (_SIZE * magnitudes)
    return images


def _magnitudes(parameters: ArmParameters) -> Float:
    """Natural size of each number of the state, so that deviations of all kinds compare."""
    joint = np.array([parameters.rest_length, 1.0, 1.0, *[parameters.base_radius] * 4])
    coordinates = np.tile(joint, parameters.compartments)
    rate = 15.0  # 1/s, about one turn of the cycles
    return np.concatenate((coordinates, rate * coordinates, [0.5, 0.5, 8.0, 8.0]))


def _vector(arm: Arm) -> Float:
    """The state as one vector: coordinates, rates, base."""
    state = arm.state
    return np.concatenate((state.coordinates.ravel(), state.rates.ravel(), state.base))


def _assign(probe: Arm, arm: Arm, vector: Float) -> None:
    """Put `probe` into the state of `vector`, at the time of `arm`."""
    state = arm.state
    size = state.coordinates.size
    probe.state = dataclasses.replace(
        state,
        coordinates=vector[:size].reshape(state.coordinates.shape),
        rates=vector[size : 2 * size].reshape(state.rates.shape),
        base=vector[2 * size :],
    )
