"""The small search that chose the echo state network's settings for Task 1.

``python -m octoarm_agents.experiments.emulation.esn_search`` prints the settings of the grid, best
first. They are ranked by the mean over the three tasks and both inputs of log10 of the test error,
on one trial of a seed that no table uses.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from octoarm_agents.experiments.emulation.protocol import INPUTS, TrialInput, score_features
from octoarm_agents.reservoir.baselines import echo_state_network

SEED = 20131
"""Of the trial and of the networks; the default seed of the experiments is 0."""

GRID: dict[str, tuple[float, ...]] = {
    "leak": (0.01, 0.03, 0.1, 0.3, 1.0),
    "spectral_radius": (0.5, 0.8, 0.95, 1.1),
    "input_scaling": (0.03, 0.1, 0.3, 1.0, 3.0),
}


def rank_settings(
    grid: dict[str, tuple[float, ...]] = GRID,
) -> list[tuple[float, dict[str, float]]]:
    """Try every setting of a grid.

    Returns:
        ``(score, settings)`` of each, the best, smallest score first.
    """
    drives = [TrialInput.make(kind, SEED, 0) for kind in INPUTS]
    ranking = []
    for values in itertools.product(*grid.values()):
        settings = dict(zip(grid, values, strict=True))
        logarithms = []
        for drive in drives:
            features = echo_state_network(drive.signal, np.random.default_rng(SEED), **settings)
            scores, _ = score_features(features, drive)
            logarithms += [math.log10(error) for error in scores["test"].values()]
        ranking.append((float(np.mean(logarithms)), settings))
    return sorted(ranking, key=lambda entry: entry[0])


def main() -> None:
    """Print the ranking."""
    for score, settings in rank_settings():
        named = ", ".join(f"{name} {value:g}" for name, value in settings.items())
        print(f"{score:8.3f}  {named}")


if __name__ == "__main__":
    main()
