"""The body as a reservoir: targets, linear readout, teaching, closed loop (section 2.2)."""

from octoarm_agents.common.orbit import orbit_distance, turn_time
from octoarm_agents.reservoir.aggregation import aggregated_policy
from octoarm_agents.reservoir.closed_loop import ClosedLoop, release
from octoarm_agents.reservoir.floquet import floquet_exponents
from octoarm_agents.reservoir.loop_design import LoopModel, design, design_policy, weighted_policy
from octoarm_agents.reservoir.policy import ReadoutPolicy, readout_network, train_policy
from octoarm_agents.reservoir.readout import Readout
from octoarm_agents.reservoir.teaching import Taught, Teaching, teach
from octoarm_agents.reservoir.tuning import Tuned, tune

__all__ = [
    "ClosedLoop",
    "LoopModel",
    "Readout",
    "ReadoutPolicy",
    "Taught",
    "Teaching",
    "Tuned",
    "aggregated_policy",
    "design",
    "design_policy",
    "floquet_exponents",
    "orbit_distance",
    "readout_network",
    "release",
    "teach",
    "train_policy",
    "tune",
    "turn_time",
    "weighted_policy",
]
