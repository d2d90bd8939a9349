"""`octoarm inspect`."""

from __future__ import annotations

import os
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from urllib.parse import quote

import typer

from octoarm_agents.cli.actors import ACTOR_HELP, Actor, find_actor
from octoarm_agents.cli.options import (
    EpisodeSeed,
    EpisodeSteps,
    NoiseSize,
    OtherArm,
    PushSize,
    need_extra,
    output_file,
    output_folder,
)
from octoarm_agents.common.progress import progress_bar

if TYPE_CHECKING:
    from rerun import RecordingStream

    from octoarm_agents.inspection import EpisodeLog
    from octoarm_agents.policies.episode import Episode

__all__ = ["inspect"]

_VIEWER_PORT, _BROWSER_PORT = 9876, 9090
"""Where Rerun's viewers listen as a rule."""
_PATIENCE = 60.0
"""How long a viewer may take for what is sent at the end [s]."""


def inspect(
    policy: Annotated[str, typer.Argument(help=ACTOR_HELP, show_default=False)],
    out: Annotated[
        Path | None,
        typer.Option(
            help="File for the recording, .rrd; about 10 kB a step.",
            callback=output_file,
            show_default="out/inspect/AGENT-TARGET-SEED.rrd",
        ),
    ] = None,
    spawn: Annotated[
        bool, typer.Option("--spawn", help="Open the Rerun viewer instead of writing a file.")
    ] = False,
    serve: Annotated[
        bool,
        typer.Option(
            "--serve",
            help="Show the recording in a browser instead of writing a file, to Ctrl-C. The "
            "data are for this machine alone; the viewer's page, without data, is served to all.",
        ),
    ] = False,
    steps: EpisodeSteps = 500,
    seed: EpisodeSeed = 0,
    push: PushSize = 0.0,
    noise: NoiseSize = 0.0,
    arm: OtherArm = None,
) -> None:
    """Record all of an episode for the Rerun viewer, to look at any moment.

    The arm in space with its four rows of springs, the length of each of the
    80, the angles of the base beside what was commanded and what should be,
    errors, the terms of the reward, and what happened when: on a timeline of
    seconds and on one of steps.

    Open the file with `rerun FILE.rrd`. It appears whole or not at all: an
    interrupted run leaves nothing behind. The same call records the same data.
    """
    if [out is not None, spawn, serve].count(True) > 1:
        raise typer.BadParameter("choose one of --out, --spawn and --serve.")
    if out is not None and out.suffix != ".rrd":
        raise typer.BadParameter(f"{out} does not end in .rrd.", param_hint="'--out'")
    actor = find_actor(policy, arm)
    with need_extra("inspect"):
        from octoarm_agents import inspection
    from octoarm_agents.policies.episode import Episode

    file = None if spawn or serve else out or Path("out/inspect") / _file_name(actor, seed)
    address = ""
    env = actor.make_env(steps)
    try:
        assert actor.policy is not None
        episode = Episode(actor.policy, env, seed=seed, steps=steps, push=push, noise=noise)

        def log(recording: RecordingStream) -> None:
            title = f"{actor.name}, seed {seed}"
            _log(inspection.EpisodeLog(recording, episode, title, push=push, noise=noise), episode)

        if file is not None:
            output_folder(file.parent)
            with inspection.recording_file(file) as recording:
                log(recording)
        elif spawn:
            with _recording_in_viewer() as recording:
                log(recording)
        else:
            recording, address = _recording_in_browser(open_browser=sys.stdout.isatty())
            log(recording)
    except KeyboardInterrupt:
        typer.echo("Stopped; no recording was written.", err=True)
        raise typer.Exit(130) from None
    except inspection.RecordingError as error:
        hint = " Leave --spawn out to write a file." if spawn else ""
        typer.echo(f"cannot record: {error}.{hint}", err=True)
        raise typer.Exit(1) from None
    except OSError as error:
        typer.echo(f"cannot write {file}: {error}.", err=True)
        raise typer.Exit(1) from None
    except ValueError as error:
        raise typer.BadParameter(f"{error}.") from None
    finally:
        env.close()
    typer.echo(episode.report())
    if file is not None:
        typer.echo(f"Wrote {file}, {file.stat().st_size / 1e6:.2f} MB.")
        typer.echo(f"Look at it: rerun {file}")
    if serve:
        _wait(address)


def _log(log: EpisodeLog, episode: Episode) -> None:
    with progress_bar(episode.steps, "recording", unit=" steps") as bar:
        while not episode.ended:
            episode.step()
            log.step()
            bar.update()
    log.finish()


@contextmanager
def _recording_in_viewer() -> Iterator[RecordingStream]:
    """Give a recording that Rerun's viewer shows at once; one that is open already is used.

    Raises:
        RecordingError: no viewer opens, it closes too early, or logging is switched off.
    """
    from octoarm_agents.inspection import RecordingError, begin_recording

    recording = begin_recording()
    if not _listens(_VIEWER_PORT):
        _open_viewer(recording)
    recording.connect_grpc(f"rerun+http://127.0.0.1:{_VIEWER_PORT}/proxy")
    try:
        yield recording
        try:
            recording.flush(timeout_sec=_PATIENCE)
        except RuntimeError as error:
            raise RecordingError(f"the viewer did not take all of it: {error}") from None
    finally:
        recording.disconnect()


def _open_viewer(recording: RecordingStream) -> None:
    import rerun

    from octoarm_agents.inspection import RecordingError

    if sys.platform.startswith("linux") and not any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
    ):
        raise RecordingError("there is no display for the viewer's window")
    beside = Path(sys.executable).with_name("rerun")
    try:
        rerun.spawn(
            port=_VIEWER_PORT,
            connect=False,
            hide_welcome_screen=True,
            executable_path=str(beside) if beside.exists() else None,
            recording=recording,
        )
    except RuntimeError as error:
        reason = str(error).partition("\n")[0].rstrip(".")
        raise RecordingError(f"the viewer did not open: {reason}") from None
    # A viewer that could not open its window has ended by now.
    if not _listens(_VIEWER_PORT):
        raise RecordingError("the viewer did not open")


def _recording_in_browser(*, open_browser: bool) -> tuple[RecordingStream, str]:
    """Give a recording that a browser on this machine can show, and the address to open there.

    It can be looked at as long as this process lives.

    Args:
        open_browser: open the address here and now.

    Raises:
        RecordingError: logging is switched off, or there is no port to listen at.
    """
    import rerun

    from octoarm_agents.inspection import RecordingError, begin_recording

    recording = begin_recording()
    sink = rerun.GrpcServerSink(bind_ip="127.0.0.1", port=_free_port(_VIEWER_PORT))
    recording.set_sinks(sink)
    port = _free_port(_BROWSER_PORT)
    try:
        rerun.serve_web_viewer(web_port=port, open_browser=open_browser, connect_to=sink.uri)
    except RuntimeError as error:
        raise RecordingError(f"{error}") from None
    return recording, f"http://localhost:{port}/?url={quote(sink.uri, safe='')}"


def _listens(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=2.0).close()
    except OSError:
        return False
    return True


def _free_port(wanted: int) -> int:
    """Give the port wanted, or another one if somebody has it."""
    for port in (wanted, 0):
        with closing(socket.socket()) as trial:
            try:
                trial.bind(("", port))
            except OSError:
                continue
            return int(trial.getsockname()[1])
    return wanted


def _wait(address: str) -> None:
    """Keep the recording in reach until Ctrl-C."""
    try:
        typer.echo(f"Look at it in a browser: {address}")
        typer.echo("Ctrl-C ends it.")
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        typer.echo("Stopped.")


def _file_name(actor: Actor, seed: int) -> str:
    agent = Path(actor.name).stem if Path(actor.name).suffix else actor.name.partition("/")[0]
    target = actor.settings["target"]
    return f"{agent}-{target if isinstance(target, str) else 'own'}-{seed}.rrd"
