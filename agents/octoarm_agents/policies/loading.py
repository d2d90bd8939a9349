"""The policies that come with this distribution, by agent and target."""

from __future__ import annotations

from pathlib import Path

from octoarm_agents.common.environment import TARGETS
from octoarm_agents.policies.policy import Policy

TRAINED_FOLDER = Path(__file__).parent.parent / "trained"
"""A folder for each target, with the scores of all in trained.json; and one of who reaches."""

load_policy = Policy.load


def load_trained(agent: str, target: str) -> Policy:
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
    files = (path for target in TARGETS for path in (TRAINED_FOLDER / target).glob("*.npz"))
    return {(path.stem, path.parent.name): path for path in sorted(files)}
