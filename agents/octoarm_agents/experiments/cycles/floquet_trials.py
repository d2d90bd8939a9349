"""The trial of the Floquet map: many readouts of one teacher, what they are like and what they do.

A trial of `octoarm_agents.common.trials`: plain numbers in and out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from octoarm_agents.experiments.cycles.trials import TaughtLoop, hold_cycle
from octoarm_agents.reservoir.closed_loop import HELD_DISTANCE, describe_domain_error
from octoarm_agents.reservoir.teacher import TeacherRun
from octoarm_agents.reservoir.teaching import ReadoutTrainer, Teaching
from octoarm_env import ArmParameters, DomainError
from octoarm_env.arrays import Float

RESPONSE_NOISES = (1e-5, 1e-4)
"""Half widths of the noise that a loop's response is measured with, in units of R. The water's
force on a strut jumps where the flow turns over to its other side (the lift of the body does not
vanish there), so that even much smaller noise makes deviations of some 1e-6."""

RESPONSE_TURNS = 8
"""Turns of the cycle over which exponents are averaged and responses followed."""

PHASE_ERROR = 0.3
"""By how much the phase's exponent, zero over many turns, may then differ from zero [1/s]."""

_BEGIN = 5_000
"""Step of the teacher's run at which a response begins; by then cycle and body are settled."""


def probe_loops(
    parameters: ArmParameters,
    *,
    teaching: Mapping[str, Any],
    noises: Sequence[float],
    factors: Sequence[float],
    steps: int,
) -> dict[str, Any]:
    """Fit readouts to one teacher, look at the stability of their loops, and let the arm go.

    Args:
        parameters: the body.
        teaching: keyword arguments of `Teaching`, direct or servo.
        noises: ν [m], in place of the teaching's.
        factors: of the teaching's κ; 0 is the paper's training.
        steps: of the closed loop.

    Returns:
        ``failure`` (None, or the domain error of an arm that could not follow the teacher) and
        ``loops``, one for each factor and ν: ``factor``, ``noise``, ``training_error`` in units of
        R, ``exponents`` (the largest five [1/s], largest first; empty if the loop's gain is beyond
        all bounds), ``leading_exponent``, ``responses`` (`noise_response` to each of
        `RESPONSE_NOISES`), ``steps`` made, ``loop_failure``, ``scores`` (None after a failure) and
        ``held``.
    """
    how = Teaching(**teaching)
    try:
        trainer = ReadoutTrainer(parameters, how)
        fits = [
            (factor, noise, *trainer.weights(noise, [factor * size for size in how.disturbances]))
            for factor in factors
            for noise in noises
        ]
    except DomainError as error:
        return {"failure": {"stage": "teaching"} | describe_domain_error(error), "loops": []}
    longest = len(trainer.run.lengths) - _BEGIN - 1_000
    averaged = min(round(RESPONSE_TURNS * trainer.run.turn), longest)
    loops = []
    for factor, noise, weights, training_error in fits:
        exponents = [float(value) for value in trainer.exponents(weights, averaged)]
        loop = TaughtLoop(how.target, how.amplitude, trainer.run.actuator, weights.tolist())
        held = hold_cycle(parameters, loop=vars(loop), steps=steps)
        loops.append(
            {
                "factor": factor,
                "noise": noise,
                "training_error": training_error / how.amplitude,
                "exponents": exponents,
                "leading_exponent": leading_exponent(exponents),
                "responses": [
                    noise_response(trainer.run, weights, size, averaged) for size in RESPONSE_NOISES
                ],
                "steps": held["steps"],
                "loop_failure": held["failure"],
                "scores": held["scores"],
                "held": held["survived"] and held["scores"]["held"],
            }
        )
    return {"failure": None, "loops": loops}


def leading_exponent(exponents: Sequence[float]) -> float | None:
    """The largest exponent beside the phase's.

    Args:
        exponents: the largest first [1/s].

    Returns:
        The largest if it is above `PHASE_ERROR`, else the next, for then the largest is that of the
        phase, or as small; None if there are not two.
    """
    if len(exponents) < 2:
        return None
    return exponents[0] if exponents[0] > PHASE_ERROR else exponents[1]


def noise_response(run: TeacherRun, weights: Float, size: float, steps: int) -> float | None:
    """How far white noise on the outputs moves them, in a loop that is kept on the teacher's orbit.

    What the readout says wrongly of the teacher's own lengths is taken off, so that without noise
    the loop stays on the orbit, stable or not. Only the part of the deviation across the orbit is
    measured: along it the phase wanders, and nothing calls it back.

    Args:
        run: the orbit.
        weights: (springs, 2) [degrees/m].
        size: half width of the noise, uniform, anew each step, in units of R.
        steps: for which noise is added, all within the run; the second half is measured.

    Returns:
        Root mean square of the deviation across the orbit over that of the noise on one output;
        None if the arm left its domain.
    """
    end = _BEGIN + steps
    half_width = size * run.amplitude
    noise = np.random.default_rng(0).uniform(-half_width, half_width, (steps, 2))
    offsets = run.offsets(weights, _BEGIN, end)
    try:
        outputs, _ = run.arm_after(_BEGIN).run_closed_loop(weights, steps, offsets + noise)
    except DomainError:
        return None
    deviations = outputs + offsets - run.signal[_BEGIN:end]
    along = np.gradient(run.signal, axis=0)[_BEGIN:end]
    across = deviations[:, 0] * along[:, 1] - deviations[:, 1] * along[:, 0]
    across /= np.hypot(along[:, 0], along[:, 1])
    return float(np.sqrt(np.square(across[steps // 2 :]).mean())) / (half_width / math.sqrt(3))


def is_stable(loop: Mapping[str, Any]) -> bool:
    """Whether no exponent beside the phase's is above zero."""
    exponent = loop["leading_exponent"]
    return exponent is not None and exponent < 0


def is_thrown_far(loop: Mapping[str, Any]) -> bool:
    """Whether the larger noise moves a loop farther than a held cycle may be from its orbit."""
    response = loop["responses"][-1]
    return response is None or response * RESPONSE_NOISES[-1] / 3**0.5 > HELD_DISTANCE
