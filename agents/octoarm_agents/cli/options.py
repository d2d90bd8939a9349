"""Options that several commands take, each written once, and checks of option values.

A command's own numbers are written ``Annotated[int, number("Rows left out.", 0, 1000)]``.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

if TYPE_CHECKING:
    from octoarm_agents.common import workers
    from octoarm_env import ArmParameters


def number(help: str, low: float, high: float, unit: str = "", *names: str, **more: Any) -> Any:
    """Give an option of a number between `low` and `high`, both allowed.

    NaN is refused; None, an option not given, is let through. `names` and `more`, `show_default`
    mostly, are as in `typer.Option`.
    """

    def check(value: float | None) -> float | None:
        if value is not None and not low <= value <= high:
            of_unit = f" {unit}" if unit else ""
            raise typer.BadParameter(
                f"{value} is not between {low:,.12g} and {high:,.12g}{of_unit}."
            )
        return value

    return typer.Option(*names, help=help, callback=check, **more)


def result_folder(content: str, **more: Any) -> Any:
    """Give the option of a folder for `content`, made if need be."""
    return typer.Option(help=f"Folder for {content}.", callback=output_folder, **more)


def result_file(content: str, **more: Any) -> Any:
    """Give the option of a file for `content`, its folder made if need be."""
    return typer.Option(help=content, callback=output_file, **more)


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


def workers_of(jobs: int | None, cluster: str | None) -> workers.Jobs:
    """Where to compute: what `--jobs` and `--cluster` ask for."""
    if cluster is None:
        return jobs or os.cpu_count() or 1
    from octoarm_agents.common.workers import Cluster

    with need_extra("ray"), refused("--cluster"):
        return Cluster.connect(cluster, jobs)


def read_body(path: Path | None) -> ArmParameters:
    """The body of that name or in that JSON file, the default body for None."""
    from octoarm_env import ArmParameters

    with refused("--arm"):
        return ArmParameters.of(None if path is None else str(path))


@contextmanager
def refused(option: str | None = None, about: str = "") -> Iterator[None]:
    """Turn a ValueError within, or what the system refuses, into the answer to a bad option.

    `about` stands before the message.
    """
    hint = None if option is None else f"'{option}'"
    try:
        yield
    except ValueError as error:
        raise typer.BadParameter(f"{about}{error}.", param_hint=hint) from None
    except OSError as error:
        file = f"cannot open {error.filename}: " if error.filename else ""
        raise typer.BadParameter(f"{file}{error.strerror or error}.", param_hint=hint) from None


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


Seed = Annotated[int, number("Seed of all that is random.", 0, 2**32 - 1)]
Jobs = Annotated[
    int | None,
    number(
        "Processes; the results do not depend on it.", 1, 1024, show_default="number of processors"
    ),
]
_CLUSTER = (
    "Compute on a Ray cluster in place of processes here: its address, or auto for that in"
    " RAY_ADDRESS or of the cluster that this machine belongs to. See docs/cluster.md."
)
ClusterAddress = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help=_CLUSTER, show_default="none")
]
Algorithm = Annotated[
    Literal["ppo", "sac", "tqc", "recurrent_ppo"],
    typer.Argument(help="What trains.", show_default=False),
]

# The body and its target.
_BODY = "A body: nakajima2013, inertial, or a JSON file of parameters."
Body = Annotated[Path | None, typer.Option("--arm", help=_BODY, show_default="the default body")]
OtherBody = Annotated[
    Path | None, typer.Option("--arm", help=_BODY, show_default="the agent's own body")
]
_TargetName = Literal["quadratic", "van_der_pol", "lissajous"]
Actuator = Annotated[
    Literal["direct", "servo"],
    typer.Option(
        help="How the base follows its command: at once, as in the paper, or through a servo."
    ),
]
Target = Annotated[
    _TargetName,
    typer.Option(
        metavar="NAME", help="Limit cycle: quadratic, van_der_pol or lissajous (Eqs. 28, 27, 29)."
    ),
]
TargetArgument = Annotated[
    _TargetName, typer.Argument(help="The limit cycle: quadratic, van_der_pol or lissajous.")
]
MouseTarget = Annotated[
    _TargetName | None,
    typer.Option("--target", help="What the mouse is to follow.", show_default="quadratic"),
]
_AMPLITUDE = "R: largest angle of the target in degrees."
Amplitude = Annotated[
    float | None,
    number(_AMPLITUDE, 0.1, 360.0, "degrees", "--amplitude", "-R", show_default="the paper's"),
]

# An episode of an agent.
EpisodeSteps = Annotated[int, number("Control periods of an episode.", 10, 1_000_000)]
EpisodeSeed = Annotated[int, number("Episode i begins with seed + i.", 0, 2**31 - 1)]
_PUSH = "Push the base by so many degrees for 0.2 s after 1 s."
PushSize = Annotated[float, number(_PUSH, 0.0, 360.0, "degrees")]
_NOISE = "Half width of white noise on the lengths that the agent sees, in metres."
NoiseSize = Annotated[float, number(_NOISE, 0.0, 0.01, "metres")]

# Bodies that vary.
_VARY = (
    "Draw bodies around the arm: a parameter and the range of its factor, such as"
    " arm_density=0.9,1.1; may be repeated."
)
Vary = Annotated[
    list[str] | None, typer.Option(metavar="NAME=LOW,HIGH", help=_VARY, show_default="none")
]
Bodies = Annotated[int, number("With --vary: bodies that are drawn.", 1, 256)]
BodySeed = Annotated[int, number("With --vary: seed of these bodies.", 0, 2**63 - 1)]


def varied(vary: list[str] | None, bodies: int, body_seed: int) -> dict[str, Any]:
    """The arguments of an environment that `Vary`, `Bodies` and `BodySeed` ask for."""
    if not vary:
        return {}
    factors = {}
    for text in vary:
        name, _, pair = text.partition("=")
        try:
            low, high = map(float, pair.split(","))
        except ValueError:
            message = f"{text!r}: expected NAME=LOW,HIGH."
            raise typer.BadParameter(message, param_hint="'--vary'") from None
        factors[name] = low, high
    return {"vary": factors, "bodies": bodies, "body_seed": body_seed}
