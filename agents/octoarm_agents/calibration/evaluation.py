"""What is known of a body that a search tried, and the file of all of them: a line of JSON each."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from octoarm_agents.common.files import write_text


@dataclass(kw_only=True)
class Judgement:
    """How well a body does what the paper reports.

    Attributes:
        score: see `octoarm_agents.calibration.score`; of a failure `FAILURE` plus the stages that
            were not completed.
        outcomes: see `plain_outcomes`; None without noise seeds or after a failure.
        ratios: errors by task as parts of the paper's; None if the arm left its domain in Task 1.
        failure: None, or where (``stage``: ``"rest"``, ``"task1"`` or a cycle) and after which
            ``part`` of it.
    """

    score: float = math.nan
    outcomes: dict[str, list[str]] | None = None
    ratios: dict[str, float] | None = None
    failure: dict[str, Any] | None = None


@dataclass(kw_only=True)
class Evaluation(Judgement):
    """A body that a search tries, and its `Judgement`; until then the score is not a number.

    Attributes:
        search: digest of all that it depends on.
        seed: of the search.
        index: in the order tried.
        body: its open parameters by field.
    """

    search: str
    seed: int
    index: int
    body: dict[str, Any]


def read_evaluations(path: Path) -> list[Evaluation]:
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
            evaluations.append(Evaluation(**json.loads(line)))
        except (ValueError, TypeError):
            raise ValueError(f"{path}, line {number}: not an evaluation of a body") from None
    if whole != text:
        write_text(path, whole)
    return evaluations


def append_evaluations(path: Path, evaluations: Sequence[Evaluation]) -> None:
    """Add evaluations at the end of a file.

    Raises:
        ValueError: a number that is not finite.
        OSError: the file cannot be written to.
    """
    lines = "".join(f"{json.dumps(asdict(each), allow_nan=False)}\n" for each in evaluations)
    with path.open("a", encoding="utf-8") as file:
        file.write(lines)
