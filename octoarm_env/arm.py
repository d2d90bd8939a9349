"""The body by itself: step it, run it, close the loop around it."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from octoarm_env import _core
from octoarm_env.arguments import actuator_name, flag, whole_number
from octoarm_env.arrays import Float
from octoarm_env.parameters import ArmParameters, BodyLike


class Energy(NamedTuple):
    """Mechanical energy of an arm [J]."""

    kinetic: float
    elastic: float


class Linearisation(NamedTuple):
    """A step of an arm with N compartments, linearised about a state and a command.

    A state is a vector of 14 N + 4 numbers: the coordinates of an :class:`ArmState` row by row,
    their rates, and the base.
    """

    #: (14 N + 4, 14 N + 4), Jacobian of the next state with respect to the state.
    state: Float
    #: (14 N + 4, 2), Jacobian of the next state with respect to the command [per degree].
    command: Float
    #: (4 N, 14 N + 4), Jacobian of the spring lengths [m] before the step.
    lengths: Float


@dataclasses.dataclass(frozen=True, eq=False)
class ArmState:
    """The complete dynamic state of an arm with N compartments.

    Attributes:
        coordinates: (N, 7), ``[h, alpha, beta, r1, r2, r3, r4]`` of each compartment
            [m, rad, rad, m].
        rates: (N, 7), their time derivatives.
        base: (4,), ``[theta, phi, theta_dot, phi_dot]`` [rad, rad/s].
        steps: physics steps since the last reset.
        muscles: the muscle inputs (ξ_c, δ_c), each (N, 4) [N], as :attr:`Arm.muscles`; None: none.
    """

    coordinates: Float
    rates: Float
    base: Float
    steps: int = 0
    muscles: tuple[Float, Float] | None = None

    def __eq__(self, other: object) -> bool:
        """Compare to the bit."""
        if not isinstance(other, ArmState):
            return NotImplemented
        return self.steps == other.steps and all(
            np.array_equal(own, others)
            for own, others in zip(self._arrays(), other._arrays(), strict=True)
        )

    __hash__ = None  # type: ignore[assignment]

    def _arrays(self) -> tuple[Float, Float, Float, Float, Float]:
        none = np.zeros((len(self.coordinates), 4))
        muscles = (none, none) if self.muscles is None else pair("state.muscles", self.muscles)
        return self.coordinates, self.rates, self.base, *muscles


def core_state(name: str, state: Any) -> tuple[Float, Float, Float, int, tuple[Float, Float]]:
    """Give an `ArmState` as the compiled arm takes it; errors speak of `name`."""
    if not isinstance(state, ArmState):
        raise TypeError(f"{name} must be an ArmState, not {type(state).__name__}")
    coordinates, rates, base, longitudinal, transverse = state._arrays()
    steps = whole_number(f"{name}.steps", state.steps, 0, 2**64 - 1)
    return coordinates, rates, base, steps, (longitudinal, transverse)


def pair(name: str, inputs: Any) -> tuple[Any, Any]:
    """Take the muscle inputs (ξ_c, δ_c) apart."""
    try:
        longitudinal, transverse = inputs
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be a pair of arrays (xi_c, delta_c)") from None
    return longitudinal, transverse


_BEYOND = "theta or phi is beyond the allowed range [-3600, 3600]"
"""Of whole numbers beyond all doubles."""


class Arm:
    """A soft arm in water, driven by the rotation of its base (Nakajima et al. 2013, section 2.1).

    The arm starts in static equilibrium. Angles are degrees here, lengths metres. The lengths of
    the 4 N longitudinal springs are in the paper's order, ``s_11, s_21, s_31, s_41, s_12, …``:
    index ``4 (j - 1) + (i - 1)`` for spring i of compartment j.

    Args:
        parameters: the body: an :class:`octoarm_env.ArmParameters`, a name ("nakajima2013" or
            "inertial"), a mapping of parameters, or the path of a JSON file.
        actuator: ``"direct"``, the base moves linearly to the commanded angle within the physics
            step (the paper's position control), or ``"servo"``, through a critically damped
            second-order follower of natural frequency ``servo_frequency``.
        undeformed: start with every spring at its rest length, which any body can do, instead of in
            static equilibrium.

    Raises:
        ValueError: an unknown actuator or body, or a body without a static equilibrium.
        TypeError: parameters that describe no body.

    Every method that steps raises :class:`octoarm_env.DomainError` when a step would leave the
    domain of the model (a joint bent past 150 degrees, a strut or spring far out of shape); the arm
    then keeps the state before that step. Pickle and deepcopy are exact.
    """

    def __init__(
        self,
        parameters: BodyLike | None = None,
        actuator: Literal["direct", "servo"] = "direct",
        *,
        undeformed: bool = False,
    ) -> None:
        self._parameters = ArmParameters.of(parameters)
        self._actuator: Literal["direct", "servo"] = actuator
        self._core = _core.Arm(
            self._parameters.to_json(), actuator_name(actuator), flag("undeformed", undeformed)
        )

    @property
    def parameters(self) -> ArmParameters:
        """The body's parameters."""
        return self._parameters

    @property
    def actuator(self) -> Literal["direct", "servo"]:
        """How the base follows its command."""
        return self._actuator

    def reset(self, *, undeformed: bool = False) -> Float:
        """Put the arm at rest with its base at θ = φ = 0 and without muscle inputs.

        Args:
            undeformed: every spring at its rest length, instead of static equilibrium.

        Returns:
            The spring lengths, (4 N,) [m].
        """
        self._core.reset(flag("undeformed", undeformed))
        return self._core.lengths

    def step(self, theta: float, phi: float) -> Float:
        """Make one physics step under commanded base angles [degrees].

        Returns:
            The spring lengths after the step, (4 N,) [m].

        Raises:
            ValueError: an angle that is not finite or beyond ±3600 degrees.
            DomainError: see the class.
        """
        try:
            return self._core.step(theta, phi)
        except OverflowError:
            raise ValueError(_BEYOND) from None

    def run(self, angles: ArrayLike) -> Float:
        """Follow a sequence of commands, one a physics step.

        Args:
            angles: (T, 2), θ and φ [degrees].

        Returns:
            The spring lengths after each step, (T, 4 N) [m].

        Raises:
            ValueError, TypeError: a wrong shape or dtype, or numbers that are not finite.
            MemoryError: the lengths of so many steps do not fit into memory.
            KeyboardInterrupt: heard within a fraction of a second. No step is made then, nor after
                the errors above.
            DomainError: see the class; its ``lengths`` are those of the steps that were made.
        """
        return self._core.run(angles)

    def run_closed_loop(
        self, weights: ArrayLike, steps: int, perturbation: ArrayLike | None = None
    ) -> tuple[Float, Float]:
        """Feed a linear readout of the spring lengths back as the base command (Eqs. 24-26).

        Step t commands ``weights.T @ lengths(t) (+ bias) (+ perturbation[t])``, in degrees. Further
        outputs are muscle inputs in newton (Eqs. 1 and 4), which act during the step: ξ_c of all
        springs in the order of the lengths, and after them, where there are so many, δ_c.

        Args:
            weights: (4 N, 2), or (4 N + 1, 2) with the bias as the last row; with muscles 2 + 4 N
                or 2 + 8 N columns.
            steps: number of physics steps.
            perturbation: (steps, 2), added to the outputs for the base [degrees].

        Returns:
            ``(outputs, lengths)``: the readout's outputs before the perturbation, (steps, 2)
            [degrees], further columns [N], and the spring lengths after each step,
            (steps, 4 N) [m].

        Raises:
            ValueError, TypeError, MemoryError, KeyboardInterrupt: as :meth:`run`.
            DomainError: see the class; its ``outputs`` and ``lengths`` are those of the steps that
                were made.
        """
        steps = whole_number("steps", steps, 0, 2**63 - 1)
        return self._core.run_closed_loop(weights, steps, perturbation)

    def linearise(self, theta: float, phi: float) -> Linearisation:
        """Compute the Jacobians of one step from the present state; the arm does not move.

        They are central differences in the lanes of the vector registers, and take about as long as
        500 steps. What they make of a deviation is right to 1e-8 of its largest entry; where the
        water's flow past a strut turns over, its force jumps, and the derivative is that of one
        side.

        Args:
            theta: commanded base angle about y, in [-3600, 3600] [degrees].
            phi: commanded base angle about x, in [-3600, 3600] [degrees].

        Raises:
            ValueError: an angle out of range.
            DomainError: the step would leave the domain.
        """
        try:
            return Linearisation(*self._core.linearise(theta, phi))
        except OverflowError:
            raise ValueError(_BEYOND) from None

    @property
    def lengths(self) -> Float:
        """The spring lengths now, (4 N,) [m]."""
        return self._core.lengths

    @property
    def state(self) -> ArmState:
        """The complete state; assigning one restores it, and the steps that follow, to the bit."""
        return ArmState(*self._core.get_state())

    @state.setter
    def state(self, state: ArmState) -> None:
        self._core.set_state(core_state("state", state))

    @property
    def muscles(self) -> tuple[Float, Float]:
        """Muscle inputs (ξ_c, δ_c), each (N, 4) [N], of the longitudinal and transverse springs.

        They are zero after a reset and act until changed (Eqs. 1, 4, 7, 8; positive pushes).
        """
        return self._core.get_muscles()

    @muscles.setter
    def muscles(self, inputs: tuple[ArrayLike, ArrayLike]) -> None:
        self._core.set_muscles(*pair("muscles", inputs))

    def energy(self) -> Energy:
        """Kinetic energy of all masses (world frame) and elastic energy of all springs [J]."""
        return Energy(*self._core.energy())

    @property
    def positions(self) -> Float:
        """Centres of the planes in the world frame, base first, (N + 1, 3) [m]."""
        return self._core.positions

    @property
    def joints(self) -> Float:
        """Ends of the longitudinal springs in the world frame, base first, (N + 1, 4, 3) [m].

        Spring i of compartment j runs from ``joints[j - 1, i - 1]`` to ``joints[j, i - 1]``.
        """
        return self._core.joints

    @property
    def base_angles(self) -> Float:
        """Actual base angles θ, φ, (2,) [degrees]."""
        return self._core.base_angles

    @property
    def time(self) -> float:
        """Time since the last reset [s]."""
        return self._core.time

    def __getstate__(self) -> dict[str, Any]:
        return {
            "parameters": self._parameters,
            "actuator": self._actuator,
            "state": self.state,
        }

    def __setstate__(self, saved: dict[str, Any]) -> None:
        self.__init__(saved["parameters"], saved["actuator"], undeformed=True)  # type: ignore[misc]
        self.state = saved["state"]

    def __repr__(self) -> str:
        theta, phi = self.base_angles
        return (
            f"Arm({self._parameters.compartments} compartments, {self._actuator!r}, "
            f"t={self.time:.3f} s, base=({theta:.2f}, {phi:.2f})°)"
        )
