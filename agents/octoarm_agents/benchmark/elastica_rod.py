"""A soft rod of the arm's size in PyElastica: a peer of the arm in speed, not in physics.

PyElastica integrates Cosserat rods: a centreline with directors that stretches, shears, bends and
twists. The rod is as long, as thick, as dense and as stiff along its axis as the arm, of 20
elements where the arm has 20 compartments. One end is clamped, pointing sideways; the rod falls
from there under its weight in water and swings, its velocities decaying by an analytical linear
damper. There is no water that flows, no volume force and no moving base, so nothing here can be
compared with the arm's motion: what a benchmark may report is the simulated time per second of
computing, together with the time step and the number of elements.

The time step is the largest that a careful user would take. The position Verlet method is stable up
to 2 / ω for the highest frequency ω of the rod. That of elements turning against their neighbours
is ω² = 4 E / (ρ Δl²) + 4 α G / (ρ r²), by bending and by shear, which gives 2.41 ms for this rod
(Δl = 20 mm, G = E / 3, α = 27/28). Tried for 20 s of swinging, 2.30 ms holds and 2.35 ms diverges.
At the 1 ms taken here, which is the arm's own time step too, the tip stays within 0.5 mm of its
motion at 0.05 ms for 5 s. The rule of thumb of PyElastica's examples, 0.01 s/m · Δl, would be
0.2 ms: five times as much computing.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["ElasticaRod", "has_elastica"]

LENGTH = 0.4
"""m, of the arm at rest."""

RADIUS = 0.0108
"""m, the arm's mean over its taper."""

DENSITY = 1303.0
"""kg/m³, of the arm."""

YOUNGS_MODULUS = 4.28e4
"""Pa, so that E π r² equals 4 K_l l_0, the stiffness of the arm's four longitudinal springs."""

GRAVITY = 2.28
"""m/s², in water: 9.81 (1 - 1000 / 1303)."""

DAMPING = 1.0
"""1/s, the rate at which all velocities decay."""


class ElasticaRod:
    """A clamped rod that swings under its weight, stepped by PyElastica (position Verlet).

    It starts straight along x and at rest; weight pulls towards -z. What Numba compiles it compiles
    while the rod is made, which takes some twenty seconds the first time after an installation.

    Args:
        elements: number of elements, at least 2.
        timestep: s; see the module for what is stable.

    Raises:
        ImportError: PyElastica is not installed.
        ValueError: an argument is out of its range.
    """

    def __init__(self, elements: int = 20, timestep: float = 0.001) -> None:
        if elements < 2:
            raise ValueError(f"elements must be at least 2, got {elements}")
        if not (math.isfinite(timestep) and timestep > 0):
            raise ValueError(f"timestep must be a positive number of seconds, got {timestep}")
        self._elements = elements
        self._timestep = timestep
        elastica = _import_elastica()
        self._rod, self._system = _build(elastica, elements, timestep)
        self._stepper: Any = elastica.PositionVerlet()
        self._state = (
            self._rod.position_collection,
            self._rod.director_collection,
            self._rod.velocity_collection,
            self._rod.omega_collection,
        )
        self._start = [array.copy() for array in self._state]
        self._steps = 0
        self.step(1)  # compiles
        self.reset()

    @property
    def elements(self) -> int:
        """Number of elements."""
        return self._elements

    @property
    def timestep(self) -> float:
        """Time step of the position Verlet method, s."""
        return self._timestep

    @property
    def time(self) -> float:
        """Simulated time since the start or the last `reset`, s."""
        return self._steps * self._timestep

    @property
    def positions(self) -> NDArray[np.float64]:
        """Copies of the nodes' positions, the clamped one first, shape (elements + 1, 3), m."""
        positions: NDArray[np.float64] = self._rod.position_collection.T.copy()
        return positions

    def reset(self) -> None:
        """Put the rod back to its start, straight and at rest, at time zero."""
        for array, start in zip(self._state, self._start, strict=True):
            array[...] = start
        self._steps = 0

    def step(self, count: int = 1) -> None:
        """Advance by `count` time steps.

        Raises:
            ValueError: `count` is less than 1.
            FloatingPointError: the rod has diverged: a node is farther off than twice its length.
        """
        if count < 1:
            raise ValueError(f"count must be at least 1, got {count}")
        step, system, timestep = self._stepper.step, self._system, np.float64(self._timestep)
        time = np.float64(self.time)
        # A rod that diverges is reported below, once.
        with np.errstate(all="ignore"):
            for _ in range(count):
                time = step(system, time, timestep)
        self._steps += count
        # Not a test of finite numbers: the nodes of a diverged rod may fly apart for long.
        if not np.abs(self._rod.position_collection).max() < 2 * LENGTH:
            raise FloatingPointError(f"the rod diverged before t = {self.time:.4f} s")


def has_elastica() -> bool:
    """Whether PyElastica is installed."""
    return importlib.util.find_spec("elastica") is not None


def _import_elastica() -> Any:
    try:
        return importlib.import_module("elastica")
    except ImportError as error:
        raise ImportError(
            'ElasticaRod needs PyElastica: pip install "octoarm-agents[benchmark]"'
        ) from error


def _build(elastica: Any, elements: int, timestep: float) -> tuple[Any, Any]:
    """The rod, and the system that PyElastica steps with it."""
    rod = elastica.CosseratRod.straight_rod(
        elements,
        start=np.zeros(3),
        direction=np.array([1.0, 0.0, 0.0]),
        normal=np.array([0.0, 1.0, 0.0]),
        base_length=LENGTH,
        base_radius=RADIUS,
        density=DENSITY,
        youngs_modulus=YOUNGS_MODULUS,
    )
    parts = (
        elastica.BaseSystemCollection,
        elastica.Constraints,
        elastica.Forcing,
        elastica.Damping,
    )
    system: Any = type("RodSystem", parts, {})()
    system.append(rod)
    system.constrain(rod).using(
        elastica.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,)
    )
    system.add_forcing_to(rod).using(
        elastica.GravityForces, acc_gravity=np.array([0.0, 0.0, -GRAVITY])
    )
    system.dampen(rod).using(
        elastica.AnalyticalLinearDamper, uniform_damping_constant=DAMPING, time_step=timestep
    )
    system.finalize()
    return rod, system
