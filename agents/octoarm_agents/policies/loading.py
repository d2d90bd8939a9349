"""Any saved agent, readout or network, by its file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import gymnasium as gym

from octoarm_agents.common.environment import check_spaces, differences, inspect_env
from octoarm_agents.policies.network_file import load_network
from octoarm_agents.policies.rollout import Policy
from octoarm_agents.reservoir import ReadoutPolicy
from octoarm_env import ArmParameters

__all__ = ["Agent", "Home", "load_policy", "load_trained", "trained_agents"]

TRAINED_FOLDER = Path(__file__).parent.parent / "trained"
"""The agents that come along, in a folder for each target, and their scores in trained.json."""


class Home(Protocol):
    """Where an agent belongs."""

    @property
    def parameters(self) -> ArmParameters:
        """The body."""

    @property
    def settings(self) -> dict[str, Any]:
        """The environment's, `octoarm_agents.common.environment.SETTINGS`."""


class Agent(Policy, Home, Protocol):
    """What `load_policy` gives: a trained policy that knows where it is at home."""

    seed: int | None

    @property
    def parameter_count(self) -> int:
        """Trained numbers that the action depends on."""


def load_policy(
    path: str | os.PathLike[str],
    env: gym.Env[Any, Any] | None = None,
    *,
    settings: Mapping[str, Any] | None = None,
) -> Agent:
    """Read an agent from its file: a readout (`.json`) or a network (`.npz`).

    Args:
        path: the file.
        env: the environment it is to act in, however wrapped; None: whatever it was trained in.
        settings: or some of that environment's settings, by name.

    Raises:
        ValueError: a file that is damaged, of another kind, version or observation layout, or an
            agent of another environment or body; the message names the file and what differs.
        TypeError: `env` is not an ``OctoArm-v0`` environment.
        OSError: the file cannot be read.
    """
    path = Path(path)
    if path.suffix not in (".json", ".npz"):
        raise ValueError(f"{path}: expected a file of a readout (.json) or of a network (.npz)")
    policy: Agent = ReadoutPolicy.load(path) if path.suffix == ".json" else load_network(path)
    used = dict(settings or {})
    if env is not None:
        check_spaces(env)
        parameters, its_settings = inspect_env(env)
        found = differences(policy.parameters.to_dict(), parameters.to_dict())
        if found:
            raise ValueError(f"{path} is for another body: {found}")
        used = its_settings | used
    found = differences({name: policy.settings[name] for name in used}, used)
    if found:
        raise ValueError(f"{path} is for another environment: {found}")
    return policy


def load_trained(agent: str, target: str) -> Agent:
    """Load one of the trained agents that come with this distribution.

    Args:
        agent: ``"readout_ridge"``, ``"ppo"``, …, see `trained_agents`.
        target: ``"quadratic"``, ``"van_der_pol"`` or ``"lissajous"``.

    Raises:
        ValueError: there is no such agent.
    """
    known = trained_agents()
    if (agent, target) not in known:
        names = ", ".join("/".join(key) for key in sorted(known))
        raise ValueError(f"agent, target = {agent!r}, {target!r}: expected one of {names}")
    return load_policy(known[agent, target])


def trained_agents() -> dict[tuple[str, str], Path]:
    """Files of the agents that come with this distribution, by agent and target."""
    files = [path for path in TRAINED_FOLDER.glob("*/*") if path.suffix in (".json", ".npz")]
    return {(path.stem, path.parent.name): path for path in sorted(files)}
