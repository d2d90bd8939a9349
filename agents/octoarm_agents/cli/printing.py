"""What the tables that commands print have in common."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table


def new_table(title: str | None, *headings: str) -> Table:
    """Give an empty table: words on the left, figures to the right of them.

    Without headings it has two columns and no head.
    """
    from rich.table import Table

    table = Table(title=title, show_header=bool(headings))
    for index, heading in enumerate(headings or ("", "")):
        table.add_column(heading, justify="right" if index else "left", overflow="fold")
    return table
