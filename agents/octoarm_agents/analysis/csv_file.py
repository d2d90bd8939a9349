"""A log in a text file, as instruments and spreadsheets write them: columns, numbers, times."""

from __future__ import annotations

import codecs
import csv
import io
import re
from array import array
from collections.abc import Iterator, Sequence
from datetime import datetime
from fnmatch import translate
from itertools import islice
from pathlib import Path

import numpy as np

from octoarm_agents.common.whole import whole_number
from octoarm_env.arrays import Float

Times = tuple[Float, str]
"""Times (T,) from the first on, and their unit, empty if it is not known."""

_GAPS = {"", "-", "--", "?", "na", "n/a", "nan", "null", "none"} | {
    f"#{word}" for word in ("n/a", "na", "nv", "num!", "zahl!", "value!", "wert!", "div/0!")
}
"""What stands in a cell without a number, in small letters."""

_COMMENTS = ("#", "%")

_UNIT = re.compile(r"\s*(?:\[(?P<a>.*)\]|\((?P<b>.*)\)|\s/\s(?P<c>.*))$")


class CsvFile:
    """A table of text: a line a row, its cells separated by commas, semicolons or tabs.

    Lines that begin with # or % are comments. A first row that has text where the next one has a
    number is the header; names stand in the comment before the numbers too (`numpy.savetxt`). A
    row of units below the header, empty columns at the right and empty rows at the end are left
    out. Excel's byte order mark and `sep=;` are read as they are meant; what is not UTF-8 is read
    as Windows-1252.

    Args:
        path: the file.
        skip_lines: lines at the begin that are not of the table.

    Attributes:
        path: the file.
        names: of the columns; the column's number, counted from 1, where there is no header.

    Raises:
        OSError: a file that cannot be read.
        ValueError: a file without a table.
    """

    def __init__(self, path: Path, skip_lines: int = 0) -> None:
        self.path = path
        lines = list(io.StringIO(_decode(path.read_bytes()), newline=""))
        while lines and not lines[-1].strip(" \r\n\t;,"):
            lines.pop()
        skip_lines = whole_number("skip_lines", skip_lines)
        # Blank lines in the place of what is left out keep the numbers of the others.
        lines[:skip_lines] = ["\n"] * min(skip_lines, len(lines))
        self._lines = lines
        comment, before, delimiter = "", True, ""
        for number, line in enumerate(lines):
            if before and (separator := re.fullmatch(r"sep=([^\r\n\"])[\r\n]*", line)):
                lines[number], delimiter = "\n", separator[1]
            elif line.startswith(_COMMENTS) and _number(re.split("[;,\t]", line)[0]) is None:
                lines[number] = "\n"
                comment = line if before else comment
            elif line.strip():
                before = False
        first = list(islice(filter(str.strip, lines), 100))
        self._delimiter = delimiter or _delimiter(first)
        # A number with each of the decimal marks that were found, in whatever columns.
        self._marks: dict[str, str] = {}
        self._begin, names = self._header(comment)
        self.names = tuple(
            " ".join(name.split()) or str(number) for number, name in enumerate(names, start=1)
        )

    def _header(self, comment: str) -> tuple[int, list[str]]:
        """The number of the first line of numbers, and the names in the line before them."""
        head = list(islice(self._rows(), 3))
        if not head:
            raise ValueError(f"{self.path}: no rows of numbers")
        kinds = [[_is_text(cell) for cell in cells] for _, cells in head]
        # The first row below a header and a row of units.
        following = next((k for k in range(1, len(head)) if not _all_text(head[k][1])), None)
        if following is None:
            if any(kinds[0]):
                raise ValueError(f"{self.path}: no rows of numbers")
        elif any(a and not b for a, b in zip(kinds[0], kinds[following], strict=False)):
            return head[following][0], _strip(head[0][1])
        width = max(len(_strip(cells)) for _, cells in self._rows())
        cells = next(csv.reader([comment.lstrip("#% ").rstrip()], delimiter=self._delimiter), [])
        named = len(cells) == width and any(map(_is_text, cells))
        return head[0][0], cells if named else [""] * width

    def _rows(self) -> Iterator[tuple[int, list[str]]]:
        """Line number, counted from 1, and cells of each row that is not blank."""
        # Strict: a lost quotation mark would swallow all rows up to the next one.
        reader = csv.reader(
            self._lines, delimiter=self._delimiter, skipinitialspace=True, strict=True
        )
        try:
            for cells in reader:
                if cells and (len(cells) > 1 or cells[0].strip()):
                    yield reader.line_num, cells
        except csv.Error as error:
            raise ValueError(f"{self.path}: line {reader.line_num}: {error}") from None

    def _data(self) -> Iterator[tuple[int, list[str]]]:
        """The rows of numbers; a row of another length is an error."""
        width = len(self.names)
        for line, cells in self._rows():
            if line < self._begin:
                continue
            if any("\n" in cell or "\r" in cell for cell in cells):
                raise ValueError(
                    f"{self.path}: the row that ends in line {line} has a line break in a cell: "
                    "a quotation mark is missing"
                )
            if len(cells) < width or any(cell.strip() for cell in cells[width:]):
                found = max(len(_strip(cells)), min(len(cells), width))
                hint = "; lines before the table are left out by --skip-lines"
                if self._delimiter == "," and found == 2 * width:
                    hint = "; with decimal commas the columns must be separated by semicolons"
                raise ValueError(
                    f"{self.path}: line {line} has {found} columns, the table {width}{hint}"
                )
            yield line, cells

    def _place(self, line: int, column: int) -> str:
        name = self.names[column]
        named = "" if name == str(column + 1) else f" ({name!r})"
        return f"{self.path}: line {line}, column {column + 1}{named}"

    def select(self, text: str, option: str) -> list[int]:
        """The columns (counted from 0) that a list means, in its order.

        Args:
            text: items with commas between them, in quotes if they have commas themselves. An item
                is a name, with or without its unit; a pattern with * or ?; a number counted from
                1; or a range of numbers such as 2-81.
            option: where the list stands, for the error.

        Raises:
            ValueError: no such column, or more than one of a name.
        """
        chosen: list[int] = []
        for item in next(csv.reader([text], skipinitialspace=True), []):
            found = self._find(item.strip(), option)
            chosen += [column for column in found if column not in chosen]
        if not chosen:
            raise ValueError(f"{option}: no column is named; {self.columns}")
        return chosen

    @property
    def columns(self) -> str:
        """The file and its columns, in words for an error."""
        names = [*self.names[:20], *(["…"] if len(self.names) > 20 else [])]
        return f"{self.path} has the columns {', '.join(names)}"

    def _find(self, item: str, option: str) -> Sequence[int]:
        bare = [_UNIT.sub("", name) for name in self.names]
        for names in (self.names, bare):
            found = [column for column, name in enumerate(names) if name == item]
            if len(found) > 1:
                numbers = ", ".join(str(column + 1) for column in found)
                raise ValueError(
                    f"{option} {item!r}: {len(found)} columns of {self.path} have this name; "
                    f"take one by its number, {numbers}"
                )
            if found:
                return found
        if "*" in item or "?" in item:
            # Square brackets enclose a unit, not a set of characters.
            like = re.compile(translate(item.replace("[", "[[]"))).match
            pairs = enumerate(zip(self.names, bare, strict=True))
            if found := [column for column, names in pairs if any(map(like, names))]:
                return found
        numbered = re.fullmatch(r"(\d+)(?:-(\d+))?", item)
        if numbered:
            low, high = int(numbered[1]), int(numbered[2] or numbered[1])
            if 1 <= low <= high <= len(self.names):
                return range(low - 1, high)
        hint = (
            "" if len(self.names) > 1 else "; is it the header? If not, --skip-lines leaves it out"
        )
        raise ValueError(f"{option} {item!r}: no such column; {self.columns}{hint}")

    def numbers(self, columns: Sequence[int]) -> Float:
        """Some columns (T, k); NaN where a cell is empty or says that there is no number.

        Raises:
            ValueError: a cell with anything else, decimal points and commas together, or no rows.
        """
        values, marks = array("d"), self._marks
        for line, cells in self._data():
            row = [cells[column] for column in columns]
            text = "".join(row)
            for mark in ".,":
                if mark in text and mark not in marks:
                    marks[mark] = next(cell.strip() for cell in row if mark in cell)
                    if len(marks) == 2:
                        raise ValueError(
                            f"{self.path}: line {line}: {marks['.']!r} has a decimal point, but "
                            f"{marks[',']!r} has a comma: expected one of them in all columns, and "
                            "none between thousands"
                        )
            try:
                values.extend([float(cell) for cell in row])
            except ValueError:
                values.extend([self._cell(line, cells, column) for column in columns])
        if not values:
            raise ValueError(f"{self.path}: no rows of numbers")
        return np.array(values).reshape(-1, len(columns))

    def _cell(self, line: int, cells: Sequence[str], column: int) -> float:
        number, cell = _number(cells[column]), cells[column].strip()
        if number is None:
            kind = "a time: --time-column takes its column" if _stamp(cell) else "not a number"
            raise ValueError(f"{self._place(line, column)}: {cell[:60]!r} is {kind}")
        return number

    def times(self, column: int) -> Times:
        """A column of times: numbers in the unit of the header, or ISO 8601 in seconds.

        Raises:
            ValueError: a cell that is neither, or none.
        """
        first = next((cells[column] for _, cells in self._data()), "")
        if _number(first) is not None or not _stamp(first):
            values = self.numbers([column])[:, 0]
            gaps = int((~np.isfinite(values)).sum())
            if gaps:
                raise ValueError(
                    f"{self.path}: {gaps} of {len(values)} cells of the time column "
                    f"{self.names[column]!r} are no times"
                )
            unit = _UNIT.search(self.names[column])
            return values - values[0], next(filter(None, unit.groups()), "") if unit else ""
        seconds = array("d")
        begin = None
        for line, cells in self._data():
            stamp = _stamp(cells[column])
            begin = begin or stamp
            if stamp is None or begin is None or (stamp.tzinfo is None) != (begin.tzinfo is None):
                raise ValueError(
                    f"{self._place(line, column)}: {cells[column]!r} is not a time like the first "
                    f"one, {first!r}: expected ISO 8601, all with or all without a time zone"
                )
            seconds.append((stamp - begin).total_seconds())
        return np.array(seconds), "s"


def _decode(content: bytes) -> str:
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content.decode("utf-16", errors="replace")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        # Only names and units have other letters than ASCII's.
        return content.decode("cp1252", errors="replace")


def _delimiter(lines: Sequence[str]) -> str:
    """What separates the cells of a table's first lines: a comma if there is nothing else.

    Below a header without a comma, a line that is a number with a decimal comma is one cell.
    """
    if not lines:
        return ","
    for delimiter in ";\t":
        if delimiter in lines[-1]:
            return delimiter
    numbers = [_number(line) for line in (*lines[1:2], lines[-1])]
    return "," if "," in lines[0] or None in numbers else ";"


def _strip(cells: Sequence[str]) -> list[str]:
    """Cells without the empty ones at the right."""
    filled = [number for number, cell in enumerate(cells, start=1) if cell.strip()]
    return list(cells[: max(filled, default=0)])


def _number(cell: str) -> float | None:
    """The number in a cell, with a point or a comma; NaN for a gap, None for anything else."""
    if cell.strip().lower() in _GAPS:
        return float("nan")
    try:
        return float(cell.replace(",", "."))
    except ValueError:
        return None


def _stamp(cell: str) -> datetime | None:
    """A date with a time, or a time alone, in ISO 8601."""
    for text in (cell.strip(), f"2000-01-01T{cell.strip()}"):
        try:
            return datetime.fromisoformat(text)
        except ValueError:
            pass
    return None


def _is_text(cell: str) -> bool:
    """Whether a cell is neither a number nor a gap nor a time."""
    return _number(cell) is None and _stamp(cell) is None


def _all_text(cells: Sequence[str]) -> bool:
    """Whether a row has text and nothing that is a number or a time."""
    filled = [cell for cell in cells if cell.strip().lower() not in _GAPS]
    return bool(filled) and all(map(_is_text, filled))
