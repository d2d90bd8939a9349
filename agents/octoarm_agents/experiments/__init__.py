"""The paper's tables and figures (sections 3.1 and 3.2), and what it names next (section 4)."""

from __future__ import annotations

from typing import NamedTuple


class Entry(NamedTuple):
    """Where an experiment is found, and what it shows.

    Attributes:
        module: within this package; it holds the `Experiment` under the experiment's name in
            capitals.
        help: a line.
    """

    module: str
    help: str


EXPERIMENTS = {
    "table2": Entry("emulation.table2", "Errors of the three emulation tasks, beside baselines."),
    "figure4": Entry(
        "emulation.figure4", "Input, spring lengths and outputs of one trial over time."
    ),
    "figure5a": Entry("emulation.figure5a", "Errors of the emulation tasks against the range R."),
    "figure5b": Entry(
        "emulation.compartments", "What each compartment contributes to the trained readout."
    ),
    "figure5c": Entry("emulation.compartments", "What a training without one compartment loses."),
    "limit-cycles": Entry(
        "cycles.limit_cycles", "Figures 6 to 8: three limit cycles held in closed loop."
    ),
    "figure9": Entry("cycles.bursts", "Recovery of the quadratic limit cycle from noise."),
    "figure10": Entry("cycles.bursts", "Recovery of the Lissajous curve from noise."),
    "figure11": Entry("cycles.figure11", "Noise from which the Lissajous curve does not recover."),
    "figure12": Entry("cycles.figure12", "Weights of the readouts that hold the limit cycles."),
    "figure13": Entry(
        "cycles.figure13", "How a disturbance of one step goes on, and where in the arm."
    ),
    "floquet": Entry(
        "cycles.floquet", "What decides whether a cycle is held: exponents of the loop."
    ),
    "bend-propagation": Entry(
        "muscles.bend_propagation", "A readout lets a bend travel along the arm (section 4)."
    ),
}
"""Every experiment by its name on the command line."""
