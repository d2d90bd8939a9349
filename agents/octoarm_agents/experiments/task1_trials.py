"""The trials of Task 1: each gives the errors of one run of the arm, as plain numbers.

A trial whose arm leaves its domain says so in ``failure`` and has no errors of the arm. The arms
of several trials are recorded in less time together than one by one (`record_trials`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from octoarm_agents.common.lanes import Recording
from octoarm_agents.experiments.task1 import (
    Drive,
    fit_readout,
    mean_squared_errors,
    record_many,
    score_features,
    trial_streams,
)
from octoarm_agents.reservoir.baselines import BASELINES
from octoarm_agents.reservoir.closed_loop import describe_domain_error
from octoarm_agents.reservoir.readout import Readout
from octoarm_env import Arm, ArmParameters, DomainError

__all__ = ["compare_methods", "leave_out_compartments", "record_trials", "score_arm"]

Float = NDArray[np.float64]

SPRINGS_PER_COMPARTMENT = 4


def record_trials(
    parameters: ArmParameters, settings: Sequence[Mapping[str, Any]]
) -> list[Recording]:
    """The arms' runs of several trials, for their argument ``recording``; see `run_trials`.

    Args:
        parameters: the body.
        settings: keyword arguments of each trial, of which ``kind``, ``amplitude``, ``seed`` and
            ``trial`` are used.

    Returns:
        As `record_many`.
    """
    drives = [Drive.make(each["kind"], each["seed"], each["trial"]) for each in settings]
    amplitudes = [each["amplitude"] for each in settings]
    return record_many([Arm(parameters)] * len(drives), drives, amplitudes)


def score_arm(
    parameters: ArmParameters,
    *,
    kind: str,
    amplitude: float,
    seed: int,
    trial: int,
    sensor_noise: Sequence[float] = (),
    recording: Recording | None = None,
) -> dict[str, Any]:
    """Errors of the arm's readout, and of readouts that see the same run through noise.

    Args:
        parameters: the body.
        kind: of input, see `Drive.make`.
        amplitude: R [degrees].
        seed: of the experiment.
        trial: number of the trial.
        sensor_noise: half widths [m], not negative, of the uniform noise that is added to the
            lengths, for training and test; it is drawn from (seed, trial), the same at every R.
        recording: what `record_trials` gives for this trial; None: it is recorded here.

    Returns:
        ``trial``, ``initial_steps``, ``failure`` (None or the message and its numbers) and, if the
        arm stayed in its domain, ``arm`` ({phase: {task: error}}), ``state_rank`` and
        ``sensor_noise`` (one {phase: {task: error}} a level).

    Raises:
        ValueError: a half width that is negative or not finite.
    """
    for level in sensor_noise:
        if not 0 <= level < math.inf:
            raise ValueError(
                f"sensor_noise = {list(sensor_noise)}: expected finite half widths >= 0, in metres"
            )
    drive = Drive.make(kind, seed, trial)
    result: dict[str, Any] = {"trial": trial, "initial_steps": drive.initial, "failure": None}
    if recording is None:
        (recording,) = record_many([Arm(parameters)], [drive], [amplitude])
    if isinstance(recording, DomainError):
        return result | {"failure": describe_domain_error(recording)}
    lengths = recording
    scores, readout = score_features(lengths, drive)
    (noise_stream,) = trial_streams(seed, trial, 1)
    noisy = [
        score_features(lengths + noise_stream.uniform(-level, level, lengths.shape), drive)[0]
        for level in sensor_noise
    ]
    return result | {"arm": scores, "state_rank": readout.rank_, "sensor_noise": noisy}


def compare_methods(
    parameters: ArmParameters,
    *,
    kind: str,
    amplitude: float,
    seed: int,
    trial: int,
    sensor_noise: list[float],
    recording: Recording | None = None,
) -> dict[str, Any]:
    """Errors of the arm, of the baselines on the same rows, and of the arm seen through noise.

    Args:
        parameters: the body.
        kind: of input, see `Drive.make`.
        amplitude: R [degrees].
        seed: of the experiment.
        trial: number of the trial.
        sensor_noise: standard deviations [m] of the normal noise that is added to the lengths, for
            training and test.
        recording: what `record_trials` gives for this trial; None: it is recorded here.

    Returns:
        As `score_arm`, with ``baselines`` ({name: {phase: {task: error}}}) and ``sensor_noise``
        (one {phase: {task: error}} a level).
    """
    drive = Drive.make(kind, seed, trial)
    network_stream, noise_stream = trial_streams(seed, trial, 2)
    result: dict[str, Any] = {"trial": trial, "initial_steps": drive.initial, "failure": None}
    result["baselines"] = {
        name: score_features(features(drive.signal, network_stream), drive)[0]
        for name, features in BASELINES.items()
    }
    if recording is None:
        (recording,) = record_many([Arm(parameters)], [drive], [amplitude])
    if isinstance(recording, DomainError):
        return result | {"failure": describe_domain_error(recording)}
    lengths = recording
    scores, readout = score_features(lengths, drive)
    noisy = [
        score_features(lengths + noise_stream.normal(0.0, level, lengths.shape), drive)[0]
        for level in sensor_noise
    ]
    return result | {"arm": scores, "state_rank": readout.rank_, "sensor_noise": noisy}


def leave_out_compartments(
    parameters: ArmParameters,
    *,
    kind: str,
    amplitude: float,
    seed: int,
    trial: int,
    recording: Recording | None = None,
) -> dict[str, Any]:
    """Errors with one compartment's four springs left out, at the test alone or from the start.

    Args:
        parameters: the body.
        kind: of input, see `Drive.make`.
        amplitude: R [degrees].
        seed: of the experiment.
        trial: number of the trial.
        recording: what `record_trials` gives for this trial; None: it is recorded here.

    Returns:
        ``trial``, ``initial_steps``, ``failure`` and, if the arm stayed in its domain, test errors:
        ``full`` ({task: error}) with all springs, ``zeroed`` (one {task: error} a compartment) with
        its trained weights set to zero, ``retrained`` (likewise) with a readout trained without it.
    """
    drive = Drive.make(kind, seed, trial)
    result: dict[str, Any] = {"trial": trial, "initial_steps": drive.initial, "failure": None}
    if recording is None:
        (recording,) = record_many([Arm(parameters)], [drive], [amplitude])
    if isinstance(recording, DomainError):
        return result | {"failure": describe_domain_error(recording)}
    lengths = recording
    readout = fit_readout(lengths, drive)
    test, targets = lengths[drive.test], drive.targets[drive.test]
    outputs = readout.predict(test)
    zeroed, retrained = [], []
    for springs, reduced in _reduced_weights(lengths, drive):
        # What the compartment's springs add to the outputs, taken away again.
        without = outputs - test[:, springs] @ readout.weights_[springs]
        zeroed.append(mean_squared_errors(without, targets))
        kept = np.delete(test, springs, axis=1)
        retrained.append(mean_squared_errors(kept @ reduced, targets))
    return result | {
        "full": mean_squared_errors(outputs, targets),
        "zeroed": zeroed,
        "retrained": retrained,
    }


def _reduced_weights(lengths: Float, drive: Drive) -> list[tuple[slice, Float]]:
    """Weights of the readout trained without each compartment.

    The training rows are reduced once to their triangular factor, which has the same least-squares
    solution, singular values and pseudo-inverse for any choice of columns.

    Returns:
        For each compartment its columns, and the weights (springs - 4, 3) of all others.
    """
    count = lengths.shape[1]
    training = np.hstack((lengths[drive.training], drive.targets[drive.training]))
    # (NumPy's stubs know only the mode that returns a pair.)
    triangle = cast("Float", np.linalg.qr(training, mode="r"))
    # The default for the training rows; that for the factor's few would be smaller.
    tolerance = max(len(training), count) * float(np.finfo(np.float64).eps)
    reduced = []
    for begin in range(0, count, SPRINGS_PER_COMPARTMENT):
        springs = slice(begin, begin + SPRINGS_PER_COMPARTMENT)
        factor = np.delete(triangle[:, :count], springs, axis=1)
        fitted = Readout("pinv", tolerance=tolerance).fit(factor, triangle[:, count:])
        reduced.append((springs, fitted.weights_))
    return reduced
