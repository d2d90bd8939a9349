"""What the tests of the agents share."""

from collections.abc import Iterator

import pytest
from octoarm_agents.cli import app
from threadpoolctl import threadpool_limits
from typer.testing import CliRunner, Result


@pytest.fixture(autouse=True, scope="session")
def one_thread_of_algebra() -> Iterator[None]:
    """Fits are rounded as in the commands, whose trials compute their algebra in one thread."""
    with threadpool_limits(1, user_api="blas"):
        yield


@pytest.fixture
def octoarm():
    """Run the command line in this process: `octoarm("demo", "--steps", "5")`."""

    def run(*arguments: object) -> Result:
        # A wide terminal, so that messages are not wrapped in the middle of what is looked for.
        return CliRunner().invoke(
            app, [str(argument) for argument in arguments], env={"COLUMNS": "300"}
        )

    return run
