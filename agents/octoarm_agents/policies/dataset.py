"""Episodes of an agent as a Minari data set, to learn from without the arm.

[Minari](https://minari.farama.org) is Gymnasium's format for offline reinforcement learning and
imitation; its packages are in the extra ``dataset`` of octoarm-agents.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium as gym
import minari
import numpy as np
from minari.data_collector import EpisodeBuffer
from minari.dataset.minari_dataset import parse_dataset_id
from minari.dataset.minari_storage import MinariStorage
from minari.namespace import create_namespace, list_local_namespaces
from minari.storage import get_dataset_path

from octoarm_agents.common.environment import ENV_ID, make_vector_env
from octoarm_agents.common.files import atomic_file
from octoarm_agents.common.provenance import package_versions
from octoarm_agents.common.whole import whole_fields
from octoarm_agents.policies.evaluation import Home, Trivial, acting
from octoarm_agents.policies.rollout import Episodes, PolicyPredictor, Push

_PACKAGES = ("octoarm-env", "octoarm-agents", "gymnasium", "minari", "numpy")

_ROWS = 100_000
"""Rows of lengths that are held in memory, 640 bytes each with the default body."""

_SIDE_BY_SIDE = 64
"""Episodes at once, where they are short enough."""


@dataclass(frozen=True)
class DatasetSettings:
    """Which episodes a data set holds.

    Attributes:
        episodes: how many.
        steps: of each, control periods.
        seed: episode i begins with seed + i; all else that is random is drawn from it too.
        action_noise: half width of white noise that is added to the base's command [degrees]. The
            data set has the actions with the noise, as they were done.
    """

    episodes: int = 100
    steps: int = 500
    seed: int = 0
    action_noise: float = 0.0

    def __post_init__(self) -> None:
        whole_fields(self, episodes=1, steps=1, seed=0)
        if not 0 <= self.action_noise < float("inf"):
            raise ValueError(
                f"action_noise = {self.action_noise}: expected a number of degrees, not negative"
            )


def record_dataset(
    name: str,
    policy: PolicyPredictor | Trivial,
    home: Home,
    settings: DatasetSettings = DatasetSettings(),
    *,
    algorithm: str = "",
    progress: Callable[[int], object] = lambda _: None,
) -> minari.MinariDataset:
    """Let an agent act, and write what happens as a data set of Minari's.

    It appears whole or not at all, in the folder that the environment variable
    ``MINARI_DATASETS_PATH`` names, ``~/.minari/datasets`` without it. Observations, actions,
    rewards and ends are those of the environment, and so are the infos, all numbers. The data set
    knows the environment: `minari.MinariDataset.recover_environment` makes it again.

    Args:
        name: the data set's, as ``"octoarm/quadratic/clock-v0"``.
        policy: the agent, or ``"hold"``, ``"clock"`` or ``"random"``.
        home: whose body and environment are used; mostly `policy` itself.
        settings: which episodes.
        algorithm: what made the agent, for the data set's description.
        progress: called with the number of steps that have been recorded since the last call.

    Returns:
        The data set, the same for the same arguments, to the bit.

    Raises:
        ValueError: a name that Minari does not take or that is taken, or numbers out of range.
        OSError: the folder cannot be written to.
    """
    namespace = parse_dataset_id(name)[0]
    folder = Path(get_dataset_path(name))
    if folder.exists():
        raise ValueError(f"name = {name!r}: {folder} exists; choose another name or version")
    env = gym.make(ENV_ID, arm=home.parameters, **home.settings, max_episode_steps=settings.steps)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(folder) as hidden:
        hidden.mkdir()
        storage = MinariStorage.new(
            hidden / "data",
            observation_space=env.observation_space,
            action_space=env.action_space,
            env_spec=env.spec,
        )
        storage.update_metadata(
            {
                "dataset_id": name,
                "minari_version": minari.__version__,
                "algorithm_name": algorithm,
                "description": f"{algorithm or 'An agent'} on the soft robotic octopus arm.",
                "requirements": [f"octoarm-env=={version('octoarm-env')}"],
                "recording": asdict(settings) | {"versions": package_versions(*_PACKAGES)},
            }
        )
        storage.update_episodes(_record(policy, home, settings, progress))
    if namespace is not None and namespace not in list_local_namespaces():
        create_namespace(namespace)
    return minari.load_dataset(name)


def _record(
    policy: PolicyPredictor | Trivial,
    home: Home,
    settings: DatasetSettings,
    progress: Callable[[int], object],
) -> Iterator[EpisodeBuffer]:
    """The episodes, one after the other; some of them side by side."""
    steps = settings.steps
    at_once = max(1, min(_SIDE_BY_SIDE, _ROWS // steps))
    shaken = Push(settings.action_noise, 0, steps, white=True) if settings.action_noise else None
    for first in range(0, settings.episodes, at_once):
        count, seed = min(at_once, settings.episodes - first), settings.seed + first
        envs = make_vector_env(count, home.parameters, home.settings, steps=steps)
        try:
            agent = acting(policy, envs, seed=seed)
            episodes = Episodes(agent, envs, seed=seed, steps=steps, push=shaken)
            lengths, infos = [episodes.lengths], [_numbers(episodes.infos)]
            commands = []
            for _ in range(steps):
                commands.append(episodes.step())
                lengths.append(episodes.lengths)
                infos.append(_numbers(episodes.infos))
                progress(count)
        finally:
            envs.close()
        done = episodes.rollout
        for index in range(count):
            length = int(done.alive[:, index].sum())
            failed = bool(done.failed[index])
            ends = np.arange(length) == length - 1
            yield EpisodeBuffer(
                seed=seed + index,
                observations=np.array([each[index] for each in lengths[: length + 1]]),
                actions=np.array([each[index] for each in commands[:length]]),
                rewards=done.rewards[:length, index],
                terminations=ends & failed,
                truncations=ends & (not failed),
                infos={
                    key: np.array([each[key][index] for each in infos[: length + 1]])
                    for key in infos[0]
                },
            )


def _numbers(infos: dict[str, Any]) -> dict[str, Any]:
    """What every step tells: no reason of a failure, and no mark of whom an info is about."""
    return {key: each for key, each in infos.items() if each.dtype.kind in "fi"}
