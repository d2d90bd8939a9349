"""The server of the arm as a process: where its program is, and how it is started and stopped."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Self

INSTALL = "in a checkout of the project: pip install ./rust/server (or cargo build --release)"
_ADDRESS = re.compile(r"^octoarm-server listening on (?P<scheme>https?)://(?P<address>\S+)$")
_METRICS = re.compile(r"^octoarm-server metrics on (?P<url>\S+)$")


class ServerNotFoundError(FileNotFoundError):
    """A program of the server is not installed."""


def find_program(name: str = "octoarm-server") -> Path:
    """Find a program of the server.

    It is looked for in the folder that the environment variable ``OCTOARM_SERVER_FOLDER`` names
    (and nowhere else, if it does), where this Python has its scripts, on the path, and, when this
    package lies in a checkout, among what cargo has built there, the newest first.

    Raises:
        ServerNotFoundError: it is nowhere; the message says how to install it.
    """
    file = name + (".exe" if os.name == "nt" else "")
    folder = os.environ.get("OCTOARM_SERVER_FOLDER")
    if folder is not None:
        candidates = [Path(folder) / file]
    else:
        candidates = [Path(sysconfig.get_path("scripts")) / file]
        on_path = shutil.which(name)
        if on_path is not None:
            candidates.append(Path(on_path))
        target = Path(__file__).resolve().parents[3] / "target"
        built = [path for path in target.glob(f"*/{file}") if path.is_file()]
        candidates += sorted(built, key=lambda path: -path.stat().st_mtime)
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    places = ", ".join(str(candidate) for candidate in candidates)
    raise ServerNotFoundError(f"{name} is not installed (looked for {places}); {INSTALL}")


class ServerProcess:
    """A server that runs for as long as the ``with`` block.

    Args:
        arguments: options of ``octoarm-server``; without a port it takes a free one.
        environment: variables beside those of this process.

    Attributes:
        address: where clients connect, ``host:port``.
        metrics_url: where Prometheus reads, if the options say so; else None.

    Raises:
        ServerNotFoundError: the program is not installed.
        RuntimeError: it ended at once; the message holds what it said.
    """

    def __init__(self, *arguments: str, environment: Mapping[str, str] | None = None) -> None:
        if "--port" not in arguments:
            arguments = ("--port", "0", *arguments)
        program = find_program()
        # Kept open as long as the server writes into it.
        self._log = tempfile.TemporaryFile("w+", encoding="utf-8")  # noqa: SIM115
        self.process = subprocess.Popen(
            [str(program), *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=self._log,
            encoding="utf-8",
            env=os.environ | dict(environment or {}),
        )
        assert self.process.stdout is not None
        found = _ADDRESS.match(self.process.stdout.readline().strip())
        if found is None:
            self.process.wait()
            log = self.log
            self._close()
            raise RuntimeError(f"octoarm-server did not start: {log.strip()}")
        self.address = found["address"]
        self.metrics_url: str | None = None
        if "--metrics-port" in arguments:
            line = _METRICS.match(self.process.stdout.readline().strip())
            self.metrics_url = None if line is None else line["url"]

    @property
    def log(self) -> str:
        """All that the server has logged."""
        self._log.seek(0)
        return self._log.read()

    def stop(self, timeout: float = 30.0) -> int:
        """Ask the server to stop, and wait for it.

        Returns:
            Its exit code; 0 if it came to its end as it should.
        """
        if self.process.poll() is None:
            self.process.terminate()
        try:
            return self.process.wait(timeout)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()

    def _close(self) -> None:
        self._log.close()
        if self.process.stdout is not None:
            self.process.stdout.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        self.stop()
        if kind is not None:
            print(self.log, file=sys.stderr)
        self._close()
