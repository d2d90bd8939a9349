"""Agents as files: trained networks beside readouts, loaded and evaluated alike."""

from octoarm_agents.policies.loading import Policy, load_policy, load_trained, trained_agents
from octoarm_agents.policies.network import Lstm, Network, NetworkPolicy
from octoarm_agents.policies.network_file import load_network, save_network

__all__ = [
    "Lstm",
    "Network",
    "NetworkPolicy",
    "Policy",
    "load_network",
    "load_policy",
    "load_trained",
    "save_network",
    "trained_agents",
]
