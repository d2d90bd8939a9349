"""What an experiment is, what it is run with, and how its files come about."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from octoarm_agents.common.files import write_atomically, write_json
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.trials import Record, Settings, Trial, run_trials
from octoarm_agents.common.whole import whole_fields
from octoarm_env import ArmParameters

__all__ = ["Context", "Experiment", "ResultTable", "reproduce"]


@dataclass(frozen=True)
class ResultTable:
    """A table for the terminal.

    Attributes:
        title: above it.
        columns: headings.
        rows: cells, as many a row as there are columns.
        notes: lines below it.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str] = ()


@dataclass(frozen=True)
class Context:
    """What an experiment is run with.

    Attributes:
        out: folder for NAME.json and NAME.png, and for the finished trials in ``.NAME-trials``.
        trials: how many; None: the experiment's own number.
        seed: of everything random; trial k draws from (seed, k).
        jobs: processes.
        amplitude: R [degrees]; None: the experiment's own.
        steps: physics steps of the closed loop; None: the experiment's own number.
        parameters: the body.
        progress: as `shown` of `octoarm_agents.common.progress.progress_bar`.
        fresh: compute every trial anew, even if it is stored.
    """

    out: Path
    trials: int | None = None
    seed: int = 0
    jobs: int = 1
    amplitude: float | None = None
    steps: int | None = None
    parameters: ArmParameters = field(default_factory=ArmParameters)
    progress: bool | None = None
    fresh: bool = False

    def __post_init__(self) -> None:
        whole_fields(self, trials=1, seed=0, jobs=1, steps=1)

    def run(
        self,
        name: str,
        function: Trial,
        settings: Sequence[Settings],
        record: Record | None = None,
    ) -> list[dict[str, Any]]:
        """Call ``function(parameters, **settings)`` for all settings; see `run_trials`.

        Args:
            name: of the experiment, whose folder of finished trials is used.
            function: one trial, in a module that draws nothing: a change of it, or of what it
                imports, makes the stored trials invalid.
            settings: keyword arguments of each trial.
            record: computes together what several trials need; None: each is by itself.

        Returns:
            The results, in order.
        """
        return run_trials(
            function,
            self.parameters,
            settings,
            record=record,
            folder=self.out / f".{name}-trials",
            jobs=self.jobs,
            fresh=self.fresh,
            progress=self.progress,
            description=name,
        )

    def describe(self, name: str) -> dict[str, Any]:
        """What a result was computed with: settings, body, versions, machine and command."""
        command = f"octoarm reproduce {name} --trials {self.trials} --seed {self.seed}"
        if self.amplitude is not None:
            command += f" --amplitude {self.amplitude:g}"
        if self.steps is not None:
            command += f" --steps {self.steps}"
        if self.parameters != ArmParameters():
            command += " --arm body.json"
        return {
            "command": command,
            "seed": self.seed,
            "body": self.parameters.to_dict(),
            "versions": package_versions(
                "octoarm-env",
                "octoarm-agents",
                "numpy",
                "scipy",
                "scikit-learn",
                "reservoirpy",
                "matplotlib",
            ),
            "machine": describe_machine(),
        }


@dataclass(frozen=True)
class Experiment:
    """One table or figure of the paper; every module of an experiment has one as ``EXPERIMENT``.

    Attributes:
        name: as on the command line; the files are called so too.
        trials: how many it makes when nothing else is asked for.
        run: the result, plain numbers for a JSON file, under a context whose `trials` is a number.
        draw: writes the figure of a result to a path.
        tables: a result for the terminal.
    """

    name: str
    trials: int
    run: Callable[[Context], dict[str, Any]]
    draw: Callable[[Mapping[str, Any], Path], None]
    tables: Callable[[Mapping[str, Any]], Sequence[ResultTable]]


def reproduce(experiment: Experiment, context: Context) -> dict[str, Any]:
    """Run an experiment, and write its files NAME.json and NAME.png.

    The files appear whole, and only when the experiment has gone to its end.

    Returns:
        What the JSON file holds: the experiment's result and `Context.describe`.

    Raises:
        ValueError: settings or a body that the experiment cannot be run with.
        OSError: the folder cannot be written to.
    """
    context.out.mkdir(parents=True, exist_ok=True)
    if context.trials is None:
        context = replace(context, trials=experiment.trials)
    result = experiment.run(context) | context.describe(experiment.name)
    picture = context.out / f"{experiment.name}.png"
    write_atomically(picture, lambda path: experiment.draw(result, path))
    write_json(picture.with_suffix(".json"), result)
    return result
