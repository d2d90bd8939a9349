"""The paper's tables and figures, one module each (sections 3.1 and 3.2)."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from octoarm_agents.experiments.runner import Experiment

__all__ = ["EXPERIMENTS", "load_experiment"]

EXPERIMENTS: dict[str, str] = {
    "table2": "Errors of the three emulation tasks, beside baselines.",
    "figure4": "Input, spring lengths and outputs of one trial over time.",
    "figure5a": "Errors of the emulation tasks against the range R.",
    "figure5b": "What each compartment contributes to the trained readout.",
    "figure5c": "What a training without one compartment loses.",
    "limit-cycles": "Figures 6 to 8: three limit cycles held in closed loop.",
    "figure9": "Recovery of the quadratic limit cycle from noise.",
    "figure10": "Recovery of the Lissajous curve from noise.",
    "figure11": "Noise from which the Lissajous curve does not recover.",
    "figure12": "Weights of the readouts that hold the limit cycles.",
    "figure13": "How a disturbance of one step goes on, and where in the arm.",
    "floquet": "What decides whether a cycle is held: exponents of the loop.",
}
"""Every experiment in a line. ``name-of-it`` is the module ``name_of_it`` of this package."""


def load_experiment(name: str) -> Experiment:
    """The experiment of that name.

    Raises:
        ValueError: there is none.
    """
    if name not in EXPERIMENTS:
        raise ValueError(f"no experiment {name!r}: expected one of {', '.join(EXPERIMENTS)}")
    module = import_module(f"octoarm_agents.experiments.{name.replace('-', '_')}")
    experiment: Experiment = module.EXPERIMENT
    return experiment
