"""How a readout is taught a limit cycle: teacher forcing, and a ridge weighted by the body itself.

The paper adds white noise to the recorded lengths, the same on every spring, and takes the
pseudo-inverse (section 2.2.2): a teaching that is `sampled`. On average that is a ridge on the
weights: it forbids large weights, whatever the springs do. But a body off its orbit does not move
its springs like that. The deviations that occur are those that a disturbed base causes, in some
directions many thousand times larger than in others, and a loop that answers to them wrongly pushes
itself off the orbit (see `octoarm_agents.reservoir.floquet`).

So besides the isotropic noise ν, a readout may be taught not to answer to deviations that the body
really has. The teacher is followed again with small disturbances of the base, one run for each of a
few time scales, and what changes in the lengths is penalised:

    |S W - T|² + M ν²/3 |W|² + M Σ_k κ_k² |F_k W|²,    F_kᵀF_k = <δs δsᵀ> for one degree at scale k,

the same as the teacher's rows with those deviations in them, at the size κ_k, and the undisturbed
target as their label. ν and the κ_k are few numbers that a search can find by looking at the loop
they give (`octoarm_agents.reservoir.tuning`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.signal import lfilter
from threadpoolctl import threadpool_limits

from octoarm_agents.common.whole import whole_fields
from octoarm_agents.reservoir.floquet import floquet_exponents
from octoarm_agents.reservoir.readout import Readout, noise_ridge
from octoarm_agents.reservoir.teacher import TeacherRun
from octoarm_env import LIMIT_CYCLES, ArmParameters, DomainError
from octoarm_env.arrays import Float

TIME_SCALES = (0, 3, 10, 30, 100, 300)
"""Correlation times of the base's disturbances [steps]; 0 is white noise."""

UNDISTURBED = (0.0,) * len(TIME_SCALES)
"""κ of the paper's training [degrees]: nothing but white noise on the lengths."""

_DISTURBANCE = 0.02
"""Root mean square of a disturbance while its effect is recorded [degrees]: so small that the
body's answer is linear."""

_WHITE = 0.2
"""White noise is recorded at this part of that size: it is an inertia load first of all."""

_TURNS = 8
"""Turns of the cycle over which the exponents of a taught readout are averaged."""

_RECORDED = 12_000
_BEGIN = 6_000
"""Physics steps of a recording, and its first step; by then cycle and body are settled."""


@dataclass(frozen=True)
class Teaching:
    """How a readout is taught.

    Attributes:
        target: name of the limit cycle.
        amplitude: R, the largest angle of the target [degrees].
        noise: ν, half width of the white noise on the lengths that the fit allows for [m].
        disturbances: κ, sizes of the base's disturbances at the `TIME_SCALES` whose effect on the
            body the readout shall not answer to [degrees]; all zero is the paper's training.
        actuator: how the base follows its command, ``"direct"`` or ``"servo"``.
        sampled: the paper's training: draw the noise, add it to the lengths and take the
            pseudo-inverse. Otherwise the noise stands for its expectation, a ridge.
        steps: physics steps of teacher forcing.
        washout: of them, how many are not used at the begin.
        seed: of the disturbances, or of the noise that is drawn.
    """

    target: str
    amplitude: float
    noise: float
    disturbances: tuple[float, ...] = UNDISTURBED
    actuator: Literal["direct", "servo"] = "direct"
    sampled: bool = False
    steps: int = 70_000
    washout: int = 10_000
    seed: int = 0

    def __post_init__(self) -> None:
        if self.target not in LIMIT_CYCLES:
            raise ValueError(f"target = {self.target!r}: expected one of {sorted(LIMIT_CYCLES)}")
        if self.actuator not in ("direct", "servo"):
            raise ValueError(f"actuator = {self.actuator!r}: expected 'direct' or 'servo'")
        if not (self.amplitude > 0 and math.isfinite(self.amplitude)):
            raise ValueError(f"amplitude = {self.amplitude}: expected a positive number of degrees")
        if not (self.noise >= 0 and math.isfinite(self.noise)):
            raise ValueError(f"noise = {self.noise}: expected a number of metres, not negative")
        if len(self.disturbances) != len(TIME_SCALES) or not all(
            size >= 0 and math.isfinite(size) for size in self.disturbances
        ):
            raise ValueError(
                f"disturbances = {self.disturbances}: expected {len(TIME_SCALES)} numbers of "
                "degrees, not negative"
            )
        if self.sampled and any(self.disturbances):
            raise ValueError(
                f"disturbances = {self.disturbances}: expected zeros where the noise is sampled"
            )
        whole_fields(self, washout=0, seed=0)
        whole_fields(self, steps=max(self.washout + 1_000, _BEGIN + _RECORDED))


@dataclass(frozen=True)
class Taught:
    """A taught readout.

    Attributes:
        teaching: how.
        readout: fitted; its `weights_` close the loop.
        exponents: leading Floquet exponents of its loop on the teacher's orbit, largest first
            [1/s]; empty if the loop's gain throws the body out of its domain within a step.
    """

    teaching: Teaching
    readout: Readout
    exponents: Float


def teach(parameters: ArmParameters, teaching: Teaching) -> Taught:
    """Teach a readout to continue a limit cycle.

    Raises:
        ValueError: a target, actuator or size that cannot be.
        DomainError: the arm cannot follow the teacher.
    """
    # Sums split over threads are rounded otherwise.
    with threadpool_limits(1):
        return ReadoutTrainer(parameters, teaching).teach(teaching)


class ReadoutTrainer:
    """A body that has followed a teacher, from which readouts are fitted at once.

    Attributes:
        run: what the teacher forced, and what the springs said.
    """

    def __init__(self, parameters: ArmParameters, teaching: Teaching) -> None:
        """Let the body follow the teacher; `noise` and `disturbances` may differ in each fit.

        Raises:
            DomainError: the arm cannot follow the teacher.
        """
        self.run = TeacherRun(
            parameters, teaching.target, teaching.amplitude, teaching.actuator, teaching.steps
        )
        self._lengths = self.run.lengths[teaching.washout :]
        self._targets = self.run.signal[1 + teaching.washout :]
        springs = self._lengths.shape[1]
        # Least squares know the rows by their triangular factor only.
        factor = _triangle(np.hstack((self._lengths, self._targets)))
        self._rows = np.ascontiguousarray(factor[:springs, :springs])
        self._labels = np.ascontiguousarray(factor[:springs, springs:])
        self._left = float(np.linalg.norm(factor[springs:, springs:]))
        self._seed = teaching.seed
        self._responses: list[Float] | None = None

    def weights(self, noise: float, disturbances: Sequence[float]) -> tuple[Float, float]:
        """Fit quickly: weights (springs, 2) [degrees/m], and the training error [degrees]."""
        readout = Readout("ridge", ridge=noise_ridge(len(self._lengths), noise))
        readout.fit(self._rows, self._labels, penalty=self._penalty(disturbances))
        weights: Float = readout.weights_
        residual = np.linalg.norm(self._labels - self._rows @ weights)
        return weights, math.hypot(float(residual), self._left) / math.sqrt(len(self._lengths))

    def teach(self, teaching: Teaching) -> Taught:
        """The same fit from all rows, as an estimator whose errors refer to them."""
        readout = self.fit(teaching)
        steps = round(_TURNS * self.run.turn)
        return Taught(teaching, readout, self.exponents(readout.weights_, steps))

    def fit(self, teaching: Teaching) -> Readout:
        """The readout alone; `noise`, `disturbances`, `sampled` and `seed` may differ."""
        noise = teaching.noise
        if teaching.sampled:
            random = np.random.default_rng(teaching.seed)
            drawn = random.uniform(-noise, noise, self._lengths.shape)
            return Readout("pinv").fit(self._lengths + drawn, self._targets)
        # Without noise this is the pseudo-inverse.
        penalty = self._penalty(teaching.disturbances)
        return Readout("noise", noise=noise).fit(self._lengths, self._targets, penalty)

    def exponents(self, weights: Float, steps: int = 2_000) -> Float:
        """Leading Floquet exponents [1/s]; empty if the loop leaves the domain within a step.

        Over whole turns the phase's is zero; a quick look over fewer finds it within 0.5/s.
        """
        try:
            return floquet_exponents(self.run, weights, steps=steps)
        except (DomainError, ValueError):
            return np.empty(0)

    def _penalty(self, disturbances: Sequence[float]) -> Float | None:
        """Rows of deviations of the sizes asked for, as many in effect as the teacher's rows."""
        if not any(disturbances):
            return None
        if self._responses is None:
            random = np.random.default_rng(self._seed)
            self._responses = [_response(self.run, scale, random) for scale in TIME_SCALES]
        size = math.sqrt(len(self._lengths))
        pairs = zip(disturbances, self._responses, strict=True)
        return np.concatenate([size * kappa * response for kappa, response in pairs])


def _response(run: TeacherRun, scale: int, random: np.random.Generator) -> Float:
    """Triangle F (springs, springs) with FᵀF = <δs δsᵀ> [m²] for disturbances of one degree."""
    size = _DISTURBANCE * (1.0 if scale else _WHITE)
    noise = size * _disturbance(_RECORDED, scale, random)
    recorded = slice(_BEGIN, _BEGIN + _RECORDED)
    disturbed = run.arm_after(_BEGIN).run(run.signal[recorded] + noise)
    deviations = disturbed - run.lengths[recorded]
    return _triangle(deviations / (size * math.sqrt(_RECORDED)))


def _disturbance(steps: int, scale: int, random: np.random.Generator) -> Float:
    """Noise (steps, 2) of root mean square 1, twice low-pass filtered at a time scale."""
    noise = random.normal(size=(steps, 2))
    if scale:
        decay = math.exp(-1 / scale)
        for _ in range(2):
            noise = lfilter([1 - decay], [1, -decay], noise, axis=0)
    return np.asarray(noise / noise.std(), dtype=np.float64)


def _triangle(rows: Float) -> Float:
    """Triangular factor F of `rows` (K, springs): FᵀF = rowsᵀ rows."""
    return np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)
