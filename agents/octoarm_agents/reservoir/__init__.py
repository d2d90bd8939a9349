"""The body as a reservoir: targets, linear readout, measures (Nakajima et al. 2013, section 2.2)."""

from octoarm_agents.reservoir.limit_cycles import LIMIT_CYCLES, LimitCycle
from octoarm_agents.reservoir.orbit import orbit_distance, turn_time
from octoarm_agents.reservoir.readout import Readout, fit_readout

__all__ = ["LIMIT_CYCLES", "LimitCycle", "Readout", "fit_readout", "orbit_distance", "turn_time"]
