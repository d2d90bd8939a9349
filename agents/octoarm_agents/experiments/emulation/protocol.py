"""The protocol of Task 1 that its table and figures share (section 2.2.1).

A trial sets the arm at rest, drives it for T_ini timesteps, then for 1000 of washout, 10,000 of
training and 5000 of test, all with the same input. T_ini is drawn uniformly from 0 to 1000. A row t
of features may use what is known at t, and is to give y(t + 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from octoarm_agents.common.lanes import Recording, record_arms
from octoarm_agents.experiments.runner import RefusedError
from octoarm_agents.reservoir.emulation import SYSTEMS, emulation_targets
from octoarm_agents.reservoir.inputs import (
    PEAK,
    TIMESTEP,
    base_angles,
    product_of_sines,
    smooth_noise,
)
from octoarm_agents.reservoir.readout import Readout
from octoarm_env import Arm, ArmParameters
from octoarm_env.arrays import Float

Scores = dict[str, dict[str, float]]

INITIAL_STEPS = 1_000
WASHOUT_STEPS = 1_000
TRAINING_STEPS = 10_000
TEST_STEPS = 5_000
TRIALS = 20
RANGE = 60.0
"""Section 2.2.1; R [degrees] is that of Table 2 and of Figures 4, 5B and 5C."""

HOLD_STEPS = 50
"""Timesteps between the independent values of the input ``iid``."""

INPUTS = ("sines", "iid")
"""Eq. 17, and `smooth_noise`."""

TASKS = tuple(SYSTEMS)

TASK_HEADINGS = ("2nd order", "10th order", "Volterra")
"""Columns of the printed tables, in the order of `TASKS`."""

PAPER: dict[str, dict[str, tuple[float, float]]] = {
    "second_order": {"arm": (1.84e-7, 0.05e-7), "linear_regressor": (1.01e-6, 0.03e-6)},
    "tenth_order": {"arm": (3.77e-6, 0.03e-6), "linear_regressor": (5.05e-4, 0.11e-4)},
    "volterra": {"arm": (8.89e-5, 0.18e-5), "linear_regressor": (9.28e-4, 0.11e-4)},
}
"""Table 2: mean and standard deviation of the mean squared error over 20 trials."""

_REST = WASHOUT_STEPS + TRAINING_STEPS + TEST_STEPS


@dataclass(frozen=True, eq=False)
class TrialInput:
    """One trial's input, and what is to be computed from it. No arm is needed for it.

    Attributes:
        signal: In, (T_ini + 16,000,).
        targets: (T_ini + 16,000, 3), y(t + 1) of each of `TASKS`.
        initial: T_ini.
        peak: max|In| over the longest trial there can be, so that Scale is the same in all.
    """

    signal: Float
    targets: Float
    initial: int
    peak: float

    @classmethod
    def make(cls, kind: str, seed: int, trial: int) -> TrialInput:
        """Draw T_ini, and the input too if it is the random one, from (seed, trial).

        Args:
            kind: one of `INPUTS`.
            seed: of the experiment.
            trial: number of the trial.

        Raises:
            ValueError: an unknown kind.
        """
        random = np.random.default_rng([seed, trial])
        initial = int(random.integers(0, INITIAL_STEPS, endpoint=True))
        if kind == "sines":
            return cls.of_sines(initial)
        if kind == "iid":
            signal = smooth_noise(initial + _REST, random, hold=HOLD_STEPS)
            return cls(signal, emulation_targets(signal), initial, PEAK)
        raise ValueError(f"kind = {kind!r}: expected one of {list(INPUTS)}")

    @classmethod
    def of_sines(cls, initial: int) -> TrialInput:
        """Task 1 with a given T_ini, 0 to `INITIAL_STEPS`."""
        longest = product_of_sines(INITIAL_STEPS + _REST)
        signal = longest[: initial + _REST]
        return cls(signal, emulation_targets(signal), initial, float(np.abs(longest).max()))

    @property
    def training(self) -> slice:
        """Rows of the training phase."""
        begin = self.initial + WASHOUT_STEPS
        return slice(begin, begin + TRAINING_STEPS)

    @property
    def test(self) -> slice:
        """Rows of the evaluation phase."""
        begin = self.initial + WASHOUT_STEPS + TRAINING_STEPS
        return slice(begin, begin + TEST_STEPS)


def record_many(
    arms: Sequence[Arm], drives: Sequence[TrialInput], amplitudes: Sequence[float]
) -> list[Recording]:
    """Spring lengths of several arms, each of which follows a drive from where it is.

    Args:
        arms: at rest; they are left as they are, so that one may be given several times.
        drives: the input of each.
        amplitudes: R of each [degrees].

    Returns:
        For each arm, to the bit as alone, its spring lengths after the step to each θ(t) = φ(t),
        (T_ini + 16,000, springs) [m], or the error that says where it left its domain.

    Raises:
        ValueError: a body with another timestep than the paper's.
    """
    for arm in arms:
        check_timestep(arm.parameters)
    angles = [
        base_angles(drive.signal, amplitude, drive.peak)
        for drive, amplitude in zip(drives, amplitudes, strict=True)
    ]
    return record_arms(arms, angles)


def check_timestep(parameters: ArmParameters) -> None:
    """Refuse a body with which In(t) and the targets would be of another timestep."""
    if parameters.timestep != TIMESTEP:
        raise RefusedError(
            f"timestep = {parameters.timestep}: the emulation tasks are defined at {TIMESTEP} s"
        )


def fit_readout(features: Float, drive: TrialInput) -> Readout:
    """The paper's readout: Moore-Penrose pseudo-inverse on the training rows, no bias."""
    return Readout("pinv").fit(features[drive.training], drive.targets[drive.training])


def mean_squared_errors(outputs: Float, targets: Float) -> dict[str, float]:
    """Mean squared error of outputs (T, 3) by task."""
    errors = np.square(outputs - targets).mean(axis=0)
    return dict(zip(TASKS, errors.tolist(), strict=True))


def score_features(features: Float, drive: TrialInput) -> tuple[Scores, Readout]:
    """Fit the readout on the training rows of some features, and measure it.

    Args:
        features: (T_ini + 16,000, n), from which y(t + 1) is to be computed.
        drive: the trial.

    Returns:
        ``({"test": {task: error}, "training": {task: error}}, readout)``.
    """
    readout = fit_readout(features, drive)
    scores = {
        phase: mean_squared_errors(readout.predict(features[rows]), drive.targets[rows])
        for phase, rows in (("test", drive.test), ("training", drive.training))
    }
    return scores, readout
