"""The body as a reservoir: targets, linear readout, measures (section 2.2 of the paper)."""

from octoarm_agents.reservoir.orbit import orbit_distance, turn_time
from octoarm_agents.reservoir.policy import ReadoutPolicy, train_policy
from octoarm_agents.reservoir.readout import Readout
from octoarm_agents.reservoir.readout_file import SavedReadout, load_readout, save_readout

__all__ = [
    "Readout",
    "ReadoutPolicy",
    "SavedReadout",
    "load_readout",
    "orbit_distance",
    "save_readout",
    "train_policy",
    "turn_time",
]
