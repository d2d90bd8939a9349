"""`octoarm demo`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from octoarm_agents.cli.options import (
    Actuator,
    Amplitude,
    Body,
    Seed,
    Target,
    number,
    read_body,
    refused,
    result_folder,
)
from octoarm_agents.cli.printing import new_table
from octoarm_agents.common.progress import stage_bar

if TYPE_CHECKING:
    from rich.table import Table

    from octoarm_agents.demo import DemoResult

_NOISE = "ν: half width in metres of the noise on the spring lengths that the readout allows for."
_PLAIN = "Teach as the paper does: noise on the lengths and the pseudo-inverse, nothing else."
_BURST = "ε: half width in degrees of the white noise on both outputs, for 1000 steps half-way."
_OWN: dict[str, Any] = {"show_default": "the cycle's own"}

_ADVICE = {
    "teaching": "The target itself is too much for this body: try a smaller --amplitude.",
    "swinging in": "The target itself is too much for this body: try a smaller --amplitude.",
    "alone": "The readout does not hold this cycle: search for one with octoarm calibrate cycle.",
    "disturbed": "The noise is too strong: try a smaller --burst.",
    "alone again": "The arm did not come back from the noise: try a smaller --burst.",
}


def demo(
    out: Annotated[Path, result_folder("demo.png and demo.json")] = Path("out/demo"),
    target: Target = "quadratic",
    actuator: Actuator = "direct",
    amplitude: Amplitude = None,
    noise: Annotated[float | None, number(_NOISE, 0.0, 0.01, "metres", **_OWN)] = None,
    plain: Annotated[bool, typer.Option("--plain", help=_PLAIN)] = False,
    burst: Annotated[float | None, number(_BURST, 0.0, 360.0, "degrees", **_OWN)] = None,
    steps: Annotated[int, number("Physics steps in closed loop.", 12_000, 10_000_000)] = 20_000,
    seed: Seed = 0,
    arm: Body = None,
) -> None:
    """Teach the arm's body a limit cycle, let it hold the cycle alone, disturb it.

    A linear readout of the spring lengths is fitted while the target turns the
    base, then drives the base itself: nothing but the body remembers the motion
    (section 2.2.2 of the paper). Half-way, noise is added to the outputs.

    Exit status: 0 if the cycle was held, and again after the burst; 1 if not;
    2 for bad options.
    """
    from dataclasses import replace

    from rich.console import Console

    from octoarm_agents.common.files import write_atomically, write_json
    from octoarm_agents.demo import DemoSettings, run_demo
    from octoarm_agents.demo_figure import draw_demo
    from octoarm_agents.reservoir.closed_loop import FORCED_STEPS
    from octoarm_agents.reservoir.cycles import CYCLES, PAPER_BURSTS

    parameters = read_body(arm)
    given: dict[str, Any] = {"amplitude": amplitude, "noise": noise, "actuator": actuator}
    teaching = replace(
        CYCLES[target]["plain" if plain else "weighted"],
        **{name: value for name, value in given.items() if value is not None},
    )
    settings = DemoSettings(
        teaching, PAPER_BURSTS[target][0] if burst is None else burst, steps, seed
    )
    with stage_bar("teaching", teaching.steps + FORCED_STEPS + steps) as advance:
        with refused("--arm"):  # a body without a static equilibrium
            result = run_demo(settings, parameters, advance)
        advance("drawing", 0)
        write_json(out / "demo.json", result.to_dict())
        write_atomically(out / "demo.png", draw_demo(result).savefig)

    console = Console()
    console.print(_table(result))
    console.print(f"Wrote {out / 'demo.png'} and {out / 'demo.json'}.", soft_wrap=True)
    if result.failure is not None:
        stage = result.failure["stage"]
        typer.echo(f"Ended while {stage}: {result.failure['message']}.", err=True)
        typer.echo(_ADVICE[stage], err=True)
    if not result.scores().recovered:
        raise typer.Exit(1)


def _table(result: DemoResult) -> Table:
    teaching, scores = result.settings.teaching, result.scores()
    table = new_table(
        f"{teaching.target} cycle, {teaching.actuator} base, R = {teaching.amplitude:g}°,"
        f" ν = {teaching.noise:g} m, ε = {result.settings.burst:g}°"
    )
    for name, window in (
        ("before the burst", scores.before),
        ("during the burst", scores.burst),
        ("after recovery", scores.after),
    ):
        value = "not completed"
        if window is not None:
            value = f"{window['mean_distance']:.5f} / {window['max_distance']:.5f}"
        table.add_row(f"mean / max distance, {name}", value)
    table.add_row("held before the burst", "yes" if scores.held else "no")
    table.add_row("recovered", "yes" if scores.recovered else "no")
    if scores.recovery_time is not None:
        table.add_row("time to recover", f"{scores.recovery_time:.3f} s")
    last = scores.after or scores.before
    if last is not None and last["period_ratio"] is not None:
        table.add_row("period / target period", f"{last['period_ratio']:.5f}")
        table.add_row("amplitude / R", f"{last['amplitude_ratio']:.4f}")
    steps, seconds = result.physics_steps, result.physics_seconds
    if steps:
        speed = steps * result.parameters.timestep / seconds
        table.add_row("physics", f"{steps} steps in {seconds:.2f} s, {speed:.0f} × real time")
    table.add_row("wall-clock time", f"{result.wall_seconds:.2f} s")
    return table
