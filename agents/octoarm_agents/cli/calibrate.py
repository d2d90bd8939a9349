"""`octoarm calibrate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from octoarm_agents.cli.options import (
    Actuator,
    Body,
    ClusterAddress,
    Jobs,
    Seed,
    TargetArgument,
    number,
    read_body,
    refused,
    result_folder,
    workers_of,
)
from octoarm_agents.cli.printing import new_table
from octoarm_agents.common.progress import stage_bar

if TYPE_CHECKING:
    from rich.table import Table


app = typer.Typer(
    help="Search for what the paper leaves open: the body, and how each cycle is taught.",
    no_args_is_help=True,
)


@app.command("body")
def body(
    evaluations: Annotated[int, number("Bodies tried for each sign and reading.", 1, 10**6)] = 120,
    out: Annotated[
        Path, result_folder("evaluations.jsonl, calibration.json, calibration.png and body.json")
    ] = Path("out/calibrate/body"),
    lift_sign: Annotated[
        Literal["+1", "-1", "both"], typer.Option(help="Sign of the lift force.")
    ] = "both",
    volume_force: Annotated[
        Literal["applied", "total", "both"], typer.Option(help="Reading of Eqs. 7-8.")
    ] = "applied",
    reference_area: Annotated[
        Literal["wetted", "planform", "both"] | None,
        typer.Option(help="Reading of A_r.", show_default="that of the body"),
    ] = None,
    tilt: Annotated[bool, typer.Option("--tilt", help="Search gravity's direction too.")] = False,
    amplitudes: Annotated[
        str | None,
        typer.Option(help="Cycles to follow: quadratic=60,van_der_pol=45.", show_default="none"),
    ] = None,
    noise_seeds: Annotated[int, number("Trainings of each cycle, as in the paper.", 0, 100)] = 2,
    trials: Annotated[int, number("T_ini of the best body's last measurement.", 1, 1001)] = 5,
    seed: Seed = 0,
    jobs: Jobs = None,
    cluster: ClusterAddress = None,
    arm: Body = None,
) -> None:
    """Search for the body that does what the paper reports.

    CMA-ES, from the given body, over the parameters that the paper leaves open and
    nothing else. docs/body.md has their bounds and the score. Signs and readings
    are searched apart from each other. With --amplitudes, a body must also be able
    to follow those cycles on a direct base; with --noise-seeds 0, Table 2 alone
    counts.

    Every evaluation is kept in evaluations.jsonl: the same call goes on where
    it was interrupted, one with more --evaluations where it ended.

    Exit status: 0; 1 if no body stayed in its domain; 2 for bad options.
    """
    from rich.console import Console

    from octoarm_agents.calibration.body import calibrate_body
    from octoarm_agents.calibration.space import SearchSpace

    base = read_body(arm)
    spaces = [
        SearchSpace(base, float(lift), volume, area, tilt)
        for lift in _each(lift_sign, ("+1", "-1"))
        for volume in _each(volume_force, ("applied", "total"))
        for area in _each(reference_area or base.reference_area, ("wetted", "planform"))
    ]
    with refused():
        result = calibrate_body(
            spaces,
            evaluations=evaluations,
            out=out,
            amplitudes=_parse_amplitudes(amplitudes),
            noise_seeds=noise_seeds,
            trials=trials,
            seed=seed,
            jobs=workers_of(jobs, cluster),
        )
    if result is None:
        typer.echo("No body stayed in its domain: try more --evaluations.", err=True)
        raise typer.Exit(1)
    console = Console()
    console.print(_body_table(result))
    files = "calibration.json, calibration.png, body.json and evaluations.jsonl"
    console.print(f"Wrote {files} into {out}.", soft_wrap=True)


def _body_table(result: dict[str, Any]) -> Table:
    searches = result["spaces"]
    table = new_table(
        "Error divided by that of Table 2, and what the best body is",
        "",
        *(f"lift {search['lift_scale']:+g}" for search in searches),
        "best, measured again",
    )
    columns = [
        _body_column(search["best"], f"{search['failures']} of {search['evaluations']}")
        for search in searches
    ]
    again = result["measured_again"]
    measured = {"ratios": again["mean_ratios"], "score": again["score"]}
    columns.append(_body_column(result["best"] | measured))
    for name in columns[-1]:
        table.add_row(name, *(column.get(name, "–") for column in columns))
    return table


def _body_column(best: dict[str, Any], failures: str = "") -> dict[str, str]:
    """What the table says of an evaluation, by row."""
    from octoarm_agents.calibration.outcomes import describe_outcomes
    from octoarm_agents.calibration.space import OPEN_NUMBERS, READINGS
    from octoarm_agents.experiments.emulation.protocol import TASKS

    body, ratios = best["body"], best["ratios"]
    column = {name: str(body[name]) for name in READINGS[1:]}
    if best["outcomes"] is not None:
        column["outcomes as in the paper"] = describe_outcomes(best["outcomes"])
    column |= {task: "–" if ratios is None else f"{ratios[task]:.3g}" for task in TASKS}
    column["score"] = "–" if best["score"] is None else f"{best['score']:.3f}"
    column |= {name: f"{body[name]:.4g}" for name in OPEN_NUMBERS}
    column["gravity"] = " ".join(f"{each:.3g}" for each in body["gravity"])
    return column | {"left their domain": failures}


@app.command("cycle")
def cycle(
    target: TargetArgument,
    amplitude: Annotated[
        float, number("R: its largest angle.", 0.1, 360.0, "degrees", "--amplitude", "-R")
    ],
    out: Annotated[Path, result_folder("TARGET-ACTUATOR.json")] = Path("out/calibrate/cycle"),
    actuator: Actuator = "direct",
    evaluations: Annotated[int, number("Teachings tried.", 8, 10**6)] = 160,
    noise: Annotated[
        float, number("Half width of noise on a trial's first outputs.", 0.0, 90.0, "degrees")
    ] = 0.01,
    steps: Annotated[
        int, number("Physics steps in closed loop of the one found.", 10_000, 10**8)
    ] = 100_000,
    seed: Seed = 1,
    arm: Body = None,
) -> None:
    """Search for how a limit cycle is taught: ν, and the disturbances not to be answered to.

    CMA-ES over ν and one size κ for each of six time scales. Each candidate
    closes the loop, with noise on its outputs at first; the distance in the end
    counts. The best is taught in full, and let go for --steps, undisturbed.

    Exit status: 0 if the cycle was held to the end; 1 if not; 2 for bad
    options.
    """
    from rich.console import Console

    from octoarm_agents.calibration.cycle import calibrate_cycle
    from octoarm_env import DomainError

    parameters = read_body(arm)
    try:
        with refused("--arm"), stage_bar("candidates") as advance:
            result = calibrate_cycle(
                parameters,
                target,
                amplitude,
                actuator=actuator,
                out=out,
                evaluations=evaluations,
                noise=noise,
                seed=seed,
                steps=steps,
                advance=advance,
            )
    except DomainError as error:
        typer.echo(f"The arm cannot follow the teacher: {error}.", err=True)
        typer.echo("Try a smaller --amplitude.", err=True)
        raise typer.Exit(1) from None
    Console().print(_cycle_table(result))
    typer.echo(f"Wrote {out / f'{target}-{actuator}.json'}.")
    scores = result["closed_loop"]["scores"]
    if scores is None or not scores["held"]:
        raise typer.Exit(1)


def _cycle_table(result: dict[str, Any]) -> Table:
    settings, teaching, loop = (result[name] for name in ("settings", "teaching", "closed_loop"))
    base = f"{teaching['actuator']} base, R = {teaching['amplitude']:g}°"
    table = new_table(f"{teaching['target']} cycle, {base}")
    table.add_row("ν", f"{teaching['noise']:.3g} m")
    for scale, size in zip(settings["time_scales_steps"], teaching["disturbances"], strict=True):
        table.add_row(f"κ at {scale} steps" if scale else "κ, white", f"{size:.3g}°")
    exponents = ", ".join(
        "infinite" if value is None else f"{value:.3g}" for value in result["exponents_per_second"]
    )
    table.add_row("Floquet exponents", f"{exponents} 1/s" if exponents else "huge")
    table.add_row("training error", f"{result['training_error_degrees']:.3g}°")
    scores = loop["scores"]
    if scores is None:
        failure = loop["failure"]
        table.add_row(f"closed loop lost at step {failure['step']}", failure["message"])
    else:
        distances = f"{scores['mean_distance']:.5f} / {scores['max_distance']:.5f}"
        table.add_row(f"mean / max distance after {loop['steps']} steps, in R", distances)
        table.add_row("held", "yes" if scores["held"] else "no")
    return table


def _each(choice: str, choices: tuple[str, ...]) -> tuple[str, ...]:
    return choices if choice == "both" else (choice,)


def _parse_amplitudes(text: str | None) -> dict[str, float]:
    """Parse quadratic=60,van_der_pol=45."""
    from octoarm_env import LIMIT_CYCLES

    found: dict[str, float] = {}
    for part in [] if text is None else text.split(","):
        target, _, degrees = part.strip().partition("=")
        try:
            amplitude = float(degrees)
        except ValueError:
            amplitude = 0.0
        if target not in LIMIT_CYCLES or target in found or not 0 < amplitude <= 360:
            raise typer.BadParameter(
                f"{part!r}: expected each of {', '.join(LIMIT_CYCLES)} at most once, as in "
                "quadratic=60, with R above 0 and up to 360 degrees.",
                param_hint="'--amplitudes'",
            )
        found[target] = amplitude
    return found
