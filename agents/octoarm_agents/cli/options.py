"""Checks of option values, with messages that name value and allowed range."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from octoarm_env import ArmParameters

__all__ = [
    "EpisodeSeed",
    "EpisodeSteps",
    "NoiseSize",
    "OtherArm",
    "PushSize",
    "need_extra",
    "number_between",
    "output_file",
    "output_folder",
    "read_body",
]


def number_between(
    low: float, high: float, unit: str = ""
) -> Callable[[float | None], float | None]:
    """A callback for an option: its number must lie between `low` and `high`, both allowed.

    NaN is refused; None, an option not given, is let through.
    """

    def check(value: float | None) -> float | None:
        if value is not None and not low <= value <= high:
            of_unit = f" {unit}" if unit else ""
            raise typer.BadParameter(
                f"{value} is not between {low:,.12g} and {high:,.12g}{of_unit}."
            )
        return value

    return check


def output_folder(path: Path) -> Path:
    """A callback for an option: make the folder; it must be writable."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise typer.BadParameter(f"cannot make folder {path}: {error.strerror}.") from None
    if not os.access(path, os.W_OK | os.X_OK):
        raise typer.BadParameter(f"cannot write into folder {path}.")
    return path


def output_file(path: Path | None) -> Path | None:
    """A callback for an option: make the file's folder; it must be writable, and the name free."""
    if path is not None:
        if path.is_dir():
            raise typer.BadParameter(f"{path} is a folder, expected a file.")
        output_folder(path.parent)
    return path


def read_body(path: Path | None) -> ArmParameters:
    """The body of that name or in that JSON file, the default body for None."""
    from octoarm_env import ArmParameters

    try:
        return ArmParameters.of(None if path is None else str(path))
    except OSError as error:
        reason = f"cannot read {path}: {error.strerror}."
    except ValueError as error:
        reason = str(error)
    raise typer.BadParameter(reason, param_hint="'--arm'")


@contextmanager
def need_extra(name: str) -> Iterator[None]:
    """Say which extra to install where an import fails within."""
    try:
        yield
    except ImportError as error:
        # What names an extra of its own has a plainer error behind it.
        reason = error.__cause__ or error
        typer.echo(
            f'{reason}. This command needs more packages: pip install "octoarm-agents[{name}]"',
            err=True,
        )
        raise typer.Exit(1) from None


EpisodeSteps = Annotated[
    int,
    typer.Option(help="Control periods of an episode.", callback=number_between(10, 1_000_000)),
]
EpisodeSeed = Annotated[
    int,
    typer.Option(help="Episode i begins with seed + i.", callback=number_between(0, 2**31 - 1)),
]
PushSize = Annotated[
    float,
    typer.Option(
        help="Push the base by so many degrees for 0.2 s after 1 s.",
        callback=number_between(0.0, 360.0, "degrees"),
    ),
]
NoiseSize = Annotated[
    float,
    typer.Option(
        help="Half width of white noise on the lengths that the agent sees, in metres.",
        callback=number_between(0.0, 0.01, "metres"),
    ),
]
OtherArm = Annotated[
    Path | None,
    typer.Option(
        "--arm",
        help="Another body to act on: nakajima2013, inertial, or a JSON file of parameters.",
        show_default="the agent's own body",
    ),
]
