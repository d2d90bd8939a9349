"""Agents as files: trained networks beside readouts, loaded and evaluated alike."""

from octoarm_agents.policies.loading import Agent, load_policy, load_trained, trained_agents
from octoarm_agents.policies.network import Lstm, Network, NetworkPolicy
from octoarm_agents.policies.network_file import load_network, save_network
from octoarm_agents.policies.rollout import Policy

__all__ = [
    "Agent",
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
