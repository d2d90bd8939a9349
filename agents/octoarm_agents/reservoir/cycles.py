"""What each limit cycle of task 2 is taught and disturbed with (section 3.2)."""

from __future__ import annotations

from octoarm_agents.reservoir.teaching import Teaching

TRAININGS = ("plain", "weighted")

CYCLES: dict[str, dict[str, Teaching]] = {
    "quadratic": {
        "plain": Teaching("quadratic", 90.0, 1e-6, sampled=True),
        "weighted": Teaching(
            "quadratic", 90.0, 1.17e-09, (0.00134, 0.000204, 0.000332, 3.62e-05, 3.59e-05, 0.000338)
        ),
    },
    "van_der_pol": {
        "plain": Teaching("van_der_pol", 130.0, 1.5e-6, sampled=True),
        "weighted": Teaching(
            "van_der_pol", 130.0, 1e-09, (2.8e-05, 1.45e-05, 0.000433, 0.000445, 7.25e-05, 5.09e-05)
        ),
    },
    "lissajous": {
        "plain": Teaching("lissajous", 10.0, 1e-11, sampled=True),
        "weighted": Teaching(
            "lissajous", 10.0, 1.05e-09, (0.000389, 0.0118, 0.0333, 0.00978, 0.00597, 0.0124)
        ),
    },
}
"""How the readout of each cycle is taught: "plain" is the paper's training at the paper's
R [degrees] and ν [m] (Figures 6 to 8), "weighted" the ridge at the same R, whose ν [m] and sizes κ
of the disturbances [degrees] `octoarm calibrate cycle` found."""

CYCLE_LABELS = {
    "quadratic": "quadratic limit cycle",
    "van_der_pol": "Van der Pol limit cycle",
    "lissajous": "Lissajous curve",
}

PAPER_FINDINGS = {
    "quadratic": "Almost a complete fit with the target, stable for 1,000,000 timesteps; recovers"
    " from noise of 10, 5 and 1 degrees.",
    "van_der_pol": "Not the target trajectory but an irregular one, which changes with each cycle"
    " throughout the trial.",
    "lissajous": "Almost a complete fit with the target, stable for 1,000,000 timesteps; recovers"
    " from noise of 0.3, 0.15 and 0.1 degrees, but not always.",
}
"""What section 3.2 reports."""

NEIGHBOURS = (1e-10, 1e-9, 1e-8, 1e-7, 1e-6)
"""ν at which the plain training is tried beside the paper's own [m]; 1e-11 lies below the rounding
of most sums, so that last bits decide which loop results."""

PAPER_BURSTS = {
    "quadratic": (10.0, 5.0, 1.0),
    "van_der_pol": (10.0, 5.0, 1.0),
    "lissajous": (0.3, 0.15, 0.1),
}
"""ε of Figures 9 and 10: half width of the noise on both outputs [degrees]. The paper disturbs no
Van der Pol cycle: it gets the quadratic one's."""

BURSTS = (0.1, 0.15, 0.3, 1.0, 3.0, 5.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
"""The ladder of ε on which the largest that a cycle recovers from is looked for [degrees]."""
