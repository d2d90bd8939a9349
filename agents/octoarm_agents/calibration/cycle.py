"""How is a cycle taught best? The search for ν and κ, then the full teaching and a long run."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

from octoarm_agents.common.files import write_json
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.whole import whole_number
from octoarm_agents.experiments.cycles.trials import TaughtLoop
from octoarm_agents.reservoir.closed_loop import FORCED_STEPS, WINDOW_STEPS, score_window
from octoarm_agents.reservoir.teaching import TIME_SCALES, Teaching, teach
from octoarm_agents.reservoir.tuning import tune
from octoarm_env import LIMIT_CYCLES, ArmParameters

CLOSED_STEPS = 100_000
"""Steps for which the loop found is run, undisturbed."""


def calibrate_cycle(
    parameters: ArmParameters,
    target: str,
    amplitude: float,
    *,
    actuator: Literal["direct", "servo"] = "direct",
    out: Path,
    evaluations: int = 160,
    noise: float = 0.01,
    seed: int = 1,
    steps: int = CLOSED_STEPS,
    advance: Callable[[str, float], None] | None = None,
) -> dict[str, Any]:
    """Find how a readout is taught a cycle, and see whether it holds it.

    The file in `out` is called TARGET-ACTUATOR.json.

    Args:
        parameters: the body.
        target: name of the limit cycle.
        amplitude: R, its largest angle [degrees].
        actuator: how the base follows its command.
        out: folder, which must exist.
        evaluations: candidates tried, at least 8.
        noise: half width of the noise on the outputs in the trial of a candidate [degrees].
        seed: of the search.
        steps: of the closed loop, at least `WINDOW_STEPS`.
        advance: called with the name of the stage and the share of the whole work just done.

    Returns:
        What the file holds: ``teaching`` (found), ``tuned_distance`` (in the search's own trial,
        None if no candidate held), ``exponents_per_second`` (leading Floquet exponents, None for
        one that is not finite), ``training_error_degrees``, ``closed_loop`` (``steps``,
        ``failure``, ``scores`` of the last `WINDOW_STEPS`, None if it ended early), ``record`` of
        all candidates, and what it was computed with.

    Raises:
        ValueError: a setting out of its range, a body that cannot rest.
        DomainError: the arm cannot follow the teacher.
        OSError: the folder cannot be written to.
    """
    steps = whole_number("steps", steps, WINDOW_STEPS)
    report = advance or (lambda stage, share: None)
    candidate = 1 / (evaluations + steps / 1000)  # a thousand steps take about as long
    tuned = tune(
        parameters,
        Teaching(target, amplitude, noise=0.0, actuator=actuator),
        evaluations=evaluations,
        noise=noise,
        seed=seed,
        advance=lambda: report("candidates", candidate),
    )
    taught = teach(parameters, tuned.teaching)
    cycle = TaughtLoop(target, amplitude, actuator, taught.readout.weights_.tolist())
    loop = cycle.close(
        parameters, advance=lambda count: report("closed loop", count / 1000 * candidate)
    )
    loop.run(steps)
    scores = None
    if loop.failure is None:
        turn = LIMIT_CYCLES[target].period / parameters.timestep
        scores = score_window(loop.outputs[-WINDOW_STEPS:], cycle.orbit, turn)
    result = {
        "settings": {
            "evaluations": evaluations,
            "noise_degrees": noise,
            "seed": seed,
            "forced_steps": FORCED_STEPS,
            "window_steps": WINDOW_STEPS,
            "time_scales_steps": list(TIME_SCALES),
        },
        "teaching": asdict(tuned.teaching),
        "tuned_distance": tuned.distance,
        "exponents_per_second": [
            value if math.isfinite(value) else None for value in taught.exponents.tolist()
        ],
        "training_error_degrees": taught.readout.training_error_,
        "closed_loop": {"steps": len(loop.outputs), "failure": loop.failure, "scores": scores},
        "record": tuned.record,
        "body": parameters.to_dict(),
        "versions": package_versions("octoarm-env", "octoarm-agents", "cma", "numpy", "scipy"),
        "machine": describe_machine(),
    }
    write_json(out / f"{target}-{actuator}.json", result)
    return result
