"""`octoarm calibrate`."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from octoarm_agents.cli.options import number_between, output_folder, read_body
from octoarm_agents.common.progress import progress_bar

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["app"]

app = typer.Typer(
    help="Search for what the paper leaves open: the body, and how each cycle is taught.",
    no_args_is_help=True,
)

BOTH = "both"
LARGEST_RANGE = 360.0

Jobs = Annotated[
    int | None,
    typer.Option(
        help="Processes; the results do not depend on it.",
        show_default="number of processors",
        callback=number_between(1, 1024),
    ),
]
NoiseSeeds = Annotated[
    int,
    typer.Option(
        help="Trainings of each limit cycle with the paper's R and ν; 0: Table 2 alone counts.",
        callback=number_between(0, 100),
    ),
]
Arm = Annotated[
    Path | None,
    typer.Option(
        "--arm",
        help="A body: nakajima2013, inertial, or a JSON file of parameters.",
        show_default="the default body",
    ),
]


@app.command("body")
def body(
    evaluations: Annotated[
        int,
        typer.Option(
            help="Bodies tried for each lift sign and reading, some ten seconds each.",
            callback=number_between(1, 1_000_000),
        ),
    ] = 120,
    out: Annotated[
        Path,
        typer.Option(
            help="Folder for evaluations.jsonl, calibration.json, calibration.png and body.json.",
            callback=output_folder,
        ),
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
    tilt: Annotated[
        bool, typer.Option("--tilt", help="Search the direction of gravity too.")
    ] = False,
    amplitudes: Annotated[
        str | None,
        typer.Option(
            help="Cycles that the body must be able to follow on a direct base, with R in degrees: "
            "quadratic=60,van_der_pol=45.",
            show_default="none",
        ),
    ] = None,
    noise_seeds: NoiseSeeds = 2,
    trials: Annotated[
        int,
        typer.Option(
            help="T_ini with which the best body is measured again.",
            callback=number_between(1, 1001),
        ),
    ] = 5,
    seed: Annotated[
        int, typer.Option(help="Seed of the search.", callback=number_between(0, 2**32 - 1))
    ] = 0,
    jobs: Jobs = None,
    arm: Arm = None,
) -> None:
    """Search for the body that does what the paper reports.

    CMA-ES, from the given body, over the parameters that the paper leaves open
    and nothing else: longitudinal_mass_share (1/3 … 1), area_scale (0.5 … 50),
    plane_mass (1e-4 … 0.1 kg), plane_inertia (1e-8 … 1e-5 kg m²), arm_density
    (1042 … 1303 kg/m³), with --tilt the direction of gravity. Signs and
    readings are searched apart from each other.

    The score is 10 c + Σ max(ln r, -0.1) + 0.5 max(0, ln r of the worst task)
    + Σ max(0, ln(0.1 / r)), c being the limit cycles of which the paper's own
    training makes something else than the paper reports (30,000 steps alone),
    r the error divided by that of Table 2 at R = 60 degrees. A body that leaves
    its domain, in Task 1 or under the teacher of one of the --amplitudes,
    scores worse than any other, by how far it got.

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
    try:
        result = calibrate_body(
            spaces,
            evaluations=evaluations,
            out=out,
            amplitudes=_parse_amplitudes(amplitudes),
            noise_seeds=noise_seeds,
            trials=trials,
            seed=seed,
            jobs=jobs or os.cpu_count() or 1,
        )
    except ValueError as error:
        raise typer.BadParameter(f"{error}.") from None
    if result is None:
        typer.echo("No body stayed in its domain: try more --evaluations.", err=True)
        raise typer.Exit(1)
    console = Console()
    _print_body(console, result)
    console.print(
        f"Wrote calibration.json, calibration.png, body.json and evaluations.jsonl into {out}.",
        soft_wrap=True,
    )


def _print_body(console: Console, result: dict[str, Any]) -> None:
    from rich.table import Table

    from octoarm_agents.calibration.outcomes import describe_outcomes
    from octoarm_agents.calibration.space import OPEN_NUMBERS
    from octoarm_agents.experiments.emulation.protocol import TASKS

    table = Table(title="Error divided by that of Table 2, and what the best body is")
    table.add_column("")
    searches = result["spaces"]
    for search in searches:
        table.add_column(f"lift {search['lift_scale']:+g}", justify="right")
    table.add_column("best, measured again", justify="right")
    again = result["measured_again"]

    def add(name: str, cells: list[str], last: str) -> None:
        table.add_row(name, *cells, last)

    for name in ("volume_force", "reference_area"):
        add(name, [search[name] for search in searches], result["best"]["body"][name])
    if result["best"]["outcomes"] is not None:
        told = [
            "–" if outcomes is None else describe_outcomes(outcomes)
            for outcomes in (search["best_outcomes"] for search in searches)
        ]
        add("outcomes as in the paper", told, describe_outcomes(result["best"]["outcomes"]))
    for task in TASKS:
        cells = [
            "–" if search["best_ratios"] is None else f"{search['best_ratios'][task]:.3g}"
            for search in searches
        ]
        mean = again["mean_ratios"]
        add(task, cells, "leaves its domain" if mean is None else f"{mean[task]:.3g}")
    scores = [f"{search['best_score']:.3f}" for search in searches]
    add("score", scores, "–" if again["score"] is None else f"{again['score']:.3f}")
    for name in (*OPEN_NUMBERS, "gravity"):
        bodies = [search["best_body"] for search in searches] + [result["best"]["body"]]
        cells = [_number(each[name]) for each in bodies]
        add(name, cells[:-1], cells[-1])
    failures = [f"{search['failures']} of {search['evaluations']}" for search in searches]
    add("left their domain", failures, "")
    console.print(table)


def _number(value: float | list[float]) -> str:
    if isinstance(value, list):
        return " ".join(f"{each:.3g}" for each in value)
    return f"{value:.4g}"


@app.command("sensitivity")
def sensitivity(
    out: Annotated[
        Path,
        typer.Option(help="Folder for sensitivity.json, .png and .md.", callback=output_folder),
    ] = Path("out/calibrate/sensitivity"),
    trials: Annotated[
        int,
        typer.Option(
            help="T_ini over which the errors of Task 1 are averaged.",
            callback=number_between(1, 1001),
        ),
    ] = 3,
    noise_seeds: NoiseSeeds = 2,
    ranges: Annotated[
        str | None,
        typer.Option(help="R of the teachers in degrees.", show_default="5 to 130 in ten steps"),
    ] = None,
    jobs: Jobs = None,
    arm: Arm = None,
) -> None:
    """Move each open parameter of a body alone, and measure the body again.

    Numbers are multiplied by 0.5, 0.8, 1.25 and 2 (a zero takes values over the
    bounds of the search; the density its two ends), signs and readings are
    exchanged, gravity is tilted by 10, 45 and 90 degrees. Measured are the
    errors of Task 1 as ratios to Table 2 at R = 60, for each cycle the largest
    R up to which a teacher can force the arm on a direct base for 10,000 steps,
    and what the paper's own training makes of it.

    Finished bodies are kept in .sensitivity-trials, so that an interrupted run
    goes on there.
    """
    from octoarm_agents.calibration.sensitivity import AMPLITUDES, measure_sensitivity
    from octoarm_agents.calibration.sensitivity_report import sensitivity_markdown

    base = read_body(arm)
    ladder = AMPLITUDES if ranges is None else _parse_ranges(ranges)
    try:
        result = measure_sensitivity(
            base,
            out=out,
            trials=trials,
            amplitudes=ladder,
            noise_seeds=noise_seeds,
            jobs=jobs or os.cpu_count() or 1,
        )
    except ValueError as error:
        raise typer.BadParameter(f"{error}.") from None
    typer.echo(sensitivity_markdown(result))
    typer.echo(f"Wrote sensitivity.json, sensitivity.png and sensitivity.md into {out}.")


@app.command("cycle")
def cycle(
    target: Annotated[
        Literal["quadratic", "van_der_pol", "lissajous"],
        typer.Argument(help="The limit cycle: quadratic, van_der_pol or lissajous."),
    ],
    amplitude: Annotated[
        float,
        typer.Option(
            "--amplitude",
            "-R",
            help="R: largest angle of the target in degrees.",
            callback=number_between(0.1, LARGEST_RANGE, "degrees"),
        ),
    ],
    out: Annotated[
        Path, typer.Option(help="Folder for TARGET-ACTUATOR.json.", callback=output_folder)
    ] = Path("out/calibrate/cycle"),
    actuator: Annotated[
        Literal["direct", "servo"],
        typer.Option(
            help="How the base follows its command: at once, as in the paper, or through a servo."
        ),
    ] = "direct",
    evaluations: Annotated[
        int, typer.Option(help="Teachings tried.", callback=number_between(8, 1_000_000))
    ] = 160,
    noise: Annotated[
        float,
        typer.Option(
            help="Half width in degrees of the noise on the outputs in the first half of a trial.",
            callback=number_between(0.0, 90.0, "degrees"),
        ),
    ] = 0.01,
    steps: Annotated[
        int,
        typer.Option(
            help="Physics steps in closed loop of the one found.",
            callback=number_between(10_000, 100_000_000),
        ),
    ] = 100_000,
    seed: Annotated[
        int, typer.Option(help="Seed of the search.", callback=number_between(0, 2**32 - 2))
    ] = 1,
    arm: Arm = None,
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
        # A thousand steps count as one candidate: about as long.
        with progress_bar(evaluations + steps // 1000, target) as bar:

            def advance(stage: str, count: int) -> None:
                bar.set_postfix_str(stage)
                bar.update(count if stage == "candidates" else count // 1000)

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
    except ValueError as error:  # a body without a static equilibrium
        raise typer.BadParameter(str(error), param_hint="'--arm'") from None
    _print_cycle(Console(), result)
    typer.echo(f"Wrote {out / f'{target}-{actuator}.json'}.")
    scores = result["closed_loop"]["scores"]
    if scores is None or not scores["held"]:
        raise typer.Exit(1)


def _print_cycle(console: Console, result: dict[str, Any]) -> None:
    from rich.table import Table

    settings, teaching, loop = (result[name] for name in ("settings", "teaching", "closed_loop"))
    table = Table(
        title=f"{settings['target']} cycle, {settings['actuator']} base,"
        f" R = {settings['amplitude_degrees']:g}°",
        show_header=False,
    )
    table.add_column("")
    table.add_column("", justify="right")
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
        table.add_row("closed loop", f"lost at step {loop['failure']['step']}")
        table.add_row("", loop["failure"]["message"])
    else:
        distances = f"{scores['mean_distance']:.5f} / {scores['max_distance']:.5f}"
        table.add_row(f"mean / max distance after {loop['steps']} steps, in R", distances)
        table.add_row("held", "yes" if scores["held"] else "no")
    console.print(table)


def _each(choice: str, choices: tuple[str, ...]) -> tuple[str, ...]:
    return choices if choice == BOTH else (choice,)


def _parse_amplitudes(text: str | None) -> dict[str, float]:
    """Parse quadratic=60,van_der_pol=45."""
    from octoarm_env import LIMIT_CYCLES

    found: dict[str, float] = {}
    for part in (text or "").split(",") if text is not None else ():
        target, _, number = part.strip().partition("=")
        amplitude = _amplitude(number)
        if target not in LIMIT_CYCLES or target in found or amplitude is None:
            raise typer.BadParameter(
                f"{part!r}: expected each of {', '.join(LIMIT_CYCLES)} at most once, as in "
                f"quadratic=60, with R above 0 and up to {LARGEST_RANGE:g} degrees.",
                param_hint="'--amplitudes'",
            )
        found[target] = amplitude
    return found


def _parse_ranges(text: str) -> tuple[float, ...]:
    amplitudes = []
    for part in text.split(","):
        amplitude = _amplitude(part)
        if amplitude is None:
            raise typer.BadParameter(
                f"{part!r}: expected numbers of degrees above 0 and up to {LARGEST_RANGE:g}, as in "
                "10,30,60.",
                param_hint="'--ranges'",
            )
        amplitudes.append(amplitude)
    return tuple(amplitudes)


def _amplitude(text: str) -> float | None:
    """A number of degrees; None for what is none, or out of range."""
    try:
        amplitude = float(text)
    except ValueError:
        return None
    return amplitude if math.isfinite(amplitude) and 0 < amplitude <= LARGEST_RANGE else None
