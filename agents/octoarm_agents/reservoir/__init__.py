"""The body as a reservoir: targets, linear readout, measures (section 2.2 of the paper)."""

from octoarm_agents.reservoir.orbit import orbit_distance, turn_time
from octoarm_agents.reservoir.readout import Readout, fit_readout

__all__ = ["Readout", "fit_readout", "orbit_distance", "turn_time"]
