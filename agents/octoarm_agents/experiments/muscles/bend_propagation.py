"""Bend propagation, the octopus's reaching, embedded by a linear static feedback loop (section 4).

The paper names it as the next experiment, and nobody had made it. A clock commands a wave of
stiffening; a linear readout of the spring lengths learns it, is let go, and gets a brief command.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from octoarm_agents.common.plotting import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    VERMILLION,
    new_figure,
    write_letters,
)
from octoarm_agents.experiments.muscles.let_go import (
    LENGTH,
    PERIOD,
    PULSE,
    SPEED,
    START,
    LeftDomainError,
    bend_point,
    bends_of,
    judge,
    let_go,
    teach,
)
from octoarm_agents.experiments.plots import number_compartments, say_missing
from octoarm_agents.experiments.runner import Experiment, RunSettings, round_numbers
from octoarm_agents.experiments.tables import ResultTable
from octoarm_env import ArmParameters
from octoarm_env.arrays import Float

NOISES = (1e-6, 1e-5, 1e-4, 3e-4)
"""Half widths of the noise on the lengths [m]."""
PUSHES = (0.25, 0.5, 1.0)
"""Half widths of the noise on the activations, for 0.2 s."""
ARMS = 16
"""In each test."""

PAPER = (
    "It would be worth investigating how the arm's body dynamics, with a linear and static "
    "feedback loop, embeds the motor patterns of bend propagation according to an initiation "
    "command."
)


def teach_and_let_go(parameters: ArmParameters, seed: int, trial: int) -> dict[str, Any]:
    """One readout, and what it does undisturbed, blurred, pushed, without a command, in parts."""
    try:
        return _let_go_of_one(parameters, seed, trial)
    except LeftDomainError as failure:
        return {"failure": {"trial": trial, "message": str(failure)}}


def _let_go_of_one(parameters: ArmParameters, seed: int, trial: int) -> dict[str, Any]:
    weights = teach(parameters, (seed, trial))
    generator = np.random.default_rng((seed, trial, 1))

    def test(**given: Any) -> dict[str, Any]:
        outcomes = judge(let_go(parameters, weights, generator, arms=ARMS, **given))
        reached = outcomes["waits"] & outcomes["travels"] & outcomes["straight"]
        parts = {name: float(each.mean()) for name, each in outcomes.items()}
        return {"reached": float(reached.mean()), **parts}

    example = let_go(parameters, weights, generator, arms=1)[:, 0]
    return {
        "noise": [test(noise=noise) for noise in NOISES],
        "push": [test(push=push) for push in PUSHES],
        "uncommanded": test(command=False),
        "without": [test(unseen=each) for each in range(parameters.compartments)],
        "example": _series(example),
    }


def scripted(parameters: ArmParameters) -> dict[str, Any] | None:
    """The arm that the clock leads to the end; None if it leaves its domain."""
    generator = np.random.default_rng(0)
    try:
        return _series(let_go(parameters, None, generator, arms=1)[:, 0])
    except LeftDomainError:
        return None


def _series(positions: Float) -> dict[str, Any]:
    """Bends and the bend point's way and speed."""
    point = bend_point(positions)
    moving = _travelling(point)
    speed = np.linalg.norm(np.gradient(_smooth(_bend_centre(positions)), PERIOD, axis=0), axis=1)
    times = np.arange(len(point)) * PERIOD
    travelled = times[moving]
    profile = speed[moving]
    return {
        "bends_deg": round_numbers(bends_of(positions)[::2]),
        "point": [None if np.isnan(each) else float(each) for each in point[::2]],
        "travel_s": float(np.ptp(travelled)) if len(travelled) else None,
        "profile_m_s": round_numbers(profile),
        "peak_m_s": float(profile.max()) if len(profile) else None,
        "peak_at": float(profile.argmax() / max(len(profile) - 1, 1)) if len(profile) else None,
        "along_m_s": _along(point, moving),
    }


def _bend_centre(positions: Float) -> Float:
    """Where the bend is in the water, (T, 3) [m]: the mean of all joints, weighed by bend⁴.

    The joint of the largest bend jumps from one to the next; this does not.
    """
    weights = bends_of(positions) ** 4
    total = np.maximum(weights.sum(axis=1), 1e-12)
    centre: Float = np.einsum("tj,tjk->tk", weights, positions[:, 1:-1]) / total[:, None]
    return centre


def _travelling(point: Float) -> Any:
    """From the command on, when the bend point is near the base, until it is near the tip."""
    times = np.arange(len(point)) * PERIOD
    after = (times >= START) & ~np.isnan(point)
    begin = np.flatnonzero(after & (point < 0.45))
    end = np.flatnonzero(after & (point > 0.75))
    moving = np.zeros(len(point), bool)
    end = end[end > begin[0]] if len(begin) else begin
    if len(end):
        moving[begin[0] : end[0] + 1] = True
    return moving & ~np.isnan(point)


def _along(point: Float, moving: Any) -> float | None:
    """Mean speed of the bend along the arm [m/s], of which 0.4 m is the length."""
    if moving.sum() < 3:
        return None
    times = np.arange(len(point)) * PERIOD
    return float(np.polyfit(times[moving], 0.4 * point[moving], 1)[0])


def _smooth(rows: Float, width: int = 7) -> Float:
    """The mean over so many neighbours."""
    padded = np.pad(rows, ((width // 2, width // 2), (0, 0)), mode="edge")
    kernel = np.ones(width) / width
    return np.stack([np.convolve(column, kernel, "valid") for column in padded.T], axis=1)


def run(settings: RunSettings) -> dict[str, Any]:
    """Teach one readout a trial, and count what reaches."""
    (results,) = settings.repeat("bend-propagation", teach_and_let_go, [[{}]])
    trials = [each for each in results if "failure" not in each]

    def shares(results: list[dict[str, Any]], part: str = "reached") -> list[float]:
        return [each[part] for each in results]

    return {
        "paper": PAPER,
        "trials": settings.trials,
        "arms": ARMS,
        "scripted": scripted(settings.parameters),
        "failures": [each["failure"] for each in results if "failure" in each],
        "example": trials[0]["example"] if trials else None,
        "noise": [
            {"noise_m": noise, "reached": shares([trial["noise"][index] for trial in trials])}
            for index, noise in enumerate(NOISES)
        ],
        "push": [
            {"push": push, "reached": shares([trial["push"][index] for trial in trials])}
            for index, push in enumerate(PUSHES)
        ],
        "uncommanded_waits": shares([trial["uncommanded"] for trial in trials], "waits"),
        "uncommanded_straight": shares([trial["uncommanded"] for trial in trials], "straight"),
        "without": [
            shares([trial["without"][index] for trial in trials])
            for index in range(settings.parameters.compartments)
        ],
    }


def tables(result: Mapping[str, Any]) -> list[ResultTable]:
    """How many reach, by what disturbs them."""
    rows = [
        (f"noise of {each['noise_m']:g} m on the lengths", *_spread(each["reached"]))
        for each in result["noise"]
    ]
    rows += [
        (f"activations pushed by ±{each['push']:g} for 0.2 s", *_spread(each["reached"]))
        for each in result["push"]
    ]
    rows += [
        (f"compartment {index} not seen", *_spread(each))
        for index, each in enumerate(result["without"], 1)
    ]
    false = result["uncommanded_straight"]
    notes = [
        f"Each share is of {result['arms']} arms; a readout a trial, {result['trials']} of them.",
    ]
    if false:
        notes.append(
            f"Without a command {np.mean(result['uncommanded_waits']):.0%} wait bent, and "
            f"{np.mean(false):.0%} reach all the same."
        )
    notes += [f"Trial {each['trial']} failed: {each['message']}." for each in result["failures"]]
    for name in ("scripted", "example"):
        each = result[name]
        if each is not None and each["peak_m_s"] is not None:
            notes.append(
                f"{'The clock' if name == 'scripted' else 'The readout'}: the bend travels for "
                f"{each['travel_s']:.2f} s, at most at {each['peak_m_s']:.2f} m/s through the "
                f"water (after {each['peak_at']:.0%} of the time)."
            )
    title = f"Bends that travel to the tip, {result['trials']} readouts"
    return [ResultTable(title, ("", "median", "least", "most"), rows, notes)]


def _spread(shares: list[float]) -> tuple[str, str, str]:
    if not shares:
        return "–", "–", "–"
    return f"{np.median(shares):.0%}", f"{min(shares):.0%}", f"{max(shares):.0%}"


def draw(result: Mapping[str, Any]) -> Figure:
    """The bend's way, led by the clock and by the readout; its speed; what disturbs it."""
    figure = new_figure(11.0, 7.5)
    axes = figure.subplots(2, 3)
    write_letters(list(axes.flat))
    for panel, name, title in zip(
        axes[0], ("scripted", "example"), ("led by the clock", "the readout alone"), strict=False
    ):
        _draw_bends(figure, panel, result[name], title)
    profiles, noises, without = axes[0, 2], axes[1, 0], axes[1, 2]
    for name, colour, label in (("scripted", BLACK, "clock"), ("example", ORANGE, "readout")):
        profile = [] if result[name] is None else result[name]["profile_m_s"]
        profiles.plot(np.arange(len(profile)) * PERIOD, profile, color=colour, label=label)
    profiles.axhline(SPEED, color=BLACK, linewidth=0.7, linestyle=":", label="wave along the arm")
    profiles.set(xlabel="time since the bend set out (s)", ylabel="bend point in the water (m/s)")
    profiles.legend(fontsize=8, frameon=False)
    places = [each["noise_m"] for each in result["noise"]]
    _draw_shares(noises, places, [each["reached"] for each in result["noise"]], BLUE)
    noises.set_xlim(0.7 * NOISES[0], 1.4 * NOISES[-1])
    noises.set(xscale="log", xlabel="noise on the lengths, half width (m)")
    places = [each["push"] for each in result["push"]]
    _draw_shares(axes[1, 1], places, [each["reached"] for each in result["push"]], VERMILLION)
    axes[1, 1].set_xlabel("push of the activations, half width")
    _draw_shares(without, range(1, len(result["without"]) + 1), result["without"], GREEN)
    number_compartments(without, len(result["without"]))
    without.set_xlabel("compartment whose springs are not seen", fontsize=9)
    return figure


def _draw_bends(figure: Figure, axes: Axes, series: Mapping[str, Any] | None, title: str) -> None:
    """Bends over place and time."""
    if series is None:
        say_missing(axes, {"message": "the arm left its domain"})
        return
    bends = np.array(series["bends_deg"]).T
    extent = (-START, LENGTH - START, 0.5, len(bends) + 0.5)
    image = axes.imshow(bends, aspect="auto", origin="lower", extent=extent, cmap="magma")
    axes.axvspan(0.0, PULSE, color="white", alpha=0.35)
    axes.set_xlim(-1.0, 2.5)
    axes.set(xlabel="time since the command (s)", ylabel="compartment, from the base")
    axes.set_title(title, fontsize=9)
    figure.colorbar(image, ax=axes, shrink=0.8).set_label("bend (degrees)", fontsize=8)


def _draw_shares(axes: Axes, places: Any, shares: list[list[float]], colour: str) -> None:
    """The median share that reaches, and every readout's."""
    for place, each in zip(places, shares, strict=True):
        axes.plot(
            [place] * len(each), [100 * share for share in each], ".", color=colour, alpha=0.4
        )
    if all(shares):
        axes.plot(list(places), [100 * float(np.median(each)) for each in shares], color=colour)
    axes.set(ylim=(-5, 105), ylabel="arms that reach (%)")


BEND_PROPAGATION = Experiment("bend-propagation", 5, run, tables, draw)
