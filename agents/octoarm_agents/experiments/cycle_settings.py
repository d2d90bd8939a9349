"""What each limit cycle of task 2 is taught and disturbed with (section 3.2)."""

from __future__ import annotations

from octoarm_agents.reservoir.teaching import Teaching

__all__ = [
    "ACTUATORS",
    "CYCLES",
    "CYCLE_LABELS",
    "DIRECT_BURSTS",
    "PAPER_AMPLITUDES",
    "PAPER_BURSTS",
    "PAPER_FINDINGS",
    "PAPER_NOISES",
    "PLAIN_NOISES",
]

ACTUATORS = ("direct", "servo")

_VAN_DER_POL = Teaching("van_der_pol", 30.0, 9.71e-6, (0.0028, 0.016, 0.0056, 0.088, 0.0089, 0.034))

CYCLES: dict[str, dict[str, Teaching]] = {
    "quadratic": {
        "direct": Teaching(
            "quadratic", 50.0, 1.2e-7, (5.3e-5, 1.8e-3, 2.3e-2, 1.5e-3, 3.7e-3, 4.5e-2)
        ),
        "servo": Teaching(
            "quadratic",
            60.0,
            1.1e-9,
            (2.4e-3, 2e-4, 8.4e-3, 2.8e-4, 1e-5, 2.3e-3),
            actuator="servo",
        ),
    },
    "van_der_pol": {
        "direct": Teaching(
            "van_der_pol", 45.0, 1.7e-6, (1e-5, 1.9e-3, 1.3e-3, 7.9e-4, 1.2e-3, 4.4e-4)
        ),
        "servo": Teaching(
            "van_der_pol",
            45.0,
            1.1e-9,
            (3e-3, 3.9e-5, 4.6e-4, 3.2e-4, 3.8e-5, 1.9e-3),
            actuator="servo",
        ),
    },
    "lissajous": {
        "direct": Teaching(
            "lissajous", 10.0, 5.5e-8, (1.7e-3, 6.9e-3, 2.3e-3, 3.3e-2, 2.5e-2, 1e-4)
        ),
        "servo": Teaching(
            "lissajous",
            10.0,
            2.1e-9,
            (2e-3, 5e-4, 6e-3, 1.1e-3, 1.9e-3, 7.6e-4),
            actuator="servo",
        ),
    },
}
"""How the readout of each cycle is taught, by the actuator of the base: amplitude [degrees], ν [m],
sizes of the disturbances [degrees]; `octoarm_agents.reservoir.tuning` found them."""

CYCLE_LABELS = {
    "quadratic": "quadratic limit cycle",
    "van_der_pol": "Van der Pol limit cycle",
    "lissajous": "Lissajous curve",
}

PAPER_AMPLITUDES = {"quadratic": 90.0, "van_der_pol": 130.0, "lissajous": 10.0}
PAPER_NOISES = {"quadratic": 1.0e-6, "van_der_pol": 1.5e-6, "lissajous": 1.0e-11}
"""R [degrees] and ν [m] of Figures 6 to 8."""

PAPER_FINDINGS = {
    "quadratic": "Almost a complete fit with the target, stable for 1,000,000 timesteps; recovers"
    " from noise of 10, 5 and 1 degrees.",
    "van_der_pol": "Not the target trajectory but an irregular one, which changes with each cycle"
    " throughout the trial.",
    "lissajous": "Almost a complete fit with the target, stable for 1,000,000 timesteps; recovers"
    " from noise of 0.3, 0.15 and 0.1 degrees, but not always.",
}
"""What section 3.2 reports."""

PAPER_BURSTS = {"quadratic": (10.0, 5.0, 1.0), "lissajous": (0.3, 0.15, 0.1)}
"""ε of Figures 9 and 10: half width of the noise on both outputs [degrees]."""

DIRECT_BURSTS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 5.0, 10.0)
"""The ladder of ε on which the largest that a direct base recovers from is looked for. Noise
renewed every millisecond is a huge load on a base without inertia [degrees]."""

PLAIN_NOISES = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4)
"""ν tried, beside the paper's own, when the readout is taught as in the paper [m]."""
