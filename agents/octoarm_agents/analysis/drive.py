"""An independent random input that a base can follow, and the arm's states under it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from octoarm_agents.analysis.states import Recording
from octoarm_env import Arm, ArmParameters, ArmState
from octoarm_env.arrays import Float

_CHUNK = 200
"""Input values run at a time; bounds the memory for the lengths of every physics step."""


@dataclass(frozen=True)
class Drive:
    """How input values turn the base.

    Each value lasts one hold. Within it the base moves from the last value's angle to this value's
    on a minimum-jerk path (Flash and Hogan 1985): a jump would be an endless acceleration.

    Attributes:
        amplitude: R, the angle of an input of 1 [degrees].
        hold: time of one input value [s], rounded to physics steps, at least 2 of them.
        axes: "both" turns θ and φ by the same angle (Eq. 16), "theta" leaves φ at 0.
        actuator: how the base follows its command, see `octoarm_env.Arm`.
    """

    # Measured with holds of 50 ms over 100 s: a body of `area_scale` 1 and `arm_density` 1303 stood
    # 30 degrees and not 45; four others, with more drag, more mass or less density, stood 20.
    amplitude: float = 20.0
    hold: float = 0.05
    axes: Literal["both", "theta"] = "both"
    actuator: Literal["direct", "servo"] = "direct"

    def __post_init__(self) -> None:
        if not 0 < self.amplitude <= 360:
            raise ValueError(f"amplitude = {self.amplitude}: expected 0 to 360 degrees, not 0")
        if not 0 < self.hold <= 10:
            raise ValueError(f"hold = {self.hold}: expected 0 to 10 s, not 0")
        if self.axes not in ("both", "theta"):
            raise ValueError(f"axes = {self.axes!r}: expected 'both' or 'theta'")

    def hold_steps(self, timestep: float) -> int:
        """Physics steps of one hold.

        Raises:
            ValueError: a hold of fewer than 2 steps.
        """
        steps = round(self.hold / timestep)
        if steps < 2:
            raise ValueError(
                f"hold = {self.hold}: expected at least two physics steps of {timestep} s"
            )
        return steps

    def angles(self, values: Float, before: float, timestep: float) -> Float:
        """Base angles (len(values) · hold steps, 2) [degrees]; `before` is the value before."""
        steps = self.hold_steps(timestep)
        time = np.arange(1, steps + 1) / steps
        rise = time**3 * (10 + time * (6 * time - 15))
        begins = np.concatenate(([before], values[:-1]))
        path = begins[:, np.newaxis] + (values - begins)[:, np.newaxis] * rise
        theta = self.amplitude * path.ravel()
        return np.stack((theta, theta if self.axes == "both" else np.zeros_like(theta)), axis=1)

    def to_dict(self, timestep: float) -> dict[str, Any]:
        """All as plain numbers for a JSON file; units in the keys."""
        return {
            "amplitude_degrees": self.amplitude,
            "hold_seconds": self.hold_steps(timestep) * timestep,
            "axes": self.axes,
            "actuator": self.actuator,
        }


class DrivenArm:
    """An arm whose time is counted in holds, and whose state is one vector.

    The vector has the coordinates and then the rates of all compartments, divided by `scales`. The
    base is not in it: it follows the input whatever the body does.

    Args:
        parameters: the body.
        drive: how values turn the base.
        scales: (2, compartments, 7), natural sizes of coordinates and rates; None for 1.

    Raises:
        ValueError: a body without a static equilibrium, or a hold too short.
    """

    def __init__(
        self, parameters: ArmParameters, drive: Drive, scales: Float | None = None
    ) -> None:
        self.arm = Arm(parameters, drive.actuator)
        self.drive = drive
        self.hold_steps = drive.hold_steps(parameters.timestep)
        self.interval = self.hold_steps * parameters.timestep
        self.last = 0.0
        shape = (2, *self.arm.state.coordinates.shape)
        self.scales = np.ones(shape) if scales is None else scales

    @property
    def vector(self) -> Float:
        """The body's state, (2 · compartments · 7,)."""
        state = self.arm.state
        return (np.stack((state.coordinates, state.rates)) / self.scales).ravel()

    def place(self, vector: Float, base: Float, last: float) -> None:
        """Give the body the state `vector`, the base (4,) [rad, rad/s], and the value before."""
        coordinates, rates = vector.reshape(self.scales.shape) * self.scales
        self.arm.state = ArmState(coordinates, rates, base)
        self.last = last

    def run(self, values: Float) -> Float:
        """Follow input values (T,), one a hold, of size at most 1.

        Returns:
            The spring lengths at the end of each hold, (T, 4 N) [m].

        Raises:
            DomainError: the arm left the domain of the model.
        """
        lengths = []
        for begin in range(0, len(values), _CHUNK):
            chunk = values[begin : begin + _CHUNK]
            angles = self.drive.angles(chunk, self.last, self.arm.parameters.timestep)
            lengths.append(self.arm.run(angles)[self.hold_steps - 1 :: self.hold_steps].copy())
            self.last = float(chunk[-1])
        return np.concatenate(lengths)


def record_arm(parameters: ArmParameters, drive: Drive, values: Float) -> Recording:
    """Spring lengths [m] at the end of each hold, from static equilibrium on.

    Raises:
        DomainError: the arm left the domain of the model.
        ValueError: a body without a static equilibrium, or values that are all the same.
    """
    return Recording(DrivenArm(parameters, drive).run(values), values)


def state_scales(parameters: ArmParameters, drive: Drive, values: Float) -> Float:
    """Natural sizes (2, compartments, 7) of coordinates and rates under an input.

    Lengths, angles and the rates of each get one size for all compartments, the root mean square of
    their deviation from the mean: a component that symmetry keeps still has a size too.

    Raises:
        DomainError: the arm left the domain of the model.
    """
    driven = DrivenArm(parameters, drive)
    snapshots = []
    for value in values:
        driven.run(np.array([value]))
        snapshots.append(driven.vector.reshape(driven.scales.shape))
    deviations = np.array(snapshots) - np.mean(snapshots, axis=0)
    squares = np.mean(deviations**2, axis=(0, 2))
    scales = np.empty(driven.scales.shape)
    for kinds in ([0, 3, 4, 5, 6], [1, 2]):  # [h, r1 … r4] and [α, β]
        scales[:, :, kinds] = np.sqrt(squares[:, kinds].mean(axis=1))[:, np.newaxis, np.newaxis]
    return scales
