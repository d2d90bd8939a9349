"""Serve the page of this package to browsers of this machine."""

from __future__ import annotations

import functools
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

HOST = "127.0.0.1"
PAGE = Path(__file__).parent / "page"


class PageNotFoundError(FileNotFoundError):
    """The package lacks the page."""


class _Handler(SimpleHTTPRequestHandler):
    """Files of the page, with the types that browsers insist on, whatever this machine believes."""

    extensions_map = SimpleHTTPRequestHandler.extensions_map | {
        ".bin": "application/octet-stream",
        ".css": "text/css",
        ".html": "text/html; charset=utf-8",
        ".js": "text/javascript",
        ".wasm": "application/wasm",
    }
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        if self._is_for_us():
            super().do_GET()

    def do_HEAD(self) -> None:
        if self._is_for_us():
            super().do_HEAD()

    def _is_for_us(self) -> bool:
        # A name of elsewhere that leads here is somebody else's page in this machine's browser.
        host = urlsplit(f"//{self.headers.get('Host', HOST)}").hostname
        if host in (HOST, "localhost"):
            return True
        self.send_error(421, "Misdirected Request", "This page is for this machine's browsers.")
        return False

    def end_headers(self) -> None:
        self.send_header("Cache-Control", "no-cache")
        self.send_header("X-Content-Type-Options", "nosniff")
        super().end_headers()

    def log_message(self, format: str, *arguments: Any) -> None:
        """Say nothing: a line a file helps nobody."""


class PageServer(ThreadingHTTPServer):
    """The page on the loopback address, until `close`.

    Args:
        port: 0 to 65,535; 0 takes a free one.

    Attributes:
        url: where the page is.

    Raises:
        PageNotFoundError: this package lacks the page.
        OSError: the port is taken, or not for everybody.
    """

    daemon_threads = True
    # On Windows two servers could otherwise share a port.
    allow_reuse_address = False

    def __init__(self, port: int = 0, folder: Path = PAGE) -> None:
        if not (folder / "index.html").is_file():
            raise PageNotFoundError(
                f"the page is not in {folder}: in a checkout of the project rust/web/build makes it"
            )
        super().__init__((HOST, port), functools.partial(_Handler, directory=str(folder)))
        self.url = f"http://{HOST}:{self.server_port}/"
