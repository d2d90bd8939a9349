"""The command `octoarm`: a file for every subcommand; slow imports wait until one runs."""

from __future__ import annotations

import io
import sys
from typing import Annotated

import typer

from octoarm_agents import __version__
from octoarm_agents.cli import (
    analyse,
    benchmark,
    calibrate,
    compare,
    dataset,
    demo,
    evaluate,
    reach,
    record,
    reproduce,
    serve,
    train,
    tune,
    watch,
    web,
)

__all__ = ["app", "main"]

app = typer.Typer(
    name="octoarm",
    help="The soft robotic octopus arm of Nakajima et al. (2013) as a reservoir.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)

for panel, commands in (
    ("Learn", (train.train, tune.tune, evaluate.evaluate, compare.compare, dataset.dataset)),
    ("See", (watch.watch, record.record, web.web)),
    ("The body", (demo.demo, reproduce.reproduce)),
    ("Serve and time", (benchmark.benchmark,)),
):
    for command in commands:
        app.command(rich_help_panel=panel)(command)
app.add_typer(reach.app, name="reach", rich_help_panel="Learn")
app.add_typer(analyse.app, name="analyse", rich_help_panel="The body")
app.add_typer(calibrate.app, name="calibrate", rich_help_panel="The body")
app.command(
    rich_help_panel="Serve and time",
    add_help_option=False,
    context_settings={"allow_extra_args": True, "ignore_unknown_options": True},
)(serve.serve)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"octoarm {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    _version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command line."""
    # What an encoding cannot show, Windows' for pipes say, is shown as "?": no work ends in an
    # error because of a degree sign.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    app()
