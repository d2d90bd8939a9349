"""The trials of Task 1: each gives the errors of one run of the arm, as plain numbers.

All take ``kind``, ``seed`` and ``trial`` as `TrialInput.make` does, ``amplitude``, R [degrees], and
``recording``, what `record_trials` gives for the trial; None: it is recorded by the trial itself.
All give ``trial``, ``initial_steps``, T_ini, and ``failure``: None, or the message and the numbers
of an arm that left its domain, of which there are no errors.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, cast

import numpy as np

from octoarm_agents.common.lanes import Recording
from octoarm_agents.common.trials import Settings, Trial
from octoarm_agents.experiments.emulation.protocol import (
    TrialInput,
    check_timestep,
    fit_readout,
    mean_squared_errors,
    record_many,
    score_features,
)
from octoarm_agents.experiments.runner import RunSettings
from octoarm_agents.reservoir.baselines import BASELINES
from octoarm_agents.reservoir.closed_loop import describe_domain_error
from octoarm_agents.reservoir.readout import Readout
from octoarm_env import Arm, ArmParameters, DomainError
from octoarm_env.arrays import Float

SPRINGS_PER_COMPARTMENT = 4


def make_trials(
    settings: RunSettings, name: str, function: Trial, points: Sequence[Settings]
) -> list[list[dict[str, Any]]]:
    """Make an experiment's trials at each of some points; see `RunSettings.repeat`.

    Raises:
        RefusedError: a body of another timestep than the paper's.
    """
    check_timestep(settings.parameters)
    return settings.repeat(name, function, [[point] for point in points], record_trials)


def list_failures(trials: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """What went wrong in which trial."""
    return [
        {"trial": each["trial"]} | each["failure"] for each in trials if each["failure"] is not None
    ]


def note_failures(result: Mapping[str, Any]) -> list[str]:
    """The same as lines below a table."""
    return [f"Trial {each['trial']} failed: {each['message']}." for each in result["failures"]]


def record_trials(
    parameters: ArmParameters, settings: Sequence[Mapping[str, Any]]
) -> list[Recording]:
    """Record the arms of several trials in less time than one by one; see `run_trials`."""
    drives = [TrialInput.make(each["kind"], each["seed"], each["trial"]) for each in settings]
    amplitudes = [each["amplitude"] for each in settings]
    return record_many([Arm(parameters)] * len(drives), drives, amplitudes)


def _trial(measure: Callable[..., dict[str, Any]]) -> Trial:
    """Make a trial of what is to be measured.

    Args:
        measure: is called with the spring lengths (None after a failure), the drive, a generator of
            (seed, trial) and the trial's other settings.
    """

    @functools.wraps(measure)
    def run(
        parameters: ArmParameters,
        *,
        kind: str,
        amplitude: float,
        seed: int,
        trial: int,
        recording: Recording | None = None,
        **more: Any,
    ) -> dict[str, Any]:
        drive = TrialInput.make(kind, seed, trial)
        if recording is None:
            (recording,) = record_many([Arm(parameters)], [drive], [amplitude])
        lengths: Recording | None = recording
        failure = None
        if isinstance(recording, DomainError):
            lengths, failure = None, describe_domain_error(recording)
        result = {"trial": trial, "initial_steps": drive.initial, "failure": failure}
        return result | measure(lengths, drive, np.random.default_rng([seed, trial]), **more)

    return run


@_trial
def score_arm(
    lengths: Float | None,
    drive: TrialInput,
    random: np.random.Generator,
    sensor_noise: Sequence[float] = (),
) -> dict[str, Any]:
    """Errors of the arm's readout, and of readouts that see the same run through noise.

    ``sensor_noise`` are half widths [m], not negative, of the uniform noise that is added to the
    lengths, for training and test; it is drawn from (seed, trial), the same at every R.

    Returns:
        Besides what is said above ``arm`` ({phase: {task: error}}), ``state_rank`` and
        ``sensor_noise`` (one {phase: {task: error}} a level).
    """
    if lengths is None:
        return {}
    (stream,) = random.spawn(1)
    noises = (stream.uniform(-level, level, lengths.shape) for level in sensor_noise)
    return _score(lengths, drive, noises)


@_trial
def compare_methods(
    lengths: Float | None,
    drive: TrialInput,
    random: np.random.Generator,
    sensor_noise: Sequence[float],
) -> dict[str, Any]:
    """Errors of the arm, of the baselines on the same rows, and of the arm seen through noise.

    ``sensor_noise`` are standard deviations [m] of the normal noise that is added to the lengths,
    for training and test.

    Returns:
        As `score_arm`, and always ``baselines`` ({name: {phase: {task: error}}}).
    """
    network_stream, noise_stream = random.spawn(2)
    result: dict[str, Any] = {
        "baselines": {
            name: score_features(features(drive.signal, network_stream), drive)[0]
            for name, features in BASELINES.items()
        }
    }
    if lengths is None:
        return result
    noises = (noise_stream.normal(0.0, level, lengths.shape) for level in sensor_noise)
    return result | _score(lengths, drive, noises)


@_trial
def leave_out_compartments(
    lengths: Float | None, drive: TrialInput, _: np.random.Generator
) -> dict[str, Any]:
    """Errors with one compartment's four springs left out, at the test alone or from the start.

    Returns:
        Besides what is said above test errors: ``full`` ({task: error}) with all springs,
        ``zeroed`` (one {task: error} a compartment) with its trained weights set to zero,
        ``retrained`` (likewise) with a readout trained without it.
    """
    if lengths is None:
        return {}
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
    full = mean_squared_errors(outputs, targets)
    return {"full": full, "zeroed": zeroed, "retrained": retrained}


def _score(lengths: Float, drive: TrialInput, noises: Iterable[Float]) -> dict[str, Any]:
    """Errors of the readouts of a run and of the same run with each noise."""
    scores, readout = score_features(lengths, drive)
    noisy = [score_features(lengths + noise, drive)[0] for noise in noises]
    return {"arm": scores, "state_rank": readout.rank_, "sensor_noise": noisy}


def _reduced_weights(lengths: Float, drive: TrialInput) -> list[tuple[slice, Float]]:
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
