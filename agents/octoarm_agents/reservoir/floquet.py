"""Does a closed loop come back? Floquet exponents about the orbit that the teacher forces.

The loop of Eqs. 24-26 can hold a cycle only if what pushes it off dies out. On the orbit that the
teacher forces, every small deviation x of the body's state (coordinates, rates, base) obeys a
linear equation with the orbit's period; its Floquet multipliers are the growth factors of x over a
turn, its Floquet exponents their logarithms divided by the period. One exponent, that of the phase,
is zero in a loop without a clock; all others must be negative.

The step of the body is linearised at points of the orbit (`octoarm_env.Arm.linearise`), once for
all readouts; a readout W closes the loop, and a deviation obeys

    x(t+1) = (A(t) + B(t) Wᵀ C(t)) x(t),

with the Jacobians A and B of a step by state and command, and C of the lengths by the state. The
exponents are the Lyapunov exponents of this map: a few deviations are propagated and
orthonormalised now and then (`octoarm_agents.reservoir.benettin`).
The loop's own stability is not needed: the body is forced by the teacher, only the deviations see
the readout. Deviations of 1e-8 of the state, carried through the arm itself for 3,000 steps, grow
at rates that differ by up to 0.1/s, mostly by less than 0.05/s.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from octoarm_agents.common.whole import whole_number
from octoarm_agents.reservoir.benettin import stretch_factors
from octoarm_env import LIMIT_CYCLES, Arm, ArmParameters, Linearisation

__all__ = ["TeacherRun", "floquet_exponents"]

Float = NDArray[np.float64]

_POINTS = 100
"""Points of a turn at which the step is linearised; between two of them it is taken as constant."""

_CHUNK = 5
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
        turn: steps of a turn of the target.
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
        self.turn = LIMIT_CYCLES[target].period / parameters.timestep
        self._maps: dict[int, tuple[Arm, list[Linearisation]]] = {}

    def arm_after(self, steps: int) -> Arm:
        """A new arm, forced by the teacher for the first `steps` steps."""
        arm = Arm(self.parameters, self.actuator)
        arm.run(self.signal[:steps])
        return arm

    def maps(self, begin: int, count: int) -> list[Linearisation]:
        """Linearise the step in the middle of the first of `_POINTS` equal parts of a turn.

        Args:
            begin: the step at which the turn begins.
            count: how many parts.

        Returns:
            The maps, with states in units of `_magnitudes`; they are kept for the next call.

        Raises:
            DomainError: the arm is at the edge of its domain.
        """
        if begin not in self._maps:
            self._maps[begin] = (self.arm_after(begin), [])
        # Taken away meanwhile: where it is interrupted, arm and maps would no longer fit together.
        arm, maps = self._maps.pop(begin)
        scale = _magnitudes(self.parameters)
        for point in range(len(maps), count):
            middle, before = (
                begin + int((part + 0.5) * self.turn / _POINTS) for part in (point, point - 1)
            )
            arm.run(self.signal[max(before, begin) : middle])
            step = arm.linearise(*self.signal[middle])
            maps.append(
                Linearisation(
                    state=step.state * (scale / scale[:, np.newaxis]),
                    command=step.command / scale[:, np.newaxis],
                    lengths=step.lengths * scale,
                )
            )
        self._maps[begin] = arm, maps
        return maps[:count]

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
        ValueError: the run is too short, a count below 1, or a gain beyond all bounds.
        DomainError: the arm is at the edge of its domain.
    """
    count, steps = whole_number("count", count, 1), whole_number("steps", steps, 1)
    skip, begin = whole_number("skip", skip), whole_number("begin", begin)
    end = begin + skip + steps
    if end > len(run.lengths):
        raise ValueError(
            f"the teacher's run has {len(run.lengths)} steps, "
            f"begin + skip + steps = {end} are needed"
        )
    springs = run.lengths.shape[1]
    gains = weights[:springs].T
    with np.errstate(over="ignore", invalid="ignore"):
        maps = run.maps(begin, min(math.ceil((skip + steps) / run.turn * _POINTS), _POINTS))
        loop = [step.state + step.command @ (gains @ step.lengths) for step in maps]
        random = np.random.default_rng(seed)
        directions = np.linalg.qr(random.normal(size=(len(loop[0]), count)))[0]

        def carry(deviations: Float, time: int) -> Float:
            # Rounding may carry the end of a turn to the next part.
            part = min(int(time % run.turn * _POINTS / run.turn), len(loop) - 1)
            carried: Float = loop[part] @ deviations
            if not np.isfinite(carried).all():
                raise ValueError("the gain of the loop is beyond all bounds")
            return carried

        factors = stretch_factors(carry, directions, steps, transient=skip, every=_CHUNK)
        sums = np.log(factors).sum(axis=0)
    exponents: Float = np.sort(sums / (steps * run.parameters.timestep))[::-1]
    return exponents


def _magnitudes(parameters: ArmParameters) -> Float:
    """Natural size of each number of the state, so that deviations of all kinds compare."""
    joint = np.array([parameters.rest_length, 1.0, 1.0, *[parameters.base_radius] * 4])
    coordinates = np.tile(joint, parameters.compartments)
    rate = 15.0  # 1/s, about one turn of the cycles
    return np.concatenate((coordinates, rate * coordinates, [0.5, 0.5, 8.0, 8.0]))
