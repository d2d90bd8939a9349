"""`octoarm analyse`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from octoarm_agents.cli.log_options import (
    FillGaps,
    Hold,
    InputColumns,
    SkipLines,
    StatesColumns,
    TimeColumn,
)
from octoarm_agents.cli.options import number_between, output_folder, read_body
from octoarm_agents.common.progress import progress_bar, stage_bar

if TYPE_CHECKING:
    from rich.console import Console

    from octoarm_agents.analysis.measures import MeasureSettings
    from octoarm_agents.analysis.survey import SurveySettings
    from octoarm_agents.analysis.sweep import Quantity

__all__ = ["app"]

app = typer.Typer(
    help="What a reservoir can compute, from its states and its input.",
    no_args_is_help=True,
)

Out = Annotated[
    Path, typer.Option(help="Folder for analysis.png and analysis.json.", callback=output_folder)
]
MaxDelay = Annotated[
    int,
    typer.Option(
        help="Largest delay of the memory capacity, in rows.", callback=number_between(1, 100_000)
    ),
]
Delays = Annotated[
    str,
    typer.Option(
        help="Oldest input in the functions of degree 1, 2, … of the processing capacity, in rows."
    ),
]
Significance = Annotated[
    float,
    typer.Option(
        help="Probability that a capacity of nothing counts.", callback=number_between(1e-12, 0.5)
    ),
]
Surrogates = Annotated[
    int,
    typer.Option(
        help="Shuffled inputs whose largest processing capacity is the threshold, "
        "instead of the chi-square distribution.",
        show_default="chi-square",
        callback=number_between(0, 1000),
    ),
]
Training = Annotated[
    float,
    typer.Option(
        help="Share of the rows that the memory readout learns from; the others test it.",
        callback=number_between(0.1, 0.9),
    ),
]
Tolerance = Annotated[
    float,
    typer.Option(
        help="Singular values above this share of the largest count in the ranks.",
        callback=number_between(1e-12, 0.5),
    ),
]
Seed = Annotated[
    int, typer.Option(help="Seed of all that is random.", callback=number_between(0, 2**32 - 1))
]


@app.command("states")
def states(
    states_file: Annotated[
        Path,
        typer.Option(
            "--states",
            help="States, a row a sample: .npy, .npz with the key 'states', or a text file "
            "(.csv, .tsv, .txt).",
            exists=True,
            dir_okay=False,
        ),
    ],
    input_file: Annotated[
        Path | None,
        typer.Option(
            "--input",
            help="Input, a row a sample: .npy, .npz with the key 'input', or a text file.",
            exists=True,
            dir_okay=False,
            show_default="in the states' file",
        ),
    ] = None,
    states_columns: StatesColumns = None,
    input_columns: InputColumns = None,
    time_column: TimeColumn = None,
    skip_lines: SkipLines = 0,
    fill_gaps: FillGaps = 0,
    hold: Hold = None,
    out: Out = Path("out/analysis"),
    washout: Annotated[
        int,
        typer.Option(help="Rows left out at the begin.", callback=number_between(0, 10_000_000)),
    ] = 100,
    max_delay: MaxDelay = 60,
    delays: Delays = "60,25,15,9,6",
    noise: Annotated[
        float,
        typer.Option(
            help="ν: half width of white noise on each state, in the states' unit; "
            "0 takes the pseudo-inverse.",
            callback=number_between(0.0, 1e12),
        ),
    ] = 0.0,
    significance: Significance = 1e-4,
    surrogates: Surrogates = 0,
    polynomials: Annotated[
        Literal["auto", "legendre", "hermite", "empirical"],
        typer.Option(
            help="Polynomials of the input: for a uniform one, a normal one, any one; "
            "auto tests its distribution."
        ),
    ] = "auto",
    training: Training = 0.7,
    tolerance: Tolerance = 1e-3,
    seed: Seed = 0,
) -> None:
    """Measure a recording of states and input, of the arm or of any other reservoir.

    The input should be independent from row to row; row t of the states has
    seen input t. Logs of instruments are taken as they are: with a header or
    without, decimal commas, units, comments (docs/your-own-log.md).

    Linear memory capacity (Jaeger 2002, "Short term memory in echo state
    networks"): for each delay the share of the input's variance that a linear
    readout with bias recovers, summed over the delays 1 … K. On all rows,
    corrected for the bias of the fit by leaving each row out of it, and as
    squared correlation on rows held out.

    Information processing capacity (Dambre et al. 2012, "Information processing
    capacity of dynamical systems"): the same for all products of orthonormal
    polynomials of delayed inputs, up to a degree and a delay. For an
    independent input the sum cannot exceed the rank of the states.

    Rank: of the states to rounding, above a tolerance, and as participation
    ratio of their variances.

    A capacity counts if it is a larger multiple of its bias than chance gives
    with the probability --significance (chi-square distribution), or than all
    --surrogates give.
    """
    from rich.console import Console

    from octoarm_agents.analysis.figure import draw_analysis
    from octoarm_agents.analysis.measures import MeasureSettings, measure
    from octoarm_agents.analysis.recording_file import read_recording
    from octoarm_agents.analysis.tables import measures_table
    from octoarm_agents.common.files import write_atomically, write_json

    settings = MeasureSettings(
        max_delay=max_delay,
        delays=_parse_delays(delays),
        washout=washout,
        noise=noise,
        significance=significance,
        surrogates=surrogates,
        family=None if polynomials == "auto" else polynomials,
        training_fraction=training,
        tolerance=tolerance,
        seed=seed,
    )
    console = Console()
    try:
        recording = read_recording(
            states_file,
            input_file,
            states_columns=states_columns,
            input_columns=input_columns,
            time_column=time_column,
            skip_lines=skip_lines,
            fill_gaps=fill_gaps,
            hold=hold,
        )
        with stage_bar("measuring") as advance:
            result = measure(recording, settings, advance)
    except OSError as error:
        raise typer.BadParameter(f"cannot read {error.filename}: {error.strerror}.") from None
    except ValueError as error:
        raise typer.BadParameter(f"{error}.") from None
    write_json(out / "analysis.json", result.to_dict() | _computed_with())
    write_atomically(out / "analysis.png", draw_analysis(result).savefig)
    console.print(measures_table(result))
    _finish(console, result.warnings, out)


@app.command("arm")
def arm(
    out: Out = Path("out/analysis"),
    body: Annotated[
        Path | None,
        typer.Option(
            "--arm",
            help="A body: nakajima2013, inertial, or a JSON file of parameters.",
            show_default="the default body",
        ),
    ] = None,
    actuator: Annotated[
        Literal["direct", "servo"],
        typer.Option(
            help="How the base follows its command: at once, as in the paper, or through a servo."
        ),
    ] = "direct",
    amplitude: Annotated[
        float,
        typer.Option(
            "--amplitude",
            "-R",
            help="R: angle of an input of 1 in degrees.",
            callback=number_between(0.001, 360.0, "degrees"),
        ),
    ] = 20.0,
    hold: Annotated[
        float,
        typer.Option(
            help="Seconds that each input value lasts.", callback=number_between(0.002, 10.0, "s")
        ),
    ] = 0.05,
    axes: Annotated[
        Literal["both", "theta"],
        typer.Option(help="Turn θ and φ by the same angle (Eq. 16), or θ alone."),
    ] = "both",
    samples: Annotated[
        int,
        typer.Option(
            help="Input values that are measured.", callback=number_between(400, 1_000_000)
        ),
    ] = 10_000,
    washout: Annotated[
        int,
        typer.Option(
            help="Input values before anything is measured.", callback=number_between(0, 1_000_000)
        ),
    ] = 500,
    max_delay: MaxDelay = 60,
    delays: Delays = "60,25,15,9,6",
    noise: Annotated[
        float,
        typer.Option(
            help="ν: half width in metres of white noise on each spring length; "
            "0 takes the pseudo-inverse.",
            callback=number_between(0.0, 0.01, "metres"),
        ),
    ] = 0.0,
    significance: Significance = 1e-4,
    surrogates: Surrogates = 0,
    training: Training = 0.7,
    tolerance: Tolerance = 1e-3,
    sweep: Annotated[
        Literal["stiffness", "damping", "drag", "range"] | None,
        typer.Option(help="Measure again and again with this changed.", show_default="none"),
    ] = None,
    values: Annotated[
        str | None,
        typer.Option(
            help="Values of the sweep: factors, for the range degrees.",
            show_default="1/4 to 4, range R/8 to 2 R",
        ),
    ] = None,
    jobs: Annotated[
        int,
        typer.Option(help="Processes for the sweep.", callback=number_between(1, 1024)),
    ] = 1,
    seed: Seed = 0,
) -> None:
    """Drive the arm with an independent random input and measure what its body computes.

    Input values are uniform in [-1, 1]; each lasts one hold, in which the base
    moves from the last value's angle to this value's on a minimum-jerk path.
    The spring lengths at the end of each hold are the states. Measured are
    memory capacity, information processing capacity and rank, as by `octoarm
    analyse states`, and of the arm itself:

    Kernel rank and generalisation rank (Legenstein and Maass 2007; Büsing et
    al. 2010): of the states after many different input streams, and after many
    similar ones, at the same resolution.

    Echo-state test (Jaeger 2001): the distance between an arm from rest and one
    that another input moved before, under the same input; its decay time.

    Largest conditional Lyapunov exponent (Benettin et al. 1980): the rate at
    which two nearby arms under the same input part, or meet if it is negative.

    With --sweep all is repeated over stiffness, damping, drag or range (section
    4 of the paper).

    Exit status: 0; 1 if the arm left its domain, in a sweep at every value; 2
    for bad options.
    """
    from rich.console import Console

    from octoarm_agents.analysis.drive import Drive
    from octoarm_agents.analysis.measures import MeasureSettings
    from octoarm_agents.analysis.survey import SurveySettings

    if sweep is None and values is not None:
        raise typer.BadParameter("only --sweep takes values.", param_hint="'--values'")
    parameters = read_body(body)
    measures = MeasureSettings(
        max_delay=max_delay,
        delays=_parse_delays(delays),
        washout=washout,
        noise=noise,
        significance=significance,
        surrogates=surrogates,
        training_fraction=training,
        tolerance=tolerance,
        seed=seed,
    )
    drive = Drive(amplitude, hold, axes, actuator)
    settings = SurveySettings(drive, measures, samples)
    try:
        if sweep is None:
            _survey(Console(), parameters, settings, out)
        else:
            _sweep(Console(), sweep, values, parameters, settings, jobs, out)
    except ValueError as error:
        raise typer.BadParameter(f"{error}.") from None


def _survey(console: Console, parameters: Any, settings: SurveySettings, out: Path) -> None:
    from octoarm_agents.analysis.figure import draw_analysis
    from octoarm_agents.analysis.survey import survey_arm
    from octoarm_agents.analysis.tables import survey_table
    from octoarm_agents.common.files import write_atomically, write_json
    from octoarm_env import DomainError

    stages = ["starting"]

    try:
        with stage_bar("starting") as advance:

            def note(stage: str, share: float) -> None:
                stages.append(stage)
                advance(stage, share)

            result = survey_arm(parameters, settings, note)
    except DomainError as error:
        typer.echo(f"Ended during {stages[-1]}: {error}.", err=True)
        typer.echo("The input is too much for this body: try a smaller --amplitude.", err=True)
        raise typer.Exit(1) from None
    write_json(out / "analysis.json", result.to_dict() | _computed_with())
    write_atomically(out / "analysis.png", draw_analysis(result.measures, result).savefig)
    console.print(survey_table(result))
    _finish(console, result.measures.warnings, out)


def _sweep(
    console: Console,
    quantity: Quantity,
    values: str | None,
    parameters: Any,
    settings: SurveySettings,
    jobs: int,
    out: Path,
) -> None:
    from octoarm_agents.analysis.sweep import QUANTITIES, default_values, run_sweep
    from octoarm_agents.analysis.sweep_figure import draw_sweep
    from octoarm_agents.analysis.tables import sweep_table
    from octoarm_agents.common.files import write_atomically, write_json

    chosen = default_values(quantity, settings) if values is None else _parse_values(values)
    with progress_bar(len(chosen), quantity) as bar:
        points = run_sweep(quantity, chosen, parameters, settings, jobs, lambda point: bar.update())
    content = {
        "quantity": quantity,
        "meaning": QUANTITIES[quantity],
        "points": [point.to_dict() for point in points],
        "survey": settings.to_dict(parameters.timestep),
        "measures": _plain(settings.measures),
        "body": parameters.to_dict(),
    }
    write_json(out / "analysis.json", content | _computed_with())
    write_atomically(out / "analysis.png", draw_sweep(quantity, points).savefig)
    console.print(sweep_table(quantity, points))
    for point in points:
        if point.failure is not None:
            typer.echo(f"{quantity} {point.value:g}: {point.failure}", err=True)
    warnings = [
        f"{quantity} {point.value:g}: {warning}"
        for point in points
        for warning in (point.summary or {}).get("warnings", ())
    ]
    _finish(console, warnings, out)
    if all(point.summary is None for point in points):
        raise typer.Exit(1)


def _finish(console: Console, warnings: list[str], out: Path) -> None:
    for warning in warnings:
        console.print(warning, soft_wrap=True, markup=False)
    console.print(f"Wrote {out / 'analysis.png'} and {out / 'analysis.json'}.", soft_wrap=True)


def _computed_with() -> dict[str, Any]:
    from octoarm_agents.common.provenance import describe_machine, package_versions

    names = ("octoarm-env", "octoarm-agents", "numpy", "scipy", "matplotlib")
    return {"versions": package_versions(*names), "machine": describe_machine()}


def _plain(settings: MeasureSettings) -> dict[str, Any]:
    from dataclasses import asdict

    return asdict(settings) | {"delays": list(settings.delays)}


def _parse_delays(text: str) -> tuple[int, ...]:
    try:
        delays = tuple(int(part) for part in text.split(","))
    except ValueError:
        delays = ()
    if not delays or min(delays) < 0:
        raise typer.BadParameter(
            f"{text!r}: expected whole numbers, not negative, with commas between them.",
            param_hint="'--delays'",
        )
    return delays


def _parse_values(text: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if not values or not all(0 < value < float("inf") for value in values):
        raise typer.BadParameter(
            f"{text!r}: expected positive numbers with commas between them.",
            param_hint="'--values'",
        )
    return values
