"""All measures of an arm: what its states compute, and how it forgets where it began."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from octoarm_agents.analysis.drive import Drive, DrivenArm, record_arm, state_scales
from octoarm_agents.analysis.echo_state import EchoState, fit_decay
from octoarm_agents.analysis.lyapunov import LyapunovExponent, largest_lyapunov_exponent
from octoarm_agents.analysis.measures import Advance, Measures, MeasureSettings, measure
from octoarm_agents.analysis.plain import plain
from octoarm_agents.analysis.rank import SeparationRanks, separation_ranks
from octoarm_agents.common.whole import whole_fields
from octoarm_env import Arm, ArmBatch, ArmParameters
from octoarm_env.arrays import Float

_SCALE_HOLDS = 100
"""Holds over which the natural sizes of the state's components are measured."""

# One independent stream of random numbers for each part, so that none depends on another's length.
_DRIVE, _DIFFERENT, _SIMILAR, _ECHO_BEFORE, _ECHO, _LYAPUNOV, _SCALES = range(7)


@dataclass(frozen=True)
class SurveySettings:
    """What is done with an arm.

    Attributes:
        drive: how the input turns the base.
        measures: how the recorded states are measured; its washout, delays and seed hold here too.
        samples: input values after the washout and the largest delay.
        streams: input streams for each of the two ranks.
        stream_length: input values in each.
        similarity: σ; similar streams are (1 - σ) times one stream plus σ times another.
        echo_length: input values of the echo-state test.
        lyapunov_length: input values that the exponent is averaged over.
    """

    drive: Drive = field(default_factory=Drive)
    measures: MeasureSettings = field(default_factory=MeasureSettings)
    samples: int = 10_000
    streams: int = 100
    stream_length: int = 40
    similarity: float = 0.1
    echo_length: int = 2000
    lyapunov_length: int = 1000

    def __post_init__(self) -> None:
        whole_fields(
            self, samples=100, streams=2, stream_length=1, echo_length=10, lyapunov_length=10
        )
        if not 0 < self.similarity < 1:
            raise ValueError(f"similarity = {self.similarity}: expected a share between 0 and 1")

    def to_dict(self, timestep: float) -> dict[str, Any]:
        """Those that `measures` does not hold, as plain numbers for a JSON file."""
        content = asdict(self) | {"drive": self.drive.to_dict(timestep)}
        del content["measures"]
        return content

    def values(self, part: int, *shape: int) -> Float:
        """The input values of one part of the survey, independent and uniform in [-1, 1]."""
        random = np.random.default_rng([self.measures.seed, part])
        return random.uniform(-1.0, 1.0, shape)


@dataclass(frozen=True, eq=False)
class ArmSurvey:
    """What was found.

    Attributes:
        settings: what was done.
        parameters: the body.
        measures: of the recorded states.
        ranks: kernel rank and generalisation rank.
        echo: distance from equilibrium of an arm that another input moved before.
        lyapunov: largest conditional Lyapunov exponent.
    """

    settings: SurveySettings
    parameters: ArmParameters
    measures: Measures
    ranks: SeparationRanks
    echo: EchoState
    lyapunov: LyapunovExponent

    def to_dict(self) -> dict[str, Any]:
        """All as plain numbers for a JSON file; units in the keys."""
        return {
            "survey": self.settings.to_dict(self.parameters.timestep),
            **self.measures.to_dict(),
            "separation": plain(self.ranks),
            "echo_state": self.echo.to_dict(),
            "lyapunov": plain(self.lyapunov),
            "body": self.parameters.to_dict(),
        }

    def summary(self) -> dict[str, Any]:
        """The main figures, one line of a table."""
        processing = self.measures.processing
        return {
            "memory_capacity": self.measures.memory.total,
            "capacity_linear": processing.linear,
            "capacity_nonlinear": processing.nonlinear,
            "capacity_by_degree": processing.by_degree.tolist(),
            "rank": processing.rank,
            "rank_at_tolerance": self.measures.rank_at_tolerance,
            "participation_ratio": self.measures.effective_rank,
            "kernel_rank": self.ranks.kernel_rank,
            "generalisation_rank": self.ranks.generalisation_rank,
            "lyapunov_exponent_per_second": self.lyapunov.exponent_per_second,
            "lyapunov_standard_error_per_second": self.lyapunov.standard_error_per_second,
            "echo_decay_time_seconds": self.echo.decay_time_seconds,
            "echo_verdict": self.echo.verdict,
            "warnings": self.measures.warnings,
        }


def survey_arm(
    parameters: ArmParameters, settings: SurveySettings, advance: Advance | None = None
) -> ArmSurvey:
    """Drive an arm with an independent input and take all measures.

    Args:
        parameters: the body.
        settings: what to do.
        advance: called with the name of the stage and the share of the whole just done.

    Raises:
        DomainError: the arm left the domain of the model.
        ValueError: a setting out of its range, or a body without a static equilibrium.
    """
    report = advance or (lambda stage, share: None)
    length = settings.measures.washout + settings.measures.oldest + settings.samples
    # Sums split over threads are rounded otherwise.
    with threadpool_limits(1):
        report("recording", 0.0)
        recording = record_arm(parameters, settings.drive, settings.values(_DRIVE, length))
        report("capacities", 0.25)
        measures = measure(
            recording, settings.measures, lambda stage, share: report(stage, 0.25 * share)
        )
        report("ranks", 0.0)
        ranks = _separate(parameters, settings)
        report("echo state", 0.25)
        scales = state_scales(parameters, settings.drive, settings.values(_SCALES, _SCALE_HOLDS))
        echo = _echo(parameters, settings, scales)
        report("Lyapunov exponent", 0.1)
        lyapunov = _lyapunov(parameters, settings, scales)
        report("Lyapunov exponent", 0.15)
    return ArmSurvey(settings, parameters, measures, ranks, echo, lyapunov)


def _separate(parameters: ArmParameters, settings: SurveySettings) -> SeparationRanks:
    shape = settings.streams, settings.stream_length
    different = settings.values(_DIFFERENT, *shape)
    others, share = settings.values(_SIMILAR, *shape), settings.similarity
    similar = (1 - share) * different[0] + share * others
    arm = Arm(parameters, settings.drive.actuator)
    hold_steps = settings.drive.hold_steps(parameters.timestep)
    batch = ArmBatch([arm] * settings.streams, threads=1)
    start = batch.states

    def final_states(streams: Float) -> Float:
        batch.states = start
        angles = [settings.drive.angles(each, 0.0, parameters.timestep) for each in streams]
        run = batch.run(np.stack(angles), stride=hold_steps)
        for failure in run.failures:
            if failure is not None:
                raise failure
        return run.lengths[:, -1]

    tolerance = settings.measures.tolerance
    return separation_ranks(final_states(different), final_states(similar), tolerance)


def _echo(parameters: ArmParameters, settings: SurveySettings, scales: Float) -> EchoState:
    resting = DrivenArm(parameters, settings.drive, scales)
    moved = DrivenArm(parameters, settings.drive, scales)
    moved.run(np.append(settings.values(_ECHO_BEFORE, settings.measures.washout + 1), 0.0))
    # Two bodies on bases at rest: a servo that is still on its way would be a difference in input.
    moved.place(moved.vector, resting.arm.state.base, 0.0)
    distances = [_distance(resting, moved)]
    for value in settings.values(_ECHO, settings.echo_length):
        resting.run(np.array([value]))
        moved.run(np.array([value]))
        distances.append(_distance(resting, moved))
    return fit_decay(np.array(distances), resting.interval)


def _distance(first: DrivenArm, second: DrivenArm) -> float:
    """Root mean square difference of all coordinates and rates, in their natural sizes."""
    return float(np.sqrt(np.mean((first.vector - second.vector) ** 2)))


def _lyapunov(
    parameters: ArmParameters, settings: SurveySettings, scales: Float
) -> LyapunovExponent:
    driven = DrivenArm(parameters, settings.drive, scales)
    transient = settings.measures.washout
    values = settings.values(_LYAPUNOV, transient + settings.lyapunov_length)
    before = np.concatenate(([0.0], values))
    bases = {0: driven.arm.state.base}

    def step(vector: Float, k: int) -> Float:
        driven.place(vector, bases[k], before[k])
        driven.run(values[k : k + 1])
        bases[k + 1] = driven.arm.state.base
        return driven.vector

    return largest_lyapunov_exponent(
        step,
        driven.vector,
        settings.lyapunov_length,
        interval=driven.interval,
        transient=transient,
        seed=settings.measures.seed,
    )
