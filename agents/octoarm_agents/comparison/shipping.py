"""The agents that a comparison leaves behind, with their scores."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from octoarm_agents.common.files import write_json
from octoarm_agents.common.provenance import package_versions
from octoarm_agents.comparison.measuring import TestPlan
from octoarm_agents.comparison.rows import Outcome


def ship(outcomes: Sequence[Outcome], plan: TestPlan, folder: Path) -> None:
    """Copy of every agent and target the training that the judging seeds favour; list them."""
    entries = []
    for outcome in outcomes:
        if not outcome.runs:
            continue
        run, training, measures = max(
            zip(outcome.runs, outcome.trainings, outcome.measures, strict=True),
            key=lambda each: each[1]["best"]["return"],
        )
        file = folder / run.target / f"{run.agent}{run.policy.suffix}"
        file.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(run.policy, file)
        entries.append(
            {
                "agent": run.agent,
                "target": run.target,
                "file": f"{run.target}/{file.name}",
                "seed": run.seed,
                "command": run.command,
                "samples": training["best"]["steps"],
                "return": measures["return"],
                "tracking_error": measures["tracking_error"],
            }
        )
    folder.mkdir(parents=True, exist_ok=True)
    content = {
        "evaluation": {"episodes": plan.episodes, "seed": plan.seed, "steps": plan.steps},
        "agents": entries,
        "versions": package_versions("octoarm-env", "octoarm-agents"),
    }
    write_json(folder / "trained.json", content)
