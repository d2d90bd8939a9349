"""How much does each open parameter matter? Each is moved alone, and the body measured again."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import takewhile
from pathlib import Path
from typing import Any

from octoarm_agents.calibration.body import measure_again
from octoarm_agents.calibration.outcomes import plain_outcomes
from octoarm_agents.calibration.score import TEACHER_STEPS, follow_teachers, initial_steps
from octoarm_agents.calibration.sensitivity_report import draw_sensitivity, sensitivity_markdown
from octoarm_agents.calibration.space import OPEN_NUMBERS, tilt_gravity
from octoarm_agents.common.files import write_atomically, write_json, write_text
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.trials import run_trials
from octoarm_agents.common.workers import Jobs
from octoarm_agents.experiments.emulation.protocol import RANGE, check_timestep
from octoarm_env import LIMIT_CYCLES, Arm, ArmParameters

AMPLITUDES = (5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 75.0, 90.0, 110.0, 130.0)
"""R of the teachers tried; 90, 130 and 10 are the paper's for its three cycles [degrees]."""

FACTORS = (0.5, 0.8, 1.25, 2.0)
TILTS = (10.0, 45.0, 90.0)
LIFTS = (1.0, 0.0, -1.0)
"""How each parameter is moved: by factors; gravity by angles [degrees]; lift to these."""


@dataclass(frozen=True)
class Change:
    """One parameter moved.

    Attributes:
        parameter: field of `ArmParameters`, empty for the body as it is.
        label: to which value, for a table.
        fields: what is replaced, by field.
    """

    parameter: str
    label: str
    fields: dict[str, Any]


def changes_of(base: ArmParameters) -> list[Change]:
    """All moves of a body's open parameters, the body as it is first.

    A number that is zero has no multiples; it takes values over its bounds of the search. The other
    reading of the reference area comes with the area rescaled, so that the area at rest stays.

    Args:
        base: the body.
    """

    def moved(
        name: str, values: Sequence[Any], label: Callable[[Any], str] = "{:.3g}".format
    ) -> list[Change]:
        own = getattr(base, name)
        return [Change(name, label(each), {name: each}) for each in values if each != own]

    share, density = OPEN_NUMBERS["longitudinal_mass_share"], OPEN_NUMBERS["arm_density"]
    changes = [Change("", "the body as it is", {})]
    changes += moved("longitudinal_mass_share", (share.low, 0.5, 2 / 3, 0.8, share.high))
    changes += moved("base_coupling", ("gravity", "inertial"), str)
    for name in ("area_scale", "plane_mass", "plane_inertia"):
        value = float(getattr(base, name))
        if value:
            changes += [Change(name, f"× {factor:g}", {name: value * factor}) for factor in FACTORS]
        else:
            changes += moved(name, [OPEN_NUMBERS[name].value(k / 3) for k in range(4)])
    changes += moved("arm_density", (density.low, 1080.0, 1150.0, density.high), "{:g}".format)
    changes += [
        Change("gravity", f"tilted {angle:g}°", {"gravity": tilt_gravity(base.gravity, angle)})
        for angle in TILTS
    ]
    changes += moved("lift_scale", LIFTS, lambda value: f"{value:+g}" if value else "0")
    changes += moved("volume_force", ("applied", "total"), str)
    other = "planform" if base.reference_area == "wetted" else "wetted"
    factor = math.pi if other == "planform" else 1 / math.pi
    fields = {"reference_area": other, "area_scale": base.area_scale * factor}
    changes.append(Change("reference_area", f"{other}, area rescaled", fields))
    return changes


def probe_change(
    parameters: ArmParameters,
    *,
    fields: dict[str, Any],
    starts: Sequence[int],
    amplitudes: Sequence[float],
    noise_seeds: int = 0,
) -> dict[str, Any]:
    """Measure a body with some parameters replaced; a trial of `run_trials`.

    Args:
        parameters: the body.
        fields: replaced in it.
        starts: T_ini of each run of Task 1.
        amplitudes: R of the teachers, rising [degrees].
        noise_seeds: trainings of each limit cycle, see `plain_outcomes`; 0: none.

    Returns:
        ``error``: None, or why there is no such body at rest; ``task1``, see `measure_again`;
        ``outcomes``, see `plain_outcomes`, None without noise seeds; and ``largest_amplitudes`` by
        cycle: of the R up to which a direct base can be forced, the largest [degrees], None if that
        is none.
    """
    result: dict[str, Any] = dict.fromkeys(("error", "task1", "outcomes", "largest_amplitudes"))
    try:
        body = parameters.replace(**fields)
        arm = Arm(body)
        task1 = measure_again(body, starts)
    except ValueError as error:  # out of a field's range, or no static equilibrium
        return result | {"error": str(error)}
    largest: dict[str, float | None] = {}
    for target in LIMIT_CYCLES:
        tried = len(amplitudes)
        steps = follow_teachers([arm] * tried, [target] * tried, amplitudes)
        tries = zip(amplitudes, steps, strict=True)
        followed = takewhile(lambda pair: pair[1] == TEACHER_STEPS, tries)
        largest[target] = max((amplitude for amplitude, _ in followed), default=None)
    outcomes = plain_outcomes(body, noise_seeds) if noise_seeds else None
    return result | {"task1": task1, "outcomes": outcomes, "largest_amplitudes": largest}


def measure_sensitivity(
    base: ArmParameters,
    *,
    out: Path,
    trials: int = 3,
    amplitudes: Sequence[float] = AMPLITUDES,
    noise_seeds: int = 2,
    jobs: Jobs = 1,
) -> dict[str, Any]:
    """Move every open parameter alone; write ``sensitivity.json``, ``.png`` and ``.md``.

    Finished bodies are kept in ``.sensitivity-trials``, so that an interrupted run goes on there.

    Args:
        base: the body.
        out: folder, which must exist.
        trials: T_ini over which the errors of Task 1 are averaged.
        amplitudes: R of the teachers [degrees].
        noise_seeds: trainings of each limit cycle; 0: none.
        jobs: processes, or a cluster; the results do not depend on it.

    Returns:
        What ``sensitivity.json`` holds.

    Raises:
        ValueError: a setting out of its range, a body of another timestep than the paper's.
        OSError: the folder cannot be written to.
    """
    check_timestep(base)
    ladder = sorted(amplitudes)
    if not ladder or not all(0 < amplitude <= 360 for amplitude in ladder):
        raise ValueError(f"amplitudes = {list(amplitudes)}: expected 0 to 360 degrees, not 0")
    starts = initial_steps(trials)
    changes = changes_of(base)
    settings = {"starts": starts, "amplitudes": ladder, "noise_seeds": noise_seeds}
    results = run_trials(
        probe_change,
        base,
        [{"fields": each.fields} | settings for each in changes],
        folder=out / ".sensitivity-trials",
        jobs=jobs,
        description="bodies",
    )
    result = {
        "settings": {
            "range_degrees": RANGE,
            "initial_steps": starts,
            "amplitudes_degrees": ladder,
            "teacher_steps": TEACHER_STEPS,
            "noise_seeds": noise_seeds,
        },
        "changes": [
            asdict(each) | measured for each, measured in zip(changes, results, strict=True)
        ],
        "body": base.to_dict(),
        "versions": package_versions("octoarm-env", "octoarm-agents", "numpy", "scikit-learn"),
        "machine": describe_machine(),
    }
    text = sensitivity_markdown(result)
    write_atomically(out / "sensitivity.png", draw_sensitivity(result).savefig)
    write_text(out / "sensitivity.md", text)
    write_json(out / "sensitivity.json", result)
    return result
