"""What the tests of the server share."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from clients import Bystander, Proxy, nothing_left
from octoarm_agents.common.serving import ServerProcess

PROXY_VARIABLES = [
    name
    for kind in ("grpc", "https", "http", "all")
    for name in (f"{kind}_proxy", f"{kind}_proxy".upper())
]


def _use_what_cargo_built() -> None:
    """Test the program of this checkout: `cargo test` builds it before these tests run."""
    target = Path(__file__).parents[2] / "target"
    built = [path for path in target.glob("*/octoarm-server") if path.is_file()]
    if built:
        newest = max(built, key=lambda path: path.stat().st_mtime)
        os.environ.setdefault("OCTOARM_SERVER_FOLDER", str(newest.parent))


_use_what_cargo_built()


@pytest.fixture(scope="session")
def server() -> Iterator[ServerProcess]:
    """A server with its default settings, for all tests that do not ask for others."""
    with ServerProcess("--metrics-port", "0") as process:
        yield process
        assert process.process.poll() is None, process.log


@pytest.fixture(scope="session")
def quiet_server() -> Iterator[ServerProcess]:
    """A server whose levels are those of the tests that watch it alone."""
    with ServerProcess("--metrics-port", "0") as process:
        yield process
        assert process.process.poll() is None, process.log


@pytest.fixture
def watched_server(quiet_server: ServerProcess) -> Iterator[ServerProcess]:
    """The server, with a bystander at its side; the test must leave nothing behind."""
    with nothing_left(quiet_server), Bystander(quiet_server):
        yield quiet_server


@pytest.fixture
def proxy(monkeypatch: pytest.MonkeyPatch) -> Iterator[Proxy]:
    """A proxy, and all variables that could name it."""
    proxy = Proxy()
    for name in PROXY_VARIABLES:
        monkeypatch.setenv(name, f"http://somebody:sesame@{proxy.address}")
    for name in ("no_proxy", "NO_PROXY", "no_grpc_proxy"):
        monkeypatch.delenv(name, raising=False)
    yield proxy
    proxy.close()
