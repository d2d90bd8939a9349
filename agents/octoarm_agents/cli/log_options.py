"""Options that say what a log has in its columns, and how it was sampled."""

from __future__ import annotations

from typing import Annotated

import typer

from octoarm_agents.cli.options import number_between

__all__ = ["FillGaps", "Hold", "InputColumns", "SkipLines", "StatesColumns", "TimeColumn"]

StatesColumns = Annotated[
    str | None,
    typer.Option(
        help="Columns of a text file that are states, with commas between them: names with or "
        'without their unit, patterns such as "spring*", or numbers such as 2-81.',
        show_default="all but input and time",
    ),
]
InputColumns = Annotated[
    str | None,
    typer.Option(
        help="Columns that are the input, in the states' file if there is no --input.",
        show_default="all of --input but time",
    ),
]
TimeColumn = Annotated[
    str | None,
    typer.Option(
        help="Column of times, numbers or ISO 8601; missing rows and uneven times are noticed.",
        show_default="none: rows are taken as evenly spaced",
    ),
]
SkipLines = Annotated[
    int,
    typer.Option(
        help="Lines of a text file before the table.", callback=number_between(0, 1_000_000)
    ),
]
FillGaps = Annotated[
    int,
    typer.Option(
        help="Longest gap, in rows, that is filled: states on a straight line, the input with its "
        "last value.",
        callback=number_between(0, 1_000_000),
    ),
]
Hold = Annotated[
    int | None,
    typer.Option(
        help="Rows that each value of the input is held for; one row a hold is measured, its last. "
        "Washout and delays then count holds.",
        show_default="1, refused if a hold is seen",
        callback=number_between(1, 1_000_000),
    ),
]
