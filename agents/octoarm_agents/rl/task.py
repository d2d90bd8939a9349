"""What is to be trained, whichever library trains it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from octoarm_agents.common.whole import whole_fields
from octoarm_agents.policies.evaluation import JUDGED_EPISODES
from octoarm_agents.rl.hyperparameters import Hyperparameters, algorithm_class


@dataclass(frozen=True)
class Training:
    """What is to be trained.

    Attributes:
        algorithm: one of `octoarm_agents.rl.ALGORITHMS`.
        target: of the environment.
        steps: environment steps over all environments.
        seed: of networks, exploration and environments.
        num_envs: environments that are stepped together.
        evaluations: number of evaluations, at equal intervals.
        episodes: of each evaluation.
        env: further arguments of the environment.
        hyperparameters: as in their file, under the environment's id.
        noise: half width of white noise on the lengths that are trained with [m]; evaluations have
            none.

    Raises:
        ValueError: a number out of its range, or an unknown algorithm.
    """

    algorithm: str
    target: str
    steps: int
    seed: int
    num_envs: int
    evaluations: int
    episodes: int
    env: dict[str, Any]
    hyperparameters: dict[str, Any]
    noise: float = 0.0

    def __post_init__(self) -> None:
        algorithm_class(self.algorithm)
        if not 0 <= self.noise < 1:
            raise ValueError(f"noise = {self.noise}: expected a number of metres from 0 to 1")
        whole_fields(self, steps=1, seed=0, num_envs=1, evaluations=1, episodes=1)

    @classmethod
    def make(
        cls,
        algorithm: str,
        target: str,
        *,
        steps: int | None = None,
        seed: int = 0,
        num_envs: int | None = None,
        evaluations: int = 20,
        episodes: int = JUDGED_EPISODES,
        env: Mapping[str, Any] | None = None,
        hyperparameters: Hyperparameters | None = None,
        noise: float = 0.0,
    ) -> Training:
        """Describe a training; what is not given stands in the algorithm's own file."""
        given = hyperparameters or Hyperparameters.load(algorithm)
        return cls(
            algorithm,
            target,
            given.steps if steps is None else steps,
            seed,
            given.num_envs if num_envs is None else num_envs,
            evaluations,
            episodes,
            dict(env or {}),
            given.entries(),
            noise,
        )

    def plain(self) -> dict[str, Any]:
        """Itself as it reads in JSON."""
        content = asdict(self)
        if not isinstance(self.env.get("arm", ""), str):
            content["env"] = {**self.env, "arm": self.env["arm"].to_dict()}
        plain: dict[str, Any] = json.loads(json.dumps(content, allow_nan=False))
        return plain


CHECKPOINTS = {"sb3": "checkpoint.zip", "rllib": "rllib_checkpoint.pkl"}
"""The file, in a training's folder, from which each engine goes on."""


def open_folder(out: Path, engine: str, resume: bool) -> Path:
    """Make the folder of a training, and give the name of its checkpoint, which may be there.

    Raises:
        ValueError: the folder holds a training of another engine, or one and `resume` is not asked
            for.
        OSError: the folder cannot be made.
    """
    out.mkdir(parents=True, exist_ok=True)
    for other, name in CHECKPOINTS.items():
        if other != engine and (out / name).exists():
            raise ValueError(f"{out} holds a training by {other}: choose another folder")
    checkpoint = out / CHECKPOINTS[engine]
    if checkpoint.exists() and not resume:
        raise ValueError(f"{out} holds a training: resume it (--resume), or choose another folder")
    return checkpoint


def finished_summary(out: Path, saved: dict[str, Any], steps: int) -> dict[str, Any] | None:
    """What a training that has ended left; None if it has not made so many steps."""
    curve = saved["curve"]
    if not curve or curve[-1]["steps"] < steps:
        return None
    try:
        summary: dict[str, Any] = json.loads((out / "training.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return summary


def check_same(
    file: Path, saved: dict[str, Any], wanted: dict[str, Any], extended: bool = False
) -> None:
    """Raise a ValueError where two trainings differ, but for their length if one is extended."""
    saved = {"noise": 0.0, **saved}  # of before there was any
    if extended:
        saved, wanted = (_without_length(each) for each in (saved, wanted))
    found = [
        f"{name} is {saved.get(name)!r} there and {value!r} here"
        for name, value in wanted.items()
        if saved.get(name) != value
    ]
    if found:
        raise ValueError(f"{file} is of another training: {'; '.join(found)}")


def _without_length(training: dict[str, Any]) -> dict[str, Any]:
    """A training but for what says how long it is and how often it is looked at."""
    rest = {key: training[key] for key in training if key not in ("steps", "evaluations")}
    given = rest["hyperparameters"]
    return rest | {"hyperparameters": {key: given[key] for key in given if key != "n_timesteps"}}
