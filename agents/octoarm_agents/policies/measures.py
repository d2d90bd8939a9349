"""What an agent is measured by: with the target's clock, without it, and after disturbances."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from octoarm_agents.common.orbit import is_held, orbit_distance, steps_to_return, turn_time
from octoarm_agents.policies.rollout import Rollout
from octoarm_env import OctoArmVectorEnv
from octoarm_env.arrays import Float

ON_ORBIT = 0.1
"""Distance from the target orbit, in amplitudes, within which an arm counts as on it."""

ON_PACE = 0.05
"""Part by which the period of an arm that holds the orbit may be off."""


@dataclass(frozen=True, eq=False)
class TargetOrbit:
    """What the base is to follow, and how often it is told to.

    Attributes:
        points: of one turn, (K, 2) [degrees].
        amplitude: largest angle [degrees].
        period: of a turn [s].
        control_period: seconds of a step.
    """

    points: Float
    amplitude: float
    period: float
    control_period: float

    @classmethod
    def of(cls, envs: OctoArmVectorEnv) -> Self:
        """The target of environments that all have the same."""
        points, amplitude, period = (
            envs.get_attr(name)[0] for name in ("orbit", "amplitude", "period")
        )
        return cls(np.array(points), amplitude, period, envs.settings[0].control_period)


def tracking_measures(rollout: Rollout) -> dict[str, float]:
    """Measures that know the time: phase errors count.

    Returns:
        ``return``, the mean over episodes; ``tracking_error``, the mean distance of the base from
        its target at the same instant [degrees]; ``survival``, the share of episodes in which the
        arm did not leave its domain.
    """
    return {
        "return": float(rollout.returns.mean()),
        "tracking_error": float(rollout.errors[rollout.alive].mean()),
        "survival": float(1 - rollout.failed.mean()),
    }


def orbit_series(rollout: Rollout, orbit: Float) -> Float:
    """Distance of the base from the target orbit, whatever the phase, (T, n) [degrees].

    Infinite where the episode had ended.
    """
    steps, count, _ = rollout.angles.shape
    flat = orbit_distance(rollout.angles.reshape(-1, 2), orbit)
    return np.where(rollout.alive, flat.reshape(steps, count), np.inf)


def orbit_measures(rollout: Rollout, target: TargetOrbit, window: int) -> dict[str, float | None]:
    """Measures that do not know the time: is the arm on the orbit, does it turn at its pace.

    Args:
        rollout: long enough to be settled.
        target: what the base was to follow.
        window: last steps that count.

    Returns:
        ``orbit_distance``, the median over episodes of the mean distance in amplitudes (None if no
        arm lasted and swings: one at rest is on every orbit through the origin); ``period``, the
        median time of a turn in periods of the target (None if fewer than half of the arms turn);
        ``held``, the share of episodes that end with a mean distance within `ON_ORBIT` and a period
        within `ON_PACE`; ``survival``, the share that last.
    """
    distances = orbit_series(rollout, target.points)[-window:].mean(axis=0) / target.amplitude
    turn = target.period / target.control_period
    periods = np.array(
        [turn_time(rollout.angles[-window:, index, 1]) / turn for index in range(len(distances))]
    )
    lasted = np.isfinite(distances)
    swinging = lasted & _swings(rollout.angles[-window:], target.points)
    turning = swinging & np.isfinite(periods)
    held = turning & is_held(distances, periods, distance_limit=ON_ORBIT, period_limit=ON_PACE)
    return {
        "orbit_distance": float(np.median(distances[swinging])) if swinging.any() else None,
        "period": float(np.median(periods[turning])) if turning.mean() >= 0.5 else None,
        "held": float(held.mean()),
        "survival": float(lasted.mean()),
    }


def recovery(rollout: Rollout, target: TargetOrbit, end: int) -> dict[str, float | None]:
    """How an arm comes back to the orbit, at whatever phase.

    Args:
        rollout: episodes with a disturbance in them, and after it at least ten turns of the orbit.
        target: what the base was to follow.
        end: first step after the disturbance.

    Returns:
        ``recovered``, the share of episodes that from some step on stay within `ON_ORBIT`, for at
        least the last tenth of what follows the disturbance, and swing in it; ``time``, the median
        of how long after its end that is [s] (None if fewer than half recover); ``return_after``,
        mean reward a step after the disturbance: what the lost phase costs.
    """
    distances = orbit_series(rollout, target.points)[end:] / target.amplitude
    last = steps_to_return(distances, ON_ORBIT)
    recovered = last <= 0.9 * len(distances)
    recovered &= _swings(rollout.angles[-max(len(distances) // 10, 1) :], target.points)
    times = np.where(recovered, last * target.control_period, np.inf)
    middle = float(np.median(times))
    return {
        "recovered": float(recovered.mean()),
        "time": middle if math.isfinite(middle) else None,
        "return_after": float(rollout.rewards[end:].mean()),
    }


def _swings(angles: Float, orbit: Float) -> NDArray[np.bool_]:
    """Whether both angles (T, n, 2) cover at least half of what they cover on the orbit, (n,)."""
    reach = np.ptp(angles, axis=0) >= 0.5 * np.ptp(orbit, axis=0)
    swinging: NDArray[np.bool_] = reach.all(axis=1)
    return swinging
