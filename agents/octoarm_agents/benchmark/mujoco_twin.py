"""A MuJoCo twin of the octopus arm: the same chain of bodies in an independent engine.

The twin verifies the native kernel (spring lengths, step by step) and is its peer in the speed
benchmark. It holds the mechanics alone: longitudinal and transverse springs with stiffness and
damping (Eqs. 1-4), joint masses, massless struts and planes, a turning base. Gravity, water
(Eqs. 9-15) and the volume forces (Eqs. 7-8) are off, so compare it with an arm whose densities are
equal, whose drag and lift coefficients are zero and whose volume gains are zero.

Mapping of the arm onto MuJoCo, for compartment j = 1..N:

====================== ==========================================================================
arm                    MuJoCo
====================== ==========================================================================
strut height h         slide joint of body ``plane_j`` along z of ``plane_{j-1}``
universal joint α, β   two hinges of ``plane_j``, x then y, so R_j = R_{j-1} Rx(α) Ry(β)
radius r_i             slide joint of body ``joint_j_i`` along +x, +y, -x, -y of ``plane_j``
mass of joint B_ij     point mass ``longitudinal_mass + transverse_mass`` of body ``joint_j_i``;
                       of parameters with a number for each compartment, those of compartment j
transverse spring      stiffness and damping of that slide joint
longitudinal spring    spatial tendon ``spring_j_i`` from joint i of plane j-1 to joint i of plane j
base rotation θ, φ     two hinges of ``plane_0``, x then y, so R_0 = Rx(θ) Ry(φ), with an armature
                       (rotor inertia) so large that the arm cannot disturb them
====================== ==========================================================================

MuJoCo's compiler asks every moving body for some mass and inertia. The model is compiled with
stand-ins, which are then replaced by the true values, zeros included: the mass matrix stays
regular, because every coordinate moves a joint mass. With inertias of 1e-12 kg m² left on the
bodies, the lengths would be off by 3e-9 m; as it is, the twin agrees with a dense reference to
rounding (within 2e-15 m over 300 steps of 1 ms).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from octoarm_env import ArmParameters
    from octoarm_env.arrays import Float


_DIRECTIONS = ((1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0))
"""Unit vectors of the springs i = 1..4 in the frame of their plane."""

_COMPILER_MASS = 1e-9
"""Mass (kg) and inertia (kg m²) that satisfy MuJoCo's compiler; the real ones replace them."""

_BASE_ARMATURE = 1e15
"""Rotor inertia of the base hinges, kg m².

The error of the spring lengths over 300 steps falls with it, from 1e-10 m at 1e3 to 1e-16 m at 1e9;
from 1e12 up the base keeps its course to the last bit. The mass matrix is factorised from the tip
to the base, hence the size does no harm to the conditioning of the arm's own coordinates.
"""


class MujocoTwin:
    """The arm without water, gravity and volume forces, stepped by MuJoCo (Runge-Kutta 4).

    It starts undeformed and at rest, with the base at θ = φ = 0.

    The base is free but for its huge armature, by which the arm's reaction torque (order 1 N m) is
    divided: it turns at the constant rates given to `set_state`.

    Args:
        parameters: the arm.

    Attributes:
        model: the `mujoco.MjModel` behind the twin.
        data: its `mujoco.MjData`.

    Raises:
        ImportError: MuJoCo is not installed.
        ValueError: a parameter leaves no arm to build.
    """

    def __init__(self, parameters: ArmParameters) -> None:
        try:
            import mujoco
        except ImportError as error:
            raise ImportError(
                'MujocoTwin needs MuJoCo: pip install "octoarm-agents[benchmark]"'
            ) from error
        self._mujoco: Any = mujoco
        self._parameters = parameters

        radii = _rest_radii(parameters)
        heights = _rest_heights(parameters, radii)
        self._rest = np.zeros((parameters.compartments, 7))
        self._rest[:, 0] = heights
        self._rest[:, 3:] = radii[1:, np.newaxis]

        xml = _build_xml(parameters, radii, heights)
        self.model: Any = self._mujoco.MjModel.from_xml_string(xml)
        self.data: Any = self._mujoco.MjData(self.model)
        self._set_masses()

    # ------------------------------------------------------------------ state

    def set_state(self, coordinates: ArrayLike, rates: ArrayLike, base: ArrayLike) -> None:
        """Put the arm into a state; the time becomes zero.

        Args:
            coordinates: shape (N, 7), each row h, α, β, r1, r2, r3, r4 in m and rad.
            rates: shape (N, 7), their time derivatives in m/s and rad/s.
            base: shape (4,), θ, φ in rad and their rates in rad/s; θ turns about x, φ about the
                y-axis that θ has turned.

        Raises:
            ValueError: a shape is wrong or a number is not finite.
        """
        shape = (self._parameters.compartments, 7)
        angles = _checked(base, "base", (4,))
        position = _checked(coordinates, "coordinates", shape) - self._rest
        velocity = _checked(rates, "rates", shape)
        self.data.time = 0.0
        self.data.qpos[:2] = angles[:2]
        self.data.qvel[:2] = angles[2:]
        self.data.qpos[2:] = position.ravel()
        self.data.qvel[2:] = velocity.ravel()

    @property
    def state(self) -> tuple[Float, Float, Float]:
        """Copies of coordinates (N, 7), rates (N, 7) and base (4,), as `set_state` takes them."""
        shape = (self._parameters.compartments, 7)
        return (
            self.data.qpos[2:].reshape(shape) + self._rest,
            self.data.qvel[2:].reshape(shape).copy(),
            np.concatenate((self.data.qpos[:2], self.data.qvel[:2])),
        )

    def set_muscles(self, longitudinal: ArrayLike, transverse: ArrayLike) -> None:
        """Let muscles push, as `octoarm_env.Arm.muscles` does; the energy knows nothing of it.

        A constant force is another rest length: K (l - l_0) - ξ = K (l - (l_0 + ξ / K)).

        Args:
            longitudinal: ξ_c, (N, 4) [N].
            transverse: δ_c, (N, 4) [N].

        Raises:
            ValueError: a shape is wrong or a number is not finite.
        """
        body, shape = self._parameters, (self._parameters.compartments, 4)
        along = _checked(longitudinal, "longitudinal", shape) / _rows(
            body, body.longitudinal_stiffness
        )
        across = _checked(transverse, "transverse", shape) / _rows(body, body.transverse_stiffness)
        self.model.tendon_lengthspring[:] = body.rest_length + along.ravel()[:, np.newaxis]
        self.model.qpos_spring[2:].reshape(-1, 7)[:, 3:] = across

    # ---------------------------------------------------------------- outputs

    @property
    def lengths(self) -> Float:
        """Lengths of the longitudinal springs, shape (4N,), m; index 4(j-1) + (i-1)."""
        self._mujoco.mj_kinematics(self.model, self.data)
        return self._measure()

    @property
    def positions(self) -> Float:
        """World positions of the plane centres c_0 .. c_N, shape (N+1, 3), m."""
        self._mujoco.mj_kinematics(self.model, self.data)
        positions: Float = self.data.xpos[self._planes].copy()
        return positions

    def energy(self) -> tuple[float, float]:
        """Kinetic and elastic energy of the arm, J.

        Kinetic: the arm's masses, in the inertial frame; the base's armature does not count.
        Elastic: the longitudinal and transverse springs.
        """
        self._mujoco.mj_kinematics(self.model, self.data)
        self._mujoco.mj_comPos(self.model, self.data)
        self._mujoco.mj_comVel(self.model, self.data)
        # cvel: angular and linear velocity, the latter at the mass centre of the whole chain.
        angular, linear = np.split(self.data.cvel, 2, axis=1)
        centre = self.data.subtree_com[self.model.body_rootid]
        velocity = linear + np.cross(angular, self.data.xipos - centre)
        axes = self.data.ximat.reshape(-1, 3, 3)
        spin = np.einsum("bij,bi->bj", axes, angular)
        kinetic = 0.5 * np.sum(self.model.body_mass[:, np.newaxis] * velocity**2)
        kinetic += 0.5 * np.sum(self.model.body_inertia * spin**2)
        body = self._parameters
        strain = self._measure().reshape(-1, 4) - body.rest_length
        radial = self.data.qpos[2:].reshape(-1, 7)[:, 3:]
        elastic = 0.5 * np.sum(_rows(body, body.longitudinal_stiffness) * strain**2)
        elastic += 0.5 * np.sum(_rows(body, body.transverse_stiffness) * radial**2)
        return float(kinetic), float(elastic)

    # --------------------------------------------------------------- stepping

    def step(self, n: int = 1) -> None:
        """Advance by `n` time steps.

        Raises:
            FloatingPointError: the state is no longer finite.
        """
        if n < 1:
            raise ValueError(f"n must be at least 1, got {n}")
        self._mujoco.mj_step(self.model, self.data, n)
        self._check_finite()

    def run(self, steps: int) -> Float:
        """Advance by `steps` time steps and record the spring lengths after each.

        Returns:
            Shape (steps, 4N), m, in the order of `lengths`.

        Raises:
            FloatingPointError: the state is no longer finite.
        """
        history = np.empty((steps, 4 * self._parameters.compartments))
        for row in history:
            self._mujoco.mj_step(self.model, self.data)
            self._mujoco.mj_kinematics(self.model, self.data)
            row[:] = self._measure()
        self._check_finite()
        return history

    # ---------------------------------------------------------------- private

    def _set_masses(self) -> None:
        """Replace the stand-ins: point masses at the joints, the planes as given, else nothing."""
        parameters = self._parameters
        count = parameters.compartments
        bodies = {self.model.body(index).name: index for index in range(self.model.nbody)}
        self._planes = [bodies[f"plane_{j}"] for j in range(count + 1)]
        joints = [bodies[f"joint_{j}_{i}"] for j in range(1, count + 1) for i in range(1, 5)]
        mass, inertia = self.model.body_mass, self.model.body_inertia
        mass[:] = 0.0
        inertia[:] = 0.0
        joint_mass = np.add(parameters.longitudinal_mass, parameters.transverse_mass)
        mass[joints] = np.broadcast_to(_rows(parameters, joint_mass), (count, 4)).ravel()
        mass[self._planes[1:]] = parameters.plane_mass
        inertia[self._planes[1:]] = _rows(parameters, parameters.plane_inertia) * (1.0, 1.0, 2.0)
        self._mujoco.mj_setConst(self.model, self.data)
        self._mujoco.mj_resetData(self.model, self.data)

    def _measure(self) -> Float:
        """Spring lengths, (4N,) m, from site positions that `mj_kinematics` has just renewed.

        The sites come in the order of the joints, four a plane from the base on. `ten_length` holds
        the same numbers, but only after `mj_tendon`, which computes the Jacobians too.
        """
        points = self.data.site_xpos
        springs = points[4:] - points[:-4]
        lengths: Float = np.sqrt(np.einsum("sk,sk->s", springs, springs))
        return lengths

    def _check_finite(self) -> None:
        if not (np.isfinite(self.data.qpos).all() and np.isfinite(self.data.qvel).all()):
            raise FloatingPointError(f"the twin diverged before t = {self.data.time:.4f} s")


def _checked(values: ArrayLike, name: str, shape: tuple[int, ...]) -> Float:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite")
    return array


def _rows(parameters: ArmParameters, value: ArrayLike) -> Float:
    """A parameter of every compartment, shape (N, 1)."""
    return np.broadcast_to(np.asarray(value, np.float64), parameters.compartments)[:, np.newaxis]


def _rest_radii(parameters: ArmParameters) -> Float:
    """Rest radii of planes 0..N, shape (N+1,), m: a linear taper."""
    fraction = np.arange(parameters.compartments + 1) / parameters.compartments
    return parameters.base_radius + (parameters.tip_radius - parameters.base_radius) * fraction


def _rest_heights(parameters: ArmParameters, radii: Float) -> Float:
    """Rest heights of the struts, shape (N,), m: those of unstretched longitudinal springs."""
    squares = parameters.rest_length**2 - np.diff(radii) ** 2
    if not (squares > 0).all():
        raise ValueError(
            f"rest_length {parameters.rest_length} m is too short for the taper from "
            f"{parameters.base_radius} m to {parameters.tip_radius} m"
        )
    heights: Float = np.sqrt(squares)
    return heights


def _numbers(*values: float) -> str:
    """The shortest decimal text that reads back as exactly the same numbers."""
    return " ".join(repr(float(value)) for value in values)


def _build_xml(parameters: ArmParameters, radii: Float, heights: Float) -> str:
    """The MJCF model; every joint coordinate is zero in the undeformed arm."""
    element = ElementTree.SubElement
    root = ElementTree.Element("mujoco", model="octopus arm")
    element(root, "compiler", angle="radian")
    timestep = _numbers(parameters.timestep)
    option = element(root, "option", timestep=timestep, integrator="RK4")
    # A diverged arm must be seen, not silently reset; the others but gravity only save time.
    flags = ("autoreset", "constraint", "contact", "gravity", "actuation", "sensor", "island")
    element(option, "flag", dict.fromkeys(flags, "disable"))

    plane = _add_body(element(root, "worldbody"), "plane_0", (0, 0, 0))
    for axis in ((1, 0, 0), (0, 1, 0)):
        armature = _numbers(_BASE_ARMATURE)
        element(plane, "joint", type="hinge", axis=_numbers(*axis), armature=armature)
    for i, axis in enumerate(_DIRECTIONS, 1):
        point = np.multiply(axis, radii[0])
        element(plane, "site", name=f"point_0_{i}", pos=_numbers(*point))

    longitudinal_stiffness, longitudinal_damping, transverse_stiffness, transverse_damping = (
        _rows(parameters, value).ravel()
        for value in (
            parameters.longitudinal_stiffness,
            parameters.longitudinal_damping,
            parameters.transverse_stiffness,
            parameters.transverse_damping,
        )
    )
    tendons = element(root, "tendon")
    for j, height in enumerate(heights, 1):
        plane = _add_body(plane, f"plane_{j}", (0, 0, height))
        element(plane, "joint", type="slide", axis=_numbers(0, 0, 1))
        element(plane, "joint", type="hinge", axis=_numbers(1, 0, 0))
        element(plane, "joint", type="hinge", axis=_numbers(0, 1, 0))
        for i, axis in enumerate(_DIRECTIONS, 1):
            slider = _add_body(plane, f"joint_{j}_{i}", np.multiply(axis, radii[j]))
            element(
                slider,
                "joint",
                type="slide",
                axis=_numbers(*axis),
                stiffness=_numbers(transverse_stiffness[j - 1]),
                damping=_numbers(transverse_damping[j - 1]),
            )
            element(slider, "site", name=f"point_{j}_{i}")
            tendon = element(
                tendons,
                "spatial",
                name=f"spring_{j}_{i}",
                stiffness=_numbers(longitudinal_stiffness[j - 1]),
                damping=_numbers(longitudinal_damping[j - 1]),
                springlength=_numbers(parameters.rest_length),
            )
            element(tendon, "site", site=f"point_{j - 1}_{i}")
            element(tendon, "site", site=f"point_{j}_{i}")
    return ElementTree.tostring(root, encoding="unicode")


def _add_body(parent: ElementTree.Element, name: str, position: ArrayLike) -> ElementTree.Element:
    """A body whose mass will be set after compilation; `position` in its parent's frame, m."""
    x, y, z = np.asarray(position, dtype=np.float64)
    body = ElementTree.SubElement(parent, "body", name=name, pos=_numbers(x, y, z))
    ElementTree.SubElement(
        body,
        "inertial",
        pos=_numbers(0, 0, 0),
        mass=_numbers(_COMPILER_MASS),
        diaginertia=_numbers(*[_COMPILER_MASS] * 3),
    )
    return body
