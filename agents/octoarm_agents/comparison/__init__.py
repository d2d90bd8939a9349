"""Readouts, networks and trivial agents compared: same episodes, several trainings, the cost."""

from octoarm_agents.comparison.agents import AGENTS
from octoarm_agents.comparison.measuring import TestPlan
from octoarm_agents.comparison.pictures import draw_all
from octoarm_agents.comparison.study import Comparison, compare

__all__ = ["AGENTS", "Comparison", "TestPlan", "compare", "draw_all"]
