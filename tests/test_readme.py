"""README's and its pages' examples run as printed; its test command is that of `.ci/run`."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from documents import check_links, code_blocks, read_page, run_python

import octoarm_env

PAGES = [
    "README.md",
    "rust/python/README.md",
    "docs/environment.md",
    "docs/agents.md",
    "docs/reservoir.md",
]
EXAMPLES = {
    f"{page}-{index}": code
    for page in PAGES
    for index, code in enumerate(code_blocks(page, "python"))
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.long if ".learn(" in code else ())
        for name, code in EXAMPLES.items()
    ],
)
def test_example_runs_as_printed(name: str, tmp_path: Path) -> None:
    output = run_python(EXAMPLES[name], tmp_path)
    error = re.search(r"tracking error (\S+)", output)
    assert error is None or float(error[1]) < 1e-4
    earned = re.search(r"return (\S+) of 500", output)
    assert earned is None or float(earned[1]) > 490


def test_every_page_has_examples() -> None:
    assert {name.rpartition("-")[0] for name in EXAMPLES} == set(PAGES)


def test_two_commands() -> None:
    start, everything = (block.strip() for block in code_blocks("README.md", "sh"))
    assert start.endswith("pip install . ./agents && octoarm demo")
    assert everything in read_page(".ci/run")


def test_citation_is_of_this_version() -> None:
    assert f"\nversion: {octoarm_env.__version__}\n" in read_page("CITATION.cff")
    assert f"version = {{{octoarm_env.__version__}}}\n" in read_page("docs/citation.md")


@pytest.mark.parametrize("page", [*PAGES, "docs/architecture.md", "CONTRIBUTING.md"])
def test_links_lead_somewhere(page: str) -> None:
    check_links(page)


@pytest.mark.parametrize("folder", ["", "agents/", "rust/server/"])
def test_long_descriptions_stand_alone(folder: str) -> None:
    """A package index shows no file of the repository: no picture, and no link to one."""
    project = tomllib.loads(read_page(f"{folder}pyproject.toml"))["project"]
    page = read_page(f"{folder}{project['readme']}")
    assert page.startswith(f"# {project['name']}\n")
    assert not re.search(r"\]\((?!https:)|<img|^\[.*\]:", page, re.M)
