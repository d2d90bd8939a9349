"""What the agents import is declared, and nothing else; what an extra brings, its commands name."""

from __future__ import annotations

import ast
import functools
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2] / "agents"
PACKAGE = ROOT / "octoarm_agents"
FILES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for path in PACKAGE.rglob("*.py")
}
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

USED_BY_OTHERS = {
    "pygame-ce": "octoarm_env draws with it",
    "tensorboard": "stable-baselines3 writes its logs with it",
} | dict.fromkeys(
    ("dm-tree", "fsspec", "lz4", "ormsgpack", "pandas", "pyarrow", "requests"),
    "RLlib and Ray Tune want it",
)


def plain(distribution: str) -> str:
    """A distribution's name as all spellings have it."""
    return re.sub(r"[-_.]+", "-", distribution).lower()


def declared(requirements: list[str]) -> set[str]:
    return {plain(re.match(r"[\w.-]+", each)[0]) for each in requirements}


BASE = declared(PROJECT["dependencies"])
EXTRAS = {
    name: declared(requirements)
    for name, requirements in PROJECT["optional-dependencies"].items()
    if name != "test"
}
DISTRIBUTIONS = {
    module: {plain(each) for each in found} for module, found in packages_distributions().items()
} | {"octoarm_env": {"octoarm-env"}}


@functools.cache
def imported(module: str) -> set[str]:
    """All that a file of the package imports, at its head or where it is used, as dotted names."""
    found = set()
    for node in ast.walk(ast.parse(FILES[module].read_text(encoding="utf-8"))):
        match node:
            case ast.Import(names):
                found |= {alias.name for alias in names}
            case ast.ImportFrom(parent, names):
                found |= {parent, *(f"{parent}.{alias.name}" for alias in names)}
            case ast.Call(ast.Attribute(attr="import_module"), [ast.Constant(name)]):
                found.add(name)
    return found


def others(module: str) -> set[str]:
    """Top-level modules of other distributions that a file imports."""
    found = {name.split(".")[0] for name in imported(module)}
    return found - {"octoarm_agents"} - set(sys.stdlib_module_names)


def reached(module: str) -> set[str]:
    """The files that a file imports, and those that they import."""
    found, left = set(), [module]
    while left:
        name = left.pop()
        if name in FILES and name not in found:
            found.add(name)
            left += imported(name)
    return found


def test_what_is_imported_is_declared() -> None:
    allowed = BASE.union(*EXTRAS.values())
    for module in FILES:
        for name in others(module):
            assert DISTRIBUTIONS[name] & allowed, f"{module} imports {name}"


def test_what_is_declared_is_imported() -> None:
    used = set().union(*(DISTRIBUTIONS[name] for module in FILES for name in others(module)))
    for group in (BASE, *EXTRAS.values()):
        assert group - used - USED_BY_OTHERS.keys() == set()


@pytest.mark.parametrize("command", sorted(name for name in FILES if ".cli." in name))
def test_a_command_names_the_extra_that_it_needs(command: str) -> None:
    files = reached(command)
    texts = "\n".join(FILES[name].read_text(encoding="utf-8") for name in files)
    for extra, brought in EXTRAS.items():
        needed = {
            module
            for name in files
            for module in others(name)
            if DISTRIBUTIONS[module] & (brought - BASE)
        }
        if needed:
            named = re.search(rf'need_extra\("{extra}"\)|octoarm-agents\[{extra}\]', texts)
            assert named, f"{command} needs {needed} of the extra {extra}"
