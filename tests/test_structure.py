"""The rooms of the house: no file of a Rust crate imports one that imports it back."""

from __future__ import annotations

import re
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

RUST = Path(__file__).parents[1] / "rust"
CRATES = sorted(path.parent for path in RUST.glob("*/src"))

Module = tuple[str, ...]


def code(file: Path) -> str:
    """The text of a file without comments, texts and its tests."""
    text = re.sub(r"//[^\n]*", "", file.read_text(encoding="utf-8"))
    text = re.sub(r'"(?:\\.|[^"\\])*"', '""', text, flags=re.DOTALL)
    return text.split("#[cfg(test)]\nmod tests {")[0]


def leaves(tree: str) -> Iterator[Module]:
    """The paths of a tree of names as `use` takes it: `a::{b, c::d}` is a::b and a::c::d."""
    tree = tree.strip()
    before, brace, inside = tree.partition("{")
    head = tuple(name.strip() for name in before.split("::") if name.strip())
    if not brace:
        yield tuple(name.split(" as ")[0] for name in head)
        return
    depth, begin = 0, 0
    inside = inside[: inside.rindex("}")] + ","
    for place, sign in enumerate(inside):
        depth += {"{": 1, "}": -1}.get(sign, 0)
        if sign == "," and depth == 0:
            if inside[begin:place].strip():
                for leaf in leaves(inside[begin:place]):
                    yield head + leaf
            begin = place + 1


def named(text: str) -> Iterator[Module]:
    """All paths that a file names: those of its `use` lines, and those within expressions."""
    for tree in re.findall(r"\buse\s+([^;]+);", text):
        yield from leaves(tree)
    rest = re.sub(r"\buse\s+[^;]+;", "", text)
    for path in re.findall(r"\b(?:\$?crate|super)(?:::\w+)+", rest):
        yield tuple(path.removeprefix("$").split("::"))


def imports(crate: Path) -> dict[Module, set[Module]]:
    """For every file of a crate, as a path of module names, the files that it imports."""
    source = crate / "src"
    files: dict[Module, Path] = {}
    for file in source.rglob("*.rs"):
        parts = file.relative_to(source).with_suffix("").parts
        if parts[0] == "bin" or parts == ("main",):
            continue
        files[parts[:-1] if parts[-1] in ("lib", "mod") else parts] = file
    graph = {}
    for module, file in files.items():
        found = set()
        for path in named(code(file)):
            if path[0] == "crate":
                place = path[1:]
            elif path[0] == "super":
                place = module[:-1] + path[1:]
            else:
                place = module + path
                if place[: len(module) + 1] not in files:
                    continue
            while place not in files:
                place = place[:-1]
            found.add(place)
        graph[module] = found - {module}
    return graph


@pytest.mark.parametrize("crate", CRATES, ids=lambda crate: crate.name)
def test_no_file_imports_one_that_imports_it_back(crate: Path) -> None:
    graph = imports(crate)
    assert any(graph.values()) or len(graph) == 1
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        circle = " -> ".join("::".join(module) or "lib" for module in error.args[1])
        pytest.fail(f"{crate.name}: {circle}")


def test_trees_of_names_are_read() -> None:
    assert list(leaves("super::{a, b::{c, d as e}}")) == [
        ("super", "a"),
        ("super", "b", "c"),
        ("super", "b", "d"),
    ]
    assert list(named("use crate::x::Y;\nlet z = super::w::f();")) == [
        ("crate", "x", "Y"),
        ("super", "w", "f"),
    ]
