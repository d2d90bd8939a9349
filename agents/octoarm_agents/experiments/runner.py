"""What an experiment is, what it is run with, and how its files come about."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from octoarm_agents.common.files import write_atomically, write_json
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.common.trials import Record, Settings, Trial, run_trials
from octoarm_agents.common.whole import whole_fields
from octoarm_agents.common.workers import Jobs, number_of
from octoarm_agents.experiments import EXPERIMENTS
from octoarm_agents.experiments.tables import ResultTable
from octoarm_env import ArmParameters

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class RefusedError(ValueError):
    """An experiment cannot be run with this body or these settings; the message says why.

    Told apart from any other `ValueError`, which is an error within.
    """


@dataclass(frozen=True)
class RunSettings:
    """What an experiment is run with.

    Attributes:
        out: folder for NAME.json and NAME.png, and for the finished trials in ``.NAME-trials``.
        trials: how many; None: the experiment's own number.
        seed: of everything random; trial k draws from (seed, k).
        jobs: processes, or a cluster.
        amplitude: R [degrees]; None: the experiment's own.
        steps: physics steps of the closed loop; None: the experiment's own number.
        parameters: the body.
        fresh: compute every trial anew, even if it is stored.
    """

    out: Path
    trials: int | None = None
    seed: int = 0
    jobs: Jobs = 1
    amplitude: float | None = None
    steps: int | None = None
    parameters: ArmParameters = field(default_factory=ArmParameters)
    fresh: bool = False

    def __post_init__(self) -> None:
        whole_fields(self, trials=1, seed=0, steps=1)
        number_of(self.jobs)

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
            function: one trial.
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
            description=name,
        )

    def repeat(
        self,
        name: str,
        function: Trial,
        points: Sequence[Sequence[Settings]],
        record: Record | None = None,
    ) -> list[list[dict[str, Any]]]:
        """Make all trials, of which ``function`` is told seed and number, at each of some points.

        Args:
            name: as in `run`.
            function: one trial.
            points: for each the other settings, several of which take turns over the trials.
            record: as in `run`.

        Returns:
            For each of `points` the results in the order of the trials.
        """
        count = self.trials
        assert count is not None
        settings = [
            {**point[trial % len(point)], "seed": self.seed, "trial": trial}
            for point in points
            for trial in range(count)
        ]
        results = self.run(name, function, settings, record)
        return [results[count * k : count * (k + 1)] for k in range(len(points))]

    def describe(self, name: str) -> dict[str, Any]:
        """What a result was computed with: settings, body, versions, machine and command."""
        command = f"octoarm reproduce {name} --trials {self.trials} --seed {self.seed}"
        if self.amplitude is not None:
            command += f" --amplitude {self.amplitude:g}"
        if self.steps is not None:
            command += f" --steps {self.steps}"
        if self.parameters != ArmParameters():
            command += " --arm body.json"
        packages = ("octoarm-env", "octoarm-agents", "numpy", "scipy", "scikit-learn")
        return {
            "command": command,
            "seed": self.seed,
            "body": self.parameters.to_dict(),
            "versions": package_versions(*packages, "reservoirpy", "matplotlib"),
            "machine": describe_machine(),
        }


@dataclass(frozen=True)
class Experiment:
    """One table or figure of the paper.

    Attributes:
        name: as on the command line; the files are called so too.
        trials: how many it makes when nothing else is asked for.
        run: the result, plain numbers for a JSON file, under settings whose `trials` is a number.
        tables: a result for the terminal.
        draw: the figure of a result.
    """

    name: str
    trials: int
    run: Callable[[RunSettings], dict[str, Any]]
    tables: Callable[[Mapping[str, Any]], Sequence[ResultTable]]
    draw: Callable[[Mapping[str, Any]], Figure]


def load_experiment(name: str) -> Experiment:
    """Give the experiment of that name, one of `EXPERIMENTS`."""
    module = import_module(f"octoarm_agents.experiments.{EXPERIMENTS[name].module}")
    experiment: Experiment = getattr(module, name.replace("-", "_").upper())
    return experiment


def round_numbers(values: NDArray[np.floating]) -> list[Any]:
    """Numbers for a JSON file, to seven digits: they are for looking at."""
    if values.ndim > 1:
        return [round_numbers(row) for row in values]
    return [float(f"{value:.7g}") for value in values]


def reproduce(experiment: Experiment, settings: RunSettings) -> dict[str, Any]:
    """Run an experiment, and write its files NAME.json and NAME.png.

    The files appear whole, and only when the experiment has gone to its end.

    Returns:
        What the JSON file holds: the experiment's result and `RunSettings.describe`.

    Raises:
        RefusedError: settings or a body that the experiment cannot be run with.
        OSError: the folder cannot be written to.
    """
    settings.out.mkdir(parents=True, exist_ok=True)
    if settings.trials is None:
        settings = replace(settings, trials=experiment.trials)
    result = experiment.run(settings) | settings.describe(experiment.name)
    picture = settings.out / f"{experiment.name}.png"
    write_atomically(picture, experiment.draw(result).savefig)
    write_json(picture.with_suffix(".json"), result)
    return result
