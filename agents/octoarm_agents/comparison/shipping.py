"""The agents that a comparison leaves behind, with their scores."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

from octoarm_agents.common.files import write_json
from octoarm_agents.common.provenance import package_versions
from octoarm_agents.comparison.measuring import TestPlan
from octoarm_agents.comparison.rows import Outcome


def ship(outcomes: Sequence[Outcome], plan: TestPlan, folder: Path) -> None:
    """Copy of every agent and target the training that the judging seeds favour; list them.

    What is listed there already stays, unless another takes its place.
    """
    file = folder / "trained.json"
    listed = json.loads(file.read_text(encoding="utf-8"))["agents"] if file.exists() else []
    entries = {entry["file"]: entry for entry in listed}
    for outcome in outcomes:
        if outcome.trainings[0] is None:
            continue
        run, training, measures = max(
            zip(outcome.runs, outcome.trainings, outcome.measures, strict=True),
            key=lambda each: each[1]["best"]["return"],  # type: ignore[index]
        )
        name = f"{run.target}/{run.agent}{run.policy.suffix}"
        if not run.policy.exists():  # of an earlier call elsewhere, whose results alone are here
            continue
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(run.policy, folder / name)
        entries[name] = {
            "agent": run.agent,
            "target": run.target,
            "file": name,
            "seed": run.seed,
            "command": run.command,
            "samples": training["best"]["steps"],  # type: ignore[index]
            "return": measures["return"],
            "tracking_error": measures["tracking_error"],
        }
    folder.mkdir(parents=True, exist_ok=True)
    content = {
        "evaluation": {"episodes": plan.episodes, "seed": plan.seed, "steps": plan.steps},
        "agents": list(entries.values()),
        "versions": package_versions("octoarm-env", "octoarm-agents"),
    }
    write_json(file, content)
