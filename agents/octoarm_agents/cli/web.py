"""`octoarm web`."""

from __future__ import annotations

from typing import Annotated

import typer

from octoarm_agents.cli.options import number

_PORT = "Port on this machine's loopback address; 0 takes a free one."


def web(
    port: Annotated[int, number(_PORT, 0, 65_535)] = 8642,
    open_page: Annotated[
        bool, typer.Option("--open/--no-open", help="Open the page in the browser.")
    ] = True,
) -> None:
    """Drag, teach and push the arm in the browser.

    The page computes the arm itself; it is served to this machine alone, until Ctrl-C.
    """
    import webbrowser

    from octoarm_agents.web.serving import HOST, PageNotFoundError, PageServer

    try:
        server = PageServer(port)
    except PageNotFoundError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(1) from None
    except OSError as error:
        raise typer.BadParameter(
            f"{HOST}:{port} cannot be had: {error.strerror or error}. 0 takes a free port.",
            param_hint="'--port'",
        ) from None
    with server:
        typer.echo(f"The arm is at {server.url} until Ctrl-C.")
        if open_page:
            webbrowser.open(server.url)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            typer.echo("")
