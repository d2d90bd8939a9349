"""`octoarm demo`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from octoarm_agents.cli.options import number_between, output_folder, read_body
from octoarm_agents.common.progress import stage_bar

if TYPE_CHECKING:
    from rich.table import Table

    from octoarm_agents.demo import DemoResult


_ADVICE = {
    "teaching": "The target itself is too much for this body: try a smaller --amplitude.",
    "swinging in": "The target itself is too much for this body: try a smaller --amplitude.",
    "alone": "The readout does not hold this cycle: search for one with octoarm calibrate cycle.",
    "disturbed": "The noise is too strong: try a smaller --burst.",
    "alone again": "The arm did not come back from the noise: try a smaller --burst.",
}


def demo(
    out: Annotated[
        Path,
        typer.Option(help="Folder for demo.png and demo.json.", callback=output_folder),
    ] = Path("out/demo"),
    target: Annotated[
        Literal["quadratic", "van_der_pol", "lissajous"],
        typer.Option(help="Limit cycle (Eqs. 28, 27, 29)."),
    ] = "quadratic",
    actuator: Annotated[
        Literal["direct", "servo"],
        typer.Option(
            help="How the base follows its command: at once, as in the paper, or through a servo."
        ),
    ] = "direct",
    amplitude: Annotated[
        float | None,
        typer.Option(
            "--amplitude",
            "-R",
            help="R: largest angle of the target in degrees.",
            show_default="the cycle's own",
            callback=number_between(0.1, 360.0, "degrees"),
        ),
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(
            help="ν: half width in metres of the noise on the spring lengths "
            "that the readout is fitted for.",
            show_default="the cycle's own",
            callback=number_between(0.0, 0.01, "metres"),
        ),
    ] = None,
    plain: Annotated[
        bool,
        typer.Option(
            "--plain",
            help="Teach as the paper does: white noise on the lengths and the pseudo-inverse, "
            "nothing that tells the readout what disturbances of the base do to them.",
        ),
    ] = False,
    burst: Annotated[
        float | None,
        typer.Option(
            help="ε: half width in degrees of the white noise on both outputs, "
            "for 1000 steps half-way.",
            show_default="the cycle's own",
            callback=number_between(0.0, 360.0, "degrees"),
        ),
    ] = None,
    steps: Annotated[
        int,
        typer.Option(
            help="Physics steps in closed loop.", callback=number_between(12_000, 10_000_000)
        ),
    ] = 20_000,
    seed: Annotated[
        int, typer.Option(help="Seed of the noise.", callback=number_between(0, 2**32 - 1))
    ] = 0,
    arm: Annotated[
        Path | None,
        typer.Option(
            help="A body: nakajima2013, inertial, or a JSON file of parameters.",
            show_default="the default body",
        ),
    ] = None,
) -> None:
    """Teach the arm's body a limit cycle, let it hold the cycle alone, disturb it.

    A linear readout of the spring lengths is fitted while the target turns the base, then drives
    the base itself: nothing but the body remembers the motion (section 2.2.2 of the paper).
    Half-way, a burst of noise is added to the outputs.

    Exit status: 0 if the cycle was held, and again after the burst; 1 if not; 2 for bad options.
    """
    from dataclasses import replace

    from rich.console import Console

    from octoarm_agents import demo as arm_demo
    from octoarm_agents.common.files import write_atomically, write_json
    from octoarm_agents.demo_figure import draw_demo
    from octoarm_agents.reservoir.cycles import CYCLES, PAPER_BURSTS

    parameters = read_body(arm)
    teaching = replace(CYCLES[target]["plain" if plain else "weighted"], actuator=actuator)
    if amplitude is not None:
        teaching = replace(teaching, amplitude=amplitude)
    if noise is not None:
        teaching = replace(teaching, noise=noise)
    settings = arm_demo.DemoSettings(
        teaching=teaching,
        burst=PAPER_BURSTS[target][0] if burst is None else burst,
        steps=steps,
        seed=seed,
    )
    console, errors = Console(), Console(stderr=True)
    total = teaching.steps + arm_demo.FORCED_STEPS + steps
    with stage_bar("teaching", total) as advance:
        try:
            result = arm_demo.run_demo(settings, parameters, advance)
        except ValueError as error:  # a body without a static equilibrium
            raise typer.BadParameter(str(error), param_hint="'--arm'") from None
        advance("drawing", 0)
        write_json(out / "demo.json", result.to_dict())
        figure = draw_demo(result)
        write_atomically(out / "demo.png", figure.savefig)

    scores = result.scores()
    console.print(_table(result, scores))
    console.print(f"Wrote {out / 'demo.png'} and {out / 'demo.json'}.", soft_wrap=True)
    if result.failure is not None:
        errors.print(
            f"Ended while {result.failure['stage']}: {result.failure['message']}.", soft_wrap=True
        )
        errors.print(_ADVICE[result.failure["stage"]])
    if not scores["recovered"]:
        raise typer.Exit(1)


def _table(result: DemoResult, scores: dict[str, Any]) -> Table:
    from rich.table import Table

    teaching = result.settings.teaching
    table = Table(
        title=f"{teaching.target} cycle, {teaching.actuator} base, R = {teaching.amplitude:g}°,"
        f" ν = {teaching.noise:g} m, ε = {result.settings.burst:g}°",
        show_header=False,
    )
    table.add_column("")
    table.add_column("", justify="right")
    for name, window in (
        ("before the burst", scores["before"]),
        ("during the burst", scores["burst"]),
        ("after recovery", scores["after"]),
    ):
        value = "not completed"
        if window is not None:
            value = f"{window['mean_distance']:.5f} / {window['max_distance']:.5f}"
        table.add_row(f"mean / max distance, {name}", value)
    table.add_row("held before the burst", _yes_no(scores["held"]))
    table.add_row("recovered", _yes_no(scores["recovered"]))
    if scores["recovery_time"] is not None:
        table.add_row("time to recover", f"{scores['recovery_time']:.3f} s")
    last = scores["after"] or scores["before"]
    if last is not None and last["period_ratio"] is not None:
        table.add_row("period / target period", f"{last['period_ratio']:.5f}")
        table.add_row("amplitude / R", f"{last['amplitude_ratio']:.4f}")
    step = 1e6 * result.physics_seconds / max(result.physics_steps, 1)
    real_time = result.parameters.timestep / (1e-6 * step) if step else float("nan")
    table.add_row("physics", f"{result.physics_steps} steps in {result.physics_seconds:.2f} s")
    table.add_row("speed of the physics", f"{step:.1f} µs a step, {real_time:.0f} × real time")
    table.add_row("wall-clock time", f"{result.wall_seconds:.2f} s")
    return table


def _yes_no(value: bool) -> str:
    return "yes" if value else "no"
