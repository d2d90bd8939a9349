"""The file of all evaluations: a line of JSON each, written as they finish, read again later."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from octoarm_agents.common.files import write_text

__all__ = ["append_evaluations", "read_evaluations"]

_FIELDS = {"search", "index", "body", "score", "outcomes", "ratios", "failure"}


def read_evaluations(path: Path) -> list[dict[str, Any]]:
    """All evaluations in a file; none if there is no file.

    A last line that was not written to its end, because the process was ended, is taken away.

    Raises:
        ValueError: a line that is not an evaluation; the message names file and line.
        OSError: the file cannot be read.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return []
    whole = text[: text.rfind("\n") + 1]
    evaluations = []
    for number, line in enumerate(whole.splitlines(), start=1):
        try:
            evaluation = json.loads(line)
        except ValueError:
            evaluation = None
        if not isinstance(evaluation, dict) or not _FIELDS.issubset(evaluation):
            raise ValueError(f"{path}, line {number}: not an evaluation of a body")
        evaluations.append(evaluation)
    if whole != text:
        write_text(path, whole)
    return evaluations


def append_evaluations(path: Path, evaluations: Sequence[Mapping[str, Any]]) -> None:
    """Add evaluations at the end of a file.

    Raises:
        ValueError: a number that is not finite.
        OSError: the file cannot be written to.
    """
    lines = "".join(f"{json.dumps(each, allow_nan=False)}\n" for each in evaluations)
    with path.open("a", encoding="utf-8") as file:
        file.write(lines)
