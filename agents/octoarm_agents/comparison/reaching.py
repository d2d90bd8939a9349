"""Reaching compared: trained agents of several seeds beside plain baselines, on held-out goals."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from octoarm_agents.common.files import write_atomically, write_json
from octoarm_agents.common.intervals import bootstrap_interval
from octoarm_agents.common.plotting import BLUE, GREY, VERMILLION, new_figure, write_letters
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_agents.policies.reaching import (
    BASELINES,
    evaluate_reaching,
    held_out_goals,
    train_goals,
)

MEASURES = ("success", "held", "ever", "distance")
_COLOURS = {"sac": BLUE, "ppo": VERMILLION}


def compare_reaching(
    folder: Path, out: Path, progress: Callable[[str], Any] | None = None
) -> dict[str, Any]:
    """Gather finished trainings, judge the baselines, and write ``reaching.json`` and ``.png``.

    An algorithm that `folder` has no training of is kept as it stands in ``reaching.json``.

    Args:
        folder: holds folders of `octoarm reach train`, whose names begin with the algorithm's.
        out: for the files.
        progress: called with what is judged next.

    Returns:
        What ``reaching.json`` holds.

    Raises:
        ValueError: no finished training is in the folder, or some of one algorithm that differ in
            more than their seeds.
    """
    trainings = _finished(folder)
    baselines = {}
    for name, make in BASELINES.items():
        if progress is not None:
            progress(name)
        baselines[name] = evaluate_reaching(make)
    result = {
        "goals": len(held_out_goals()),
        "baselines": baselines,
        "agents": _kept(out) | {name: _summary(each) for name, each in trainings.items()},
        "command": "octoarm reach compare",
        "versions": package_versions(
            "octoarm-env", "octoarm-agents", "stable-baselines3", "torch", "numpy"
        ),
        "machine": describe_machine(),
    }
    write_json(out / "reaching.json", result)
    write_atomically(out / "reaching.png", draw_reaching(result).savefig)
    return result


def _finished(folder: Path) -> dict[str, list[dict[str, Any]]]:
    """The trainings by algorithm; those that are judged on other goals are left out."""
    trainings: dict[str, list[dict[str, Any]]] = {}
    for path in sorted(folder.glob("*/training.json")):
        training = json.loads(path.read_text(encoding="utf-8"))
        if not training.get("finished") or training.get("validation"):
            continue
        alike = trainings.setdefault(training["algorithm"], [])
        for name in ("hyperparameters", "steps"):
            if alike and training.get(name) != alike[0].get(name):
                raise ValueError(f"{path} has other {name} than seed {alike[0]['seed']} there")
        alike.append(training)
    if not trainings:
        raise ValueError(f"{folder} holds no finished training: run octoarm reach train")
    return trainings


def _kept(out: Path) -> dict[str, Any]:
    """The agents of an earlier comparison."""
    file = out / "reaching.json"
    if not file.exists():
        return {}
    agents: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))["agents"]
    return agents


def _summary(trainings: list[dict[str, Any]]) -> dict[str, Any]:
    last = [training["curve"][-1] for training in trainings]
    summary: dict[str, Any] = {
        "seeds": [training["seed"] for training in trainings],
        "steps": last[0]["steps"],
        "seconds": float(np.median([each["seconds"] for each in last])),
        "parameters": trainings[0]["parameters"],
        "hyperparameters": trainings[0]["hyperparameters"],
        "curves": [training["curve"] for training in trainings],
    }
    for name in MEASURES:
        values = [each[name] for each in last]
        summary[name] = {
            "median": float(np.median(values)),
            "values": values,
            "interval": bootstrap_interval(values) if len(values) > 1 else None,
        }
    return summary


def draw_reaching(result: Mapping[str, Any]) -> Figure:
    """The reachable set from two sides; the curves of all trainings, the baselines beside them."""
    figure = new_figure(11.0, 3.8)
    panels = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 1.5))
    write_letters(list(panels))
    learnt, judged = 1000 * train_goals(), 1000 * held_out_goals()
    for panel, (x, y), names in zip(panels, ((0, 2), (0, 1)), ("xz", "xy"), strict=False):
        sets = ((learnt, GREY, "to learn on"), (judged, VERMILLION, "held out"))
        for goals, colour, label in sets:
            panel.plot(goals[:, x], goals[:, y], ".", markersize=2.5, color=colour, label=label)
        panel.set(xlabel=f"{names[0]} (mm)", ylabel=f"{names[1]} (mm)", aspect="equal")
    panels[0].invert_yaxis()
    above = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.1), "ncols": 2}
    panels[0].legend(fontsize=8, frameon=False, markerscale=3, **above)
    curves = panels[2]
    for name, agent in result["agents"].items():
        for number, curve in enumerate(agent["curves"]):
            steps = [each["steps"] for each in curve]
            shares = [100 * each["success"] for each in curve]
            label = name.upper() if number == 0 else "_"
            curves.plot(steps, shares, color=_COLOURS.get(name), linewidth=1.2, label=label)
    levels: dict[int, list[str]] = {}
    for name, told in result["baselines"].items():
        levels.setdefault(round(20 * told["success"]), []).append(name)
    for together in levels.values():
        share = 100 * result["baselines"][together[0]]["success"]
        curves.axhline(share, color=GREY, linewidth=0.8, linestyle=":")
        place = {"xycoords": ("axes fraction", "data"), "ha": "right", "va": "bottom"}
        curves.annotate(", ".join(together), (1.0, share), fontsize=8, color=GREY, **place)
    curves.set(xscale="log", ylim=(-3, 103))
    curves.set(xlabel="environment steps", ylabel="held-out goals reached (%)")
    curves.legend(fontsize=8, frameon=False, loc="upper right", bbox_to_anchor=(1.0, 0.9))
    return figure
