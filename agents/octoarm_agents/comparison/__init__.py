"""Readouts, networks and trivial agents compared: same episodes, several trainings, the cost."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from octoarm_agents.common.files import write_atomically
from octoarm_agents.comparison.agents import AGENTS
from octoarm_agents.comparison.measuring import Protocol
from octoarm_agents.comparison.study import Comparison, compare

__all__ = ["AGENTS", "Comparison", "Protocol", "compare", "draw_all"]


def draw_all(result: Mapping[str, Any], out: Path) -> None:
    """Draw the figures of a comparison into a folder.

    Raises:
        OSError: the folder cannot be written to.
    """
    from octoarm_agents.common.plotting import save_figure
    from octoarm_agents.comparison.pictures import PICTURES

    for name, draw in PICTURES.items():
        figure = draw(result)
        write_atomically(out / f"{name}.png", functools.partial(save_figure, figure))
