"""What the tests of a cluster compute there, in a module that its nodes import at once."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

from octoarm_agents.common.trials import run_trials
from octoarm_agents.common.workers import Cluster

from octoarm_env import ArmParameters


def here() -> str:
    import ray

    return str(ray.get_runtime_context().get_node_id())


def die_on(parameters: ArmParameters, *, trial: int, doomed: str, log: str) -> dict[str, Any]:
    """A trial that never ends on one node, and on the others not before that one has begun some."""
    on_doomed = here() == doomed
    with Path(log).open("a", encoding="utf-8") as file:
        file.write(f"{trial} {on_doomed:d}\n")
    while on_doomed or (doomed and " 1\n" not in Path(log).read_text(encoding="utf-8")):
        time.sleep(0.05)
    return {"trial": trial, "length": parameters.rest_length * trial}


def meet(folder: str, name: str, number: int) -> str:
    """Wait until so many calls are under way at the same time."""
    (Path(folder) / name).touch()
    while len(list(Path(folder).iterdir())) < number:
        time.sleep(0.05)
    return name


def fail(folder: str, name: str) -> str:
    """Wait for ever, or fail once another call waits."""
    if name == "waits":
        meet(folder, name, 1000)
    while not list(Path(folder).iterdir()):
        time.sleep(0.05)
    raise ValueError("no such luck")


def count_others(folder: str, number: int) -> int:
    mine = Path(folder) / str(number)
    mine.touch()
    time.sleep(0.1)
    others = len(list(Path(folder).iterdir())) - 1
    mine.unlink()
    return others


def stay(parameters: ArmParameters, *, trial: int) -> dict[str, Any]:
    """A trial that ends if it is one of the first two."""
    while trial > 1:
        time.sleep(0.05)
    return {"trial": trial}


if __name__ == "__main__":
    import cluster_calls

    folder, address = sys.argv[1:]
    run_trials(
        cluster_calls.stay,
        ArmParameters(),
        [{"trial": k} for k in range(4)],
        folder=Path(folder),
        jobs=Cluster.connect(address),
    )
