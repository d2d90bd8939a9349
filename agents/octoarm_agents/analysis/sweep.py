"""How the measures change with the body or the range of its motion (the paper's section 4)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal

from octoarm_agents.analysis.survey import SurveySettings, survey_arm
from octoarm_agents.common.progress import progress_bar
from octoarm_agents.common.workers import Jobs, map_unordered, number_of
from octoarm_env import ArmParameters, DomainError

Quantity = Literal["stiffness", "damping", "drag", "range"]

QUANTITIES: dict[Quantity, str] = {
    "stiffness": "factor on the stiffness of all springs",
    "damping": "factor on the damping of all springs",
    "drag": "factor on the area that the water acts on",
    "range": "R, the angle of an input of 1 (degrees)",
}
"""What can be swept, and what its values are."""

_FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)
_RANGE_FACTORS = (0.125, 0.25, 0.5, 1.0, 1.5, 2.0)


@dataclasses.dataclass(frozen=True)
class SweepPoint:
    """One value of the swept quantity.

    Attributes:
        value: of the quantity.
        summary: the main figures, None where the arm could not be measured.
        failure: why not, None where it could.
    """

    value: float
    summary: dict[str, Any] | None
    failure: str | None

    def to_dict(self) -> dict[str, Any]:
        """All as plain numbers for a JSON file; units in the keys."""
        return {"value": self.value, "failure": self.failure, **(self.summary or {})}


def default_values(quantity: Quantity, settings: SurveySettings) -> tuple[float, ...]:
    """Values around the body that is there: a quarter to four times, for R an eighth to twice."""
    if quantity == "range":
        return tuple(factor * settings.drive.amplitude for factor in _RANGE_FACTORS)
    return _FACTORS


def run_sweep(
    quantity: Quantity,
    values: Sequence[float],
    parameters: ArmParameters,
    settings: SurveySettings,
    jobs: Jobs = 1,
) -> list[SweepPoint]:
    """Survey the arm at each value, always with the same input.

    Args:
        quantity: what to change.
        values: positive; factors, for the range degrees.
        parameters: the body to start from.
        settings: what to do with each.
        jobs: processes, or a cluster; the result does not depend on it.

    Raises:
        ValueError: an unknown quantity, a value out of its range, or a setting out of its range.
    """
    if quantity not in QUANTITIES:
        raise ValueError(f"quantity = {quantity!r}: expected one of {sorted(QUANTITIES)}")
    number_of(jobs)
    if not values:
        raise ValueError("values: expected at least one")
    # Made here, so that a value that no body can have is an error before any work is done.
    bodies = [_change(quantity, value, parameters, settings) for value in values]
    calls = [(value, *body) for value, body in zip(values, bodies, strict=True)]
    points: dict[int, SweepPoint] = {}
    with progress_bar(len(values), quantity) as bar:
        for index, point in map_unordered(_survey_point, calls, jobs):
            points[index] = point
            bar.update()
    return [points[index] for index in range(len(values))]


def _change(
    quantity: Quantity, value: float, parameters: ArmParameters, settings: SurveySettings
) -> tuple[ArmParameters, SurveySettings]:
    if not 0 < value < float("inf"):
        raise ValueError(f"{quantity} = {value}: expected a positive number")
    if quantity == "range":
        drive = dataclasses.replace(settings.drive, amplitude=value)
        return parameters, dataclasses.replace(settings, drive=drive)
    fields = {
        "stiffness": ("longitudinal_stiffness", "transverse_stiffness"),
        "damping": ("longitudinal_damping", "transverse_damping"),
        "drag": ("area_scale",),
    }[quantity]
    return parameters.scaled(**dict.fromkeys(fields, value)), settings


def _survey_point(value: float, parameters: ArmParameters, settings: SurveySettings) -> SweepPoint:
    try:
        return SweepPoint(value, survey_arm(parameters, settings).summary(), None)
    except (DomainError, ValueError) as error:  # out of the domain, or no static equilibrium
        return SweepPoint(value, None, str(error))
