"""`octoarm analyse`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import typer

from octoarm_agents.cli.options import (
    Actuator,
    Body,
    ClusterAddress,
    Jobs,
    Seed,
    number,
    read_body,
    refused,
    result_folder,
    workers_of,
)
from octoarm_agents.common.progress import stage_bar

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table

    from octoarm_agents.analysis.measures import MeasureSettings
    from octoarm_agents.analysis.survey import ArmSurvey, SurveySettings
    from octoarm_env import ArmParameters


Number = TypeVar("Number", int, float)

app = typer.Typer(
    help="What a reservoir can compute, and what its body's parameters do to it.",
    no_args_is_help=True,
)

# How states are measured, a log's or the arm's.
Out = Annotated[Path, result_folder("analysis.png and analysis.json")]
MaxDelay = Annotated[int, number("Largest delay of the memory capacity, in rows.", 1, 100_000)]
Delays = Annotated[
    str,
    typer.Option(metavar="NUMBERS", help="Oldest input of a capacity of degree 1, 2, …, in rows."),
]
Significance = Annotated[
    float, number("Probability that a capacity of nothing counts.", 1e-12, 0.5)
]
Surrogates = Annotated[
    int, number("Shuffled inputs for the thresholds.", 0, 1000, show_default="chi-square")
]
Training = Annotated[float, number("Share of the rows that the memory readout learns.", 0.1, 0.9)]
Tolerance = Annotated[
    float, number("Least share of the largest singular value in ranks.", 1e-12, 0.5)
]


def _file(content: str, *names: str, **more: Any) -> Any:
    """Give the option of a recording's file."""
    text = f"{content.capitalize()}, a row a sample: .npy, .npz with the key {content!r}, or text."
    return typer.Option(*names, help=text, exists=True, dir_okay=False, metavar="FILE", **more)


def _columns(content: str, default: str) -> Any:
    """Give the option of some columns of a text file."""
    return typer.Option(help=content, metavar="COLUMNS", show_default=default)


@app.command("states")
def states(
    context: typer.Context,
    states_file: Annotated[Path, _file("states", "--states")],
    input_file: Annotated[
        Path | None, _file("input", "--input", show_default="in the states' file")
    ] = None,
    states_columns: Annotated[
        str | None,
        _columns('States: names, patterns such as "spring*", numbers such as 2-81.', "all others"),
    ] = None,
    input_columns: Annotated[
        str | None, _columns("Input, in the states' file or --input.", "all of --input but time")
    ] = None,
    time_column: Annotated[
        str | None, _columns("Times, numbers or ISO 8601.", "none: evenly spaced rows")
    ] = None,
    skip_lines: Annotated[int, number("Lines of a text file before the table.", 0, 10**6)] = 0,
    fill_gaps: Annotated[int, number("Longest gap that is filled, in rows.", 0, 10**6)] = 0,
    hold: Annotated[
        int | None,
        number("Rows that an input is held for.", 1, 10**6, show_default="1; more is refused"),
    ] = None,
    out: Out = Path("out/analysis"),
    washout: Annotated[int, number("Rows left out at the begin.", 0, 10**7)] = 100,
    max_delay: MaxDelay = 60,
    delays: Delays = "60,25,15,9,6",
    noise: Annotated[
        float, number("ν: half width of white noise on each state, in its unit.", 0.0, 1e12)
    ] = 0.0,
    significance: Significance = 1e-4,
    surrogates: Surrogates = 0,
    polynomials: Annotated[
        Literal["auto", "legendre", "hermite", "empirical"],
        typer.Option(
            metavar="FAMILY",
            help="auto, legendre for a uniform input, hermite for a normal one, or empirical.",
        ),
    ] = "auto",
    training: Training = 0.7,
    tolerance: Tolerance = 1e-3,
    seed: Seed = 0,
) -> None:
    """Measure a recording of states and input, of the arm or of any other reservoir.

    Linear memory capacity, information processing capacity, and the rank of the
    states (docs/analysis.md explains them). The input should be independent from
    row to row; row t of the states has seen input t. Logs of instruments are taken
    as they are: with a header or without, decimal commas, units, comments
    (docs/your-own-log.md).
    """
    from octoarm_agents.analysis.figure import draw_analysis
    from octoarm_agents.analysis.measures import measure
    from octoarm_agents.analysis.recording_file import read_recording
    from octoarm_agents.analysis.tables import measures_table

    settings = _measure_settings(context)
    with refused():
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
    _finish(out, result.to_dict(), draw_analysis(result), measures_table(result), result.warnings)


@app.command("arm")
def arm(
    context: typer.Context,
    out: Out = Path("out/analysis"),
    body: Body = None,
    actuator: Actuator = "direct",
    amplitude: Annotated[
        float, number("R: angle of an input of 1.", 0.001, 360.0, "degrees", "--amplitude", "-R")
    ] = 20.0,
    hold: Annotated[float, number("Seconds that each input value lasts.", 0.002, 10.0, "s")] = 0.05,
    axes: Annotated[
        Literal["both", "theta"], typer.Option(help="Turn θ and φ alike (Eq. 16), or θ alone.")
    ] = "both",
    samples: Annotated[int, number("Input values that are measured.", 400, 10**6)] = 10_000,
    washout: Annotated[int, number("Input values before anything is measured.", 0, 10**6)] = 500,
    max_delay: MaxDelay = 60,
    delays: Delays = "60,25,15,9,6",
    noise: Annotated[
        float, number("ν: half width of white noise on each length.", 0.0, 0.01, "metres")
    ] = 0.0,
    significance: Significance = 1e-4,
    surrogates: Surrogates = 0,
    training: Training = 0.7,
    tolerance: Tolerance = 1e-3,
    sweep: Annotated[
        Literal["stiffness", "damping", "drag", "range"] | None,
        typer.Option(
            metavar="NAME",
            help="Measure again and again with other stiffness, damping, drag or range.",
            show_default="none",
        ),
    ] = None,
    values: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBERS",
            help="Values of the sweep: factors, for the range degrees.",
            show_default="1/4 to 4, range R/8 to 2 R",
        ),
    ] = None,
    jobs: Jobs = None,
    cluster: ClusterAddress = None,
    seed: Seed = 0,
) -> None:
    """Drive the arm with an independent random input and measure what its body computes.

    Input values are uniform in [-1, 1]; each lasts one hold, in which the base
    moves on a minimum-jerk path; the spring lengths at its end are the states.
    Measured are memory capacity, information processing capacity, ranks, how the
    initial state is forgotten, and the largest conditional Lyapunov exponent
    (docs/analysis.md explains them). --sweep repeats all (section 4 of the paper).

    Exit status: 0; 1 if the arm left its domain, in a sweep at every value; 2
    for bad options.
    """
    from dataclasses import asdict

    from octoarm_agents.analysis.drive import Drive
    from octoarm_agents.analysis.figure import draw_analysis
    from octoarm_agents.analysis.survey import SurveySettings
    from octoarm_agents.analysis.sweep import QUANTITIES, default_values, run_sweep
    from octoarm_agents.analysis.sweep_figure import draw_sweep
    from octoarm_agents.analysis.tables import survey_table, sweep_table

    if sweep is None and values is not None:
        raise typer.BadParameter("only --sweep takes values.", param_hint="'--values'")
    if sweep is None and cluster is not None:
        raise typer.BadParameter("only --sweep can use one.", param_hint="'--cluster'")
    parameters = read_body(body)
    measures = _measure_settings(context)
    settings = SurveySettings(Drive(amplitude, hold, axes, actuator), measures, samples)
    with refused():
        if sweep is None:
            survey = _survey(parameters, settings)
            warnings = survey.measures.warnings
            figure = draw_analysis(survey.measures, survey)
            _finish(out, survey.to_dict(), figure, survey_table(survey), warnings)
            return
        chosen = default_values(sweep, settings)
        if values is not None:
            chosen = _numbers(values, float, "--values")
        points = run_sweep(sweep, chosen, parameters, settings, workers_of(jobs, cluster))
    warnings = [
        f"{sweep} {point.value:g}: {warning}"
        for point in points
        for warning in (point.summary or {}).get("warnings", ())
    ]
    content = {
        "quantity": sweep,
        "meaning": QUANTITIES[sweep],
        "points": [point.to_dict() for point in points],
        "survey": settings.to_dict(parameters.timestep),
        "measures": asdict(measures),
        "body": parameters.to_dict(),
    }
    _finish(out, content, draw_sweep(sweep, points), sweep_table(sweep, points), warnings)
    for point in points:
        if point.failure is not None:
            typer.echo(f"{sweep} {point.value:g}: {point.failure}", err=True)
    if all(point.summary is None for point in points):
        raise typer.Exit(1)


def _measure_settings(context: typer.Context) -> MeasureSettings:
    """Read the options that say how to measure, by the names that both commands give them."""
    from octoarm_agents.analysis.measures import MeasureSettings

    given = context.params
    alike = ("max_delay", "washout", "noise", "significance", "surrogates", "tolerance", "seed")
    family = given.get("polynomials", "auto")
    return MeasureSettings(
        **{name: given[name] for name in alike},
        delays=_numbers(given["delays"], int, "--delays"),
        training_fraction=given["training"],
        family=None if family == "auto" else family,
    )


def _survey(parameters: ArmParameters, settings: SurveySettings) -> ArmSurvey:
    """All measures of the arm; where it leaves its domain, the command ends."""
    from octoarm_agents.analysis.survey import survey_arm
    from octoarm_env import DomainError

    stages = ["starting"]
    try:
        with stage_bar("starting") as advance:

            def note(stage: str, share: float) -> None:
                stages.append(stage)
                advance(stage, share)

            return survey_arm(parameters, settings, note)
    except DomainError as error:
        typer.echo(f"Ended during {stages[-1]}: {error}.", err=True)
        typer.echo("The input is too much for this body: try a smaller --amplitude.", err=True)
        raise typer.Exit(1) from None


@app.command("sensitivity")
def sensitivity(
    out: Annotated[Path, result_folder("sensitivity.json, .png and .md")] = Path(
        "out/analysis/sensitivity"
    ),
    trials: Annotated[int, number("T_ini over which the errors are averaged.", 1, 1001)] = 3,
    noise_seeds: Annotated[int, number("Trainings of each cycle, as in the paper.", 0, 100)] = 2,
    ranges: Annotated[
        str | None,
        typer.Option(help="R of the teachers in degrees.", show_default="5 to 130 in ten steps"),
    ] = None,
    jobs: Jobs = None,
    cluster: ClusterAddress = None,
    body: Body = None,
) -> None:
    """Move each parameter that the paper leaves open alone, and measure the body again.

    Measured are the errors of Task 1 as ratios to Table 2 at R = 60, for each
    cycle the largest R up to which a teacher can force the arm on a direct base
    for 10,000 steps, and what the paper's own training makes of it (docs/body.md).
    Finished bodies are kept in .sensitivity-trials, so that an interrupted run
    goes on there.
    """
    from octoarm_agents.calibration.sensitivity import AMPLITUDES, measure_sensitivity
    from octoarm_agents.calibration.sensitivity_report import sensitivity_markdown

    base = read_body(body)
    ladder = AMPLITUDES if ranges is None else _numbers(ranges, float, "--ranges")
    with refused():
        result = measure_sensitivity(
            base,
            out=out,
            trials=trials,
            amplitudes=ladder,
            noise_seeds=noise_seeds,
            jobs=workers_of(jobs, cluster),
        )
    typer.echo(sensitivity_markdown(result))
    typer.echo(f"Wrote sensitivity.json, sensitivity.png and sensitivity.md into {out}.")


def _finish(
    out: Path, content: dict[str, Any], figure: Figure, table: Table, warnings: Iterable[str]
) -> None:
    """Write the two files, print the table and what the reader of it should know."""
    from rich.console import Console

    from octoarm_agents.common.files import write_atomically, write_json
    from octoarm_agents.common.provenance import describe_machine, package_versions

    versions = package_versions("octoarm-env", "octoarm-agents", "numpy", "scipy", "matplotlib")
    computed_with = {"versions": versions, "machine": describe_machine()}
    write_json(out / "analysis.json", content | computed_with)
    write_atomically(out / "analysis.png", figure.savefig)
    console = Console()
    console.print(table)
    for warning in warnings:
        console.print(warning, soft_wrap=True, markup=False)
    console.print(f"Wrote {out / 'analysis.png'} and {out / 'analysis.json'}.", soft_wrap=True)


def _numbers(text: str, kind: Callable[[str], Number], option: str) -> tuple[Number, ...]:
    """The numbers in an option that takes several."""
    try:
        return tuple(kind(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(
            f"{text!r}: expected {'whole ' * (kind is int)}numbers with commas between them.",
            param_hint=f"'{option}'",
        ) from None
