"""`octoarm serve`."""

from __future__ import annotations

import os
import subprocess
import sys

import typer


def serve(context: typer.Context) -> None:
    """Serve the arm over gRPC: `octoarm serve --help` shows the server's own options."""
    from octoarm_agents.common.serving import ServerNotFoundError, find_program

    try:
        program = str(find_program())
    except ServerNotFoundError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(1) from None
    arguments = [program, *context.args]
    if os.name != "nt":
        # The server takes this process's place, so that signals reach it.
        sys.stdout.flush()
        sys.stderr.flush()
        os.execv(program, arguments)
    raise typer.Exit(subprocess.run(arguments, check=False).returncode)
