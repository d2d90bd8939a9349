"""Figure 9: recovery of the quadratic limit cycle from noise on the outputs (section 3.2)."""

from __future__ import annotations

from typing import Any

from octoarm_agents.experiments.bursts import burst_tables, draw_bursts, run_bursts
from octoarm_agents.experiments.runner import Context, Experiment
from octoarm_agents.experiments.task2 import TRIALS

__all__ = ["EXPERIMENT"]


def run(context: Context) -> dict[str, Any]:
    """Disturb the cycle with noise of three sizes."""
    return run_bursts(context, "quadratic")


EXPERIMENT = Experiment("figure9", TRIALS, run, draw_bursts, burst_tables)
