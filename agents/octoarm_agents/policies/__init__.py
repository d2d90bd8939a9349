"""Agents as files: readouts and trained networks, loaded and evaluated alike."""

from octoarm_agents.policies.loading import load_policy, load_trained, trained_agents
from octoarm_agents.policies.network import Lstm, Network
from octoarm_agents.policies.policy import Policy

NetworkPolicy = Policy
"""Its name before readouts were the same."""

__all__ = [
    "Lstm",
    "Network",
    "NetworkPolicy",
    "Policy",
    "load_policy",
    "load_trained",
    "trained_agents",
]
