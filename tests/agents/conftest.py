"""What the tests of the agents share."""

import pytest
from octoarm_agents.cli import app
from typer.testing import CliRunner, Result


@pytest.fixture
def octoarm():
    """Run the command line in this process: `octoarm("demo", "--steps", "5")`."""

    def run(*arguments: object) -> Result:
        # A wide terminal, so that messages are not wrapped in the middle of what is looked for.
        return CliRunner().invoke(
            app, [str(argument) for argument in arguments], env={"COLUMNS": "300"}
        )

    return run
