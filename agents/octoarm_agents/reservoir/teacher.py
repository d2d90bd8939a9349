"""The body while a teacher forces it along a limit cycle (section 2.2.2), and its linearisation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from octoarm_agents.reservoir.readout import readout_outputs
from octoarm_env import LIMIT_CYCLES, Arm, ArmParameters, Linearisation
from octoarm_env.arrays import Float

POINTS = 100
"""Points of a turn at which the step is linearised; between two of them it is taken as constant."""


@dataclass(eq=False, repr=False)
class TeacherRun:
    """An arm from rest that the teacher forces along a limit cycle, and what its springs say.

    Attributes:
        parameters: the body.
        target: name of the limit cycle.
        amplitude: R, the largest angle of the target [degrees].
        actuator: ``"direct"`` or ``"servo"``.
        steps: for which the arm is forced.
        signal: (steps + 1, 2), the commands; row t+1 is what a readout must give for the lengths of
            row t [degrees].
        lengths: (steps, springs), after each step [m].
        turn: steps of a turn of the target.

    Raises:
        DomainError: the arm cannot follow the teacher.
    """

    parameters: ArmParameters
    target: str
    amplitude: float
    actuator: Literal["direct", "servo"]
    steps: int

    def __post_init__(self) -> None:
        cycle = LIMIT_CYCLES[self.target]
        self.signal = cycle.signal(self.steps + 1, self.amplitude)
        self.lengths = Arm(self.parameters, self.actuator).run(self.signal[:-1])
        self.turn = cycle.period / self.parameters.timestep
        self._maps: dict[int, tuple[Arm, list[Linearisation]]] = {}

    def arm_after(self, steps: int) -> Arm:
        """A new arm, forced by the teacher for the first `steps` steps."""
        arm = Arm(self.parameters, self.actuator)
        arm.run(self.signal[:steps])
        return arm

    def maps(self, begin: int, count: int) -> list[Linearisation]:
        """Linearise the step in the middle of the first of `POINTS` equal parts of a turn.

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
                begin + int((part + 0.5) * self.turn / POINTS) for part in (point, point - 1)
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
        outputs = readout_outputs(self.lengths[begin - 1 : end - 1], weights)
        offsets: Float = self.signal[begin:end] - outputs
        return offsets


def _magnitudes(parameters: ArmParameters) -> Float:
    """Natural size of each number of the state, so that deviations of all kinds compare."""
    joint = np.array([parameters.rest_length, 1.0, 1.0, *[parameters.base_radius] * 4])
    coordinates = np.tile(joint, parameters.compartments)
    rate = 15.0  # 1/s, about one turn of the cycles
    return np.concatenate((coordinates, rate * coordinates, [0.5, 0.5, 8.0, 8.0]))
