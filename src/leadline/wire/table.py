"""CSV with a header line: rows as dictionaries, each with its place in the file."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from leadline.errors import InputError
from leadline.wire.stamps import parse_stamp


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a table. ``where`` names file and line ("dive/laser.csv row 7"; the header is row 1).

    ``cells`` has every column of the header; ``missing`` are those before which the line ends (their cells are empty).
    """

    where: str
    cells: dict[str, str]
    missing: tuple[str, ...] = ()

    def text(self, column: str) -> str:
        """Raises ValueError where the cell is missing or empty."""
        value = self.cells.get(column, "")
        if not value:
            raise ValueError(f"{column} is empty")
        return value

    def number(self, column: str) -> float:
        """A finite number; raises ValueError."""
        text = self.text(column)
        try:
            value = float(text)
        except ValueError:
            raise ValueError(f"{column} '{text}' is not a number") from None
        if not math.isfinite(value):
            raise ValueError(f"{column} is {text}")
        return value

    def stamp(self, column: str) -> int:
        """Nanoseconds; raises ValueError."""
        try:
            return parse_stamp(self.text(column))
        except ValueError as error:
            raise ValueError(f"{column}: {error}") from None

    def optional_stamp(self, column: str) -> int | None:
        return self.stamp(column) if self.cells.get(column) else None


def read_table(path: Path, expected: Sequence[Sequence[str]]) -> list[Row]:
    """The rows of a CSV whose header holds all columns of one of ``expected``; more columns are welcome.

    Raises InputError for a missing file, one that is not text, and a header that is none of those expected.
    """
    try:
        return parse_table(path.read_text(encoding="utf-8-sig"), str(path), expected)
    except FileNotFoundError:
        raise InputError(f"no {path.name}", str(path.parent), f"write it with the columns {_told(expected)}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read ({error})", str(path), "write it as CSV in UTF-8") from None


def parse_table(text: str, where: str, expected: Sequence[Sequence[str]]) -> list[Row]:
    """As ``read_table``, from text; ``where`` is the name to give in messages."""
    lines = csv.reader(io.StringIO(text, newline=None))
    try:
        header = [name.strip() for name in next(lines, [])]
        if not any(set(columns) <= set(header) for columns in expected):
            what = f"the header is '{','.join(header)}'" if header else "the file is empty"
            raise InputError(what, where, f"the first line must be {_told(expected)}")
        return [_row(where, lines.line_num, header, cells) for cells in lines if any(cell.strip() for cell in cells)]
    except csv.Error as error:
        raise InputError(f"not CSV ({error})", where, "write it as CSV in UTF-8") from None


def _told(expected: Sequence[Sequence[str]]) -> str:
    return " or ".join(",".join(columns) for columns in expected)


def _row(where: str, line: int, header: list[str], cells: list[str]) -> Row:
    missing = header[len(cells) :]
    texts = (*(cell.strip() for cell in cells[: len(header)]), *[""] * len(missing))
    return Row(f"{where} row {line}", dict(zip(header, texts, strict=True)), tuple(missing))


def table_text(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return rows_text(chain([header], rows))


def rows_text(rows: Iterable[Sequence[str]]) -> str:
    """Rows as they stand in a file."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def write_table(path: Path, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    path.write_text(table_text(header, rows), encoding="utf-8", newline="")
