"""Where Rerun's recordings are looked at: its viewer's window, or a browser."""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from urllib.parse import quote

import rerun as rr

from octoarm_agents.viewing.rerun_streams import RecordingError, begin_recording

_VIEWER_PORT, _BROWSER_PORT = 9876, 9090
"""Where Rerun's viewers listen as a rule."""
_PATIENCE = 60.0
"""How long a viewer may take for what is sent at the end [s]."""


@contextmanager
def recording_in_viewer() -> Iterator[rr.RecordingStream]:
    """Give a recording that Rerun's viewer shows at once; one that is open already is used.

    Raises:
        RecordingError: no viewer opens, it closes too early, or logging is switched off.
    """
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


def _open_viewer(recording: rr.RecordingStream) -> None:
    displays = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in displays):
        raise RecordingError("there is no display for the viewer's window")
    beside = Path(sys.executable).with_name("rerun")
    try:
        rr.spawn(
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


def recording_in_browser(*, open_browser: bool) -> tuple[rr.RecordingStream, str]:
    """Give a recording that a browser on this machine can show, and the address to open there.

    It can be looked at as long as this process lives. The data are for this machine alone; the
    viewer's page, without data, is served to all.

    Args:
        open_browser: open the address here and now.

    Raises:
        RecordingError: logging is switched off, or there is no port to listen at.
    """
    recording = begin_recording()
    sink = rr.GrpcServerSink(bind_ip="127.0.0.1", port=_free_port(_VIEWER_PORT))
    recording.set_sinks(sink)
    port = _free_port(_BROWSER_PORT)
    try:
        rr.serve_web_viewer(web_port=port, open_browser=open_browser, connect_to=sink.uri)
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
