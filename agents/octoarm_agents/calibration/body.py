"""Which body? The search, its winner measured again, and the files that tell of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from octoarm_agents.calibration.body_figure import draw_calibration
from octoarm_agents.calibration.evaluation import Evaluation
from octoarm_agents.calibration.outcomes import CLOSED_STEPS
from octoarm_agents.calibration.score import (
    SCORE,
    TEACHER_STEPS,
    initial_steps,
    measure_task1,
    score_ratios,
)
from octoarm_agents.calibration.search import INITIAL, POPULATION, search_bodies
from octoarm_agents.calibration.space import OPEN_NUMBERS, SearchSpace
from octoarm_agents.common.files import write_atomically, write_json
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.workers import Jobs
from octoarm_agents.experiments.emulation.protocol import RANGE, TASKS, check_timestep
from octoarm_env import Arm, ArmParameters, DomainError


def calibrate_body(
    spaces: Sequence[SearchSpace],
    *,
    evaluations: int,
    out: Path,
    amplitudes: Mapping[str, float] | None = None,
    noise_seeds: int = 0,
    trials: int = 5,
    seed: int = 0,
    jobs: Jobs = 1,
) -> dict[str, Any] | None:
    """Search for the body, and write what was found.

    Files in `out`: ``evaluations.jsonl`` (every evaluation, see `search_bodies`) and, once a body
    has stayed in its domain, ``calibration.json``, ``calibration.png`` and ``body.json``, the
    whole body, for `ArmParameters.from_json`.

    Args:
        spaces: as all that is not named here, see `search_bodies`.
        evaluations: bodies tried in each space.
        out: folder, which must exist.
        amplitudes: R by cycle that the body must be able to follow on a direct base [degrees].
        noise_seeds: trainings of each limit cycle that every body is judged by; 0: none.
        trials: T_ini with which the best body is measured again.
        seed: of the search.
        jobs: processes, or a cluster.

    Returns:
        What ``calibration.json`` holds; None if no body stayed in its domain.

    Raises:
        ValueError: a setting out of its range, a base of another timestep than the paper's.
        OSError: the folder cannot be written to.
    """
    check_timestep(spaces[0].base)
    starts = initial_steps(trials)
    tried = search_bodies(
        spaces,
        evaluations=evaluations,
        file=out / "evaluations.jsonl",
        amplitudes=amplitudes,
        noise_seeds=noise_seeds,
        seed=seed,
        jobs=jobs,
    )
    best = min(tried, key=lambda evaluation: evaluation.score)
    if best.failure is not None:
        return None
    body = spaces[0].base.replace(**best.body)
    result = {
        "score": SCORE,
        "settings": {
            "evaluations_each_space": evaluations,
            "population": POPULATION,
            "seed": seed,
            "initial_steps": INITIAL,
            "range_degrees": RANGE,
            "amplitudes_degrees": dict(amplitudes or {}),
            "teacher_steps": TEACHER_STEPS if amplitudes else None,
            "noise_seeds": noise_seeds,
            "closed_steps": CLOSED_STEPS if noise_seeds else None,
            "bounds": {name: asdict(number) for name, number in OPEN_NUMBERS.items()},
        },
        "best": asdict(best),
        "measured_again": measure_again(body, starts),
        "spaces": [_summarise(space, tried) for space in spaces],
        "body": body.to_dict(),
        "versions": package_versions("octoarm-env", "octoarm-agents", "cma", "numpy"),
        "machine": describe_machine(),
    }
    write_atomically(out / "calibration.png", draw_calibration(tried, spaces).savefig)
    write_json(out / "body.json", body.to_dict())
    write_json(out / "calibration.json", result)
    return result


def measure_again(body: ArmParameters, starts: Sequence[int]) -> dict[str, Any]:
    """Task 1 with several T_ini.

    Args:
        body: to measure.
        starts: T_ini of each run.

    Returns:
        ``initial_steps``; ``ratios``, one {task: ratio} a run, None for one that left the domain;
        ``mean_ratios`` and their ``score``, None if any did.

    Raises:
        ValueError: a body that cannot rest, or of another timestep than the paper's.
    """
    measured = measure_task1([Arm(body)] * len(starts), starts)
    ratios = [None if isinstance(each, DomainError) else each for each in measured]
    whole = [each for each in ratios if each is not None]
    mean = None
    if len(whole) == len(starts):
        mean = {task: float(np.mean([each[task] for each in whole])) for task in TASKS}
    return {
        "initial_steps": list(starts),
        "ratios": ratios,
        "mean_ratios": mean,
        "score": None if mean is None else score_ratios(mean),
    }


def _summarise(space: SearchSpace, tried: Sequence[Evaluation]) -> dict[str, Any]:
    """What one of the searches was, and came to."""
    mine = [evaluation for evaluation in tried if space.holds(evaluation.body)]
    best = min(mine, key=lambda evaluation: evaluation.score)
    return space.readings | {
        "tilt": space.tilt,
        "evaluations": len(mine),
        "failures": sum(evaluation.failure is not None for evaluation in mine),
        "best": asdict(best),
    }
