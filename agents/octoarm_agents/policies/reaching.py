"""Who reaches with muscles, and how well: the reachable set, plain baselines, trained networks."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octoarm_agents.common.files import atomic_file
from octoarm_agents.common.provenance import package_versions
from octoarm_agents.policies.loading import TRAINED_FOLDER
from octoarm_agents.policies.network import Network
from octoarm_env.arrays import Float
from octoarm_env.reach import (
    BendPropagation,
    OctoArmReachVectorEnv,
    ReachSettings,
    reachable_goals,
)

KEYS = ("achieved_goal", "desired_goal", "observation")
"""Parts of an observation in the order in which a network takes them."""

HELD = 20
"""Steps at the end that the tip must stay at the goal to have been held there: one second."""

_TOGETHER = 512
"""Arms that are sampled together."""
_CUBE = 0.012
"""Edge of the cubes in which one goal is kept [m]."""
_FORMAT = "octoarm-goal-policy"


def train_goals() -> Float:
    """Four fifths of the shipped goals, to learn on, (K, 3) [m]."""
    return np.delete(reachable_goals(), np.s_[::5], axis=0)


def held_out_goals() -> Float:
    """The other fifth, on which nothing is trained, (K, 3) [m]."""
    return reachable_goals()[::5]


def validation_goals() -> Float:
    """Every fifth of `train_goals`, by which a search for hyper-parameters judges, (K, 3) [m]."""
    return train_goals()[::5]


def search_goals() -> Float:
    """The other four fifths of `train_goals`, on which such a search trains, (K, 3) [m]."""
    return np.delete(train_goals(), np.s_[::5], axis=0)


def sample_reachable(
    count: int, seed: int, progress: Callable[[int], Any] | None = None
) -> tuple[Float, Float]:
    """Hold activations, drawn at random, for five seconds from rest, and see where the tip is.

    The side to which a segment bends wanders along the arm. Half of the arms are bent evenly more
    or less, half of them have transverse muscles at work.

    Args:
        count: of samples; rounded up to a multiple of 512.
        seed: of the draws.
        progress: called with the samples just made.

    Returns:
        The activations (K, 25), and where the tips are, (K, 3) [m].
    """
    generator = np.random.default_rng(seed)
    activations: list[Any] = []
    tips: list[Float] = []
    for _ in range(-(-count // _TOGETHER)):
        action = _draw_activations(generator, _TOGETHER, ReachSettings().segments)
        arms = OctoArmReachVectorEnv(_TOGETHER, max_episode_steps=None)
        arms.reset(seed=0)
        for _ in range(100):
            seen, *_ = arms.step(action)
        activations.append(action)
        tips.append(seen["achieved_goal"])
        if progress is not None:
            progress(_TOGETHER)
    return np.concatenate(activations), np.concatenate(tips)


def _draw_activations(generator: np.random.Generator, arms: int, segments: int) -> Any:
    size = generator.uniform(0, 1, (arms, segments))
    side = generator.uniform(0, 2 * np.pi, (arms, 1))
    side = side + np.cumsum(generator.normal(0, 0.6, (arms, segments)), axis=1)
    quarters = np.arange(4) * np.pi / 2
    along = np.clip(size[..., None] * np.cos(side[..., None] - quarters), 0, 1)
    evenly = generator.random((arms, 1, 1)) < 0.5
    largest = np.maximum(along.max(axis=(1, 2), keepdims=True), 1e-9)
    strength = np.sqrt(generator.uniform(0, 1, (arms, 1, 1)))
    along = np.where(evenly, along / largest * strength, along)
    across = generator.uniform(0, 1, (arms, segments)) * (generator.random((arms, 1)) < 0.5)
    action = np.concatenate((along, across[..., None]), axis=2)
    return action.reshape(arms, -1).astype(np.float32)


def thin(points: Float) -> Float:
    """Keep the first point in every cube of 12 mm, (K, 3) [m]."""
    _, first = np.unique(np.floor(points / _CUBE), axis=0, return_index=True)
    kept: Float = np.round(points[np.sort(first)], 5)
    return kept


class HoldStill:
    """No muscle is ever active."""

    def predict(self, observation: Mapping[str, Any]) -> tuple[NDArray[np.float32], None]:
        """Give actions (n, 25)."""
        return np.zeros((len(observation["desired_goal"]), 25), np.float32), None


class RandomMuscles:
    """Every activation is drawn anew at each step.

    Args:
        seed: of the draws.
    """

    def __init__(self, seed: int = 0) -> None:
        self._generator = np.random.default_rng(seed)

    def predict(self, observation: Mapping[str, Any]) -> tuple[NDArray[np.float32], None]:
        """Give actions (n, 25)."""
        count = len(observation["desired_goal"])
        return self._generator.random((count, 25), np.float32), None


class Nearest:
    """Holds what has brought the tip nearest to the goal in some samples; sees nothing of the arm.

    Args:
        count: of samples.
        seed: of the samples, other than those of the goals.
    """

    def __init__(self, count: int = 2048, seed: int = 1) -> None:
        self._activations, self._tips = sample_reachable(count, seed)

    def predict(self, observation: Mapping[str, Any]) -> tuple[NDArray[np.float32], None]:
        """Give actions (n, 25)."""
        ways = observation["desired_goal"][:, None] - self._tips
        nearest = np.linalg.norm(ways, axis=2).argmin(axis=1)
        actions: NDArray[np.float32] = self._activations[nearest]
        return actions, None


@dataclass(eq=False, repr=False)
class GoalPolicy:
    """A trained network that reaches; signature of a stable-baselines3 policy.

    Attributes:
        network: from tip, goal and lengths to an action in [-1, 1], which is scaled to [0, 1].
        settings: of the environment that it was trained in, but for its goals.
        training: how it was trained, plain numbers and texts.
    """

    network: Network
    settings: ReachSettings
    training: dict[str, Any] = field(default_factory=dict)

    def predict(
        self,
        observation: Mapping[str, Any],
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Any]:
        """Give the action for an observation, or one for each of several.

        Args:
            observation: a mapping as ``OctoArmReach-v0`` gives it.
            state: given back; there is no memory.
            episode_start: not used.
            deterministic: not used; it always is.

        Returns:
            The action, (muscles,) or (n, muscles) float32 in [0, 1], and `state`.
        """
        del episode_start, deterministic
        parts = [np.asarray(observation[key], np.float64) for key in KEYS]
        alone = parts[0].ndim == 1
        inputs = np.concatenate([np.atleast_2d(part) for part in parts], axis=1)
        found, _ = self.network.actions(inputs, None)
        actions: NDArray[np.float32] = (found + np.float32(1)) / np.float32(2)
        return actions[0] if alone else actions, state

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a file .npz, which appears whole or not at all."""
        if Path(path).suffix != ".npz":
            raise ValueError(f"path = {path}: expected a name that ends in .npz")
        header = {
            "format": _FORMAT,
            "network": self.network.describe(),
            "settings": self.settings.to_dict() | {"goals": None},
            "training": self.training,
            "versions": package_versions(
                "octoarm-env", "octoarm-agents", "numpy", "stable-baselines3", "torch"
            ),
        }
        arrays: dict[str, Any] = self.network.arrays()
        with atomic_file(Path(path)) as file:
            np.savez_compressed(file, description=np.array(json.dumps(header)), **arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> GoalPolicy:
        """Read what `save` has written.

        Raises:
            ValueError: no such file, or one that is damaged.
            OSError: the file cannot be read.
        """
        try:
            with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
            header = json.loads(str(arrays.pop("description")))
            if header["format"] != _FORMAT:
                raise ValueError(f"format = {header['format']!r}, expected {_FORMAT!r}")
            network = Network.restore(header["network"], arrays)
            return cls(network, ReachSettings.from_dict(header["settings"]), header["training"])
        except (KeyError, TypeError, EOFError, ValueError, zipfile.BadZipFile, zlib.error) as error:
            raise ValueError(f"{path} is no policy that reaches: {error}") from None


def load_reaching() -> GoalPolicy:
    """Load the agent that reaches and comes with this distribution: SAC, seed 0."""
    return GoalPolicy.load(TRAINED_FOLDER / "reaching" / "sac.npz")


def evaluate_reaching(
    policy: Any,
    goals: Float | None = None,
    steps: int = 100,
    settings: ReachSettings | None = None,
) -> dict[str, float]:
    """Let a policy reach for every goal once.

    Args:
        policy: with ``predict(observations)`` for a batch; or a function that makes one for a
            vector environment.
        goals: (K, 3) [m]; None: `held_out_goals`.
        steps: of an episode.
        settings: of the environment; None: the default ones.

    Returns:
        ``success``: share whose tip is within the threshold at the end; ``held``: all through the
        last second; ``ever``: at any time; ``distance``: median at the end [m].
    """
    goals = held_out_goals() if goals is None else goals
    given = {} if settings is None else settings.to_dict()
    arms = OctoArmReachVectorEnv(
        len(goals), **(given | {"goals": goals, "vary": given.get("vary") or None}),
        max_episode_steps=None,
    )  # fmt: skip
    arms.reset(seed=0)
    for index, goal in enumerate(goals):
        mask = np.zeros(len(goals), np.bool_)
        mask[index] = True
        seen, _ = arms.reset(options={"reset_mask": mask, "goal": tuple(goal)})
    acting = policy(arms) if callable(policy) else policy
    distances = []
    for _ in range(steps):
        action, _ = acting.predict(seen)
        seen, _, _, _, infos = arms.step(action)
        distances.append(infos["distance"])
    near = np.array(distances) <= arms.settings.distance_threshold
    return {
        "success": float(near[-1].mean()),
        "held": float(near[-HELD:].all(axis=0).mean()),
        "ever": float(near.any(axis=0).mean()),
        "distance": float(np.median(distances[-1])),
    }


BASELINES: dict[str, Callable[[Any], Any]] = {
    "still": lambda arms: HoldStill(),
    "random": lambda arms: RandomMuscles(),
    "wave": BendPropagation,
    "nearest": lambda arms: Nearest(),
}
"""Makers of the plain baselines by their names."""
