"""How results are told on a terminal: tables, and numbers that may be missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class ResultTable:
    """A table for the terminal.

    Attributes:
        title: above it.
        columns: headings.
        rows: cells, as many a row as there are columns.
        notes: lines below it.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str] = ()


def format_number(value: float | None, digits: str = ".2e") -> str:
    """A number as text, a dash where there is none."""
    return "–" if value is None else f"{value:{digits}}"


def format_spread(
    mean: float | None, sd: float | None, digits: str = ".2e", sd_digits: str = ".0e"
) -> str:
    """Mean and standard deviation, as far as there are any."""
    return format_number(mean, digits) + ("" if sd is None else f" ± {sd:{sd_digits}}")


def format_count(held: Sequence[bool]) -> str:
    """How many of some are true."""
    return f"{sum(held)} of {len(held)}" if held else "–"


def observation_table(
    title: str, paper: Mapping[str, str], confirmed: Mapping[str, Mapping[str, Any]]
) -> ResultTable:
    """The paper's observations, and whether they are there.

    Args:
        title: of the table.
        paper: text of each observation.
        confirmed: by the heading of its column, whether each observation holds: a yes or no, or
            one for each repetition.
    """

    def tell(answer: bool | Sequence[bool]) -> str:
        return ("yes" if answer else "no") if isinstance(answer, bool) else format_count(answer)

    rows = [
        (text, *(tell(answers[name]) for answers in confirmed.values()))
        for name, text in paper.items()
    ]
    return ResultTable(title, ("", *confirmed), rows)
