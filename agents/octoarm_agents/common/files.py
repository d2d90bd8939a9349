"""Result files: they appear whole or not at all."""

from __future__ import annotations

import json
import secrets
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Give a file in a hidden folder beside `path`; it takes that name if the block ends well.

    A process that the block has started cannot bring the file back once the folder is gone.

    Raises:
        OSError: the folder cannot be written to.
    """
    folder = path.with_name(f".{path.stem}-{secrets.token_hex(4)}")
    try:
        folder.mkdir()
        yield folder / path.name
        (folder / path.name).replace(path)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def write_atomically(path: Path, write: Callable[[Path], None]) -> None:
    """Let `write` fill a hidden file, then give it its name.

    Raises:
        OSError: the folder cannot be written to.
    """
    with atomic_file(path) as temporary:
        write(temporary)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write `content` as JSON. Numbers that are not finite are an error: JSON has none."""
    write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def read_folder(folder: Path) -> dict[str, bytes]:
    """All files in a folder, by their path in it; none if there is no folder.

    What `atomic_file` has hidden there, and a killed process has left, is none of them.
    """
    names = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    whole = (name for name in names if not any(part.startswith(".") for part in name.parts))
    return {name.as_posix(): (folder / name).read_bytes() for name in whole}


def write_folder(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write what `read_folder` gave, each file whole or not at all."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path) as file:
            file.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8."""
    with atomic_file(path) as file:
        file.write_text(text, encoding="utf-8")
