"""All distributions have one version, and ask for each other's."""

from __future__ import annotations

import json
import re
import tomllib
from typing import Any

from documents import read_page
from octoarm_agents import __version__ as agents

import octoarm_env


def toml(path: str) -> dict[str, Any]:
    return tomllib.loads(read_page(path))


def test_one_version() -> None:
    workspace = toml("Cargo.toml")["workspace"]
    version = workspace["package"]["version"]
    assert octoarm_env.__version__ == agents == version
    assert json.loads(read_page("rust/server/examples/node/package.json"))["version"] == version
    assert json.loads(read_page("rust/web/page/package.json"))["version"] == version
    for crate in ("octoarm-arm", "octoarm-env"):
        assert workspace["dependencies"][crate]["version"] == version
    for crate in ("arm", "env", "python", "server", "web", "web/bind"):
        assert toml(f"rust/{crate}/Cargo.toml")["package"]["version"] == {"workspace": True}


def test_agents_ask_for_the_environment_of_their_version() -> None:
    (needed,) = (
        each
        for each in toml("agents/pyproject.toml")["project"]["dependencies"]
        if each.startswith("octoarm-env")
    )
    major, minor = map(int, agents.split(".")[:2])
    assert re.fullmatch(rf"octoarm-env>={major}\.{minor}(\.\d+)?,<{major}\.{minor + 1}", needed)
