"""``truth.csv``: t_s,x_m,y_m,z_m,range_m. A cell may be empty where the truth is not known (NaN)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path

from leadline.samples import Truth
from leadline.wire.notice import Notice, NoticeKind
from leadline.wire.stamps import format_stamp
from leadline.wire.table import Row, parse_table, read_table, table_text

HEADER = ("t_s", "x_m", "y_m", "z_m", "range_m")


Tell = Callable[[Notice], None]


def read_truth(path: Path | str, tell: Tell | None = None) -> list[Truth]:
    """The truth in order of time. A row that cannot be read is left out and told; InputError for a wrong header."""
    return _stations(read_table(Path(path), [HEADER]), tell)


def parse_truth(text: str, where: str, tell: Tell | None = None) -> list[Truth]:
    """As ``read_truth``, from the file's text."""
    return _stations(parse_table(text, where, [HEADER]), tell)


def write_truth(path: Path | str, truth: Iterable[Truth]) -> None:
    Path(path).write_text(truth_text(truth), encoding="utf-8", newline="")


def truth_text(truth: Iterable[Truth]) -> str:
    return table_text(HEADER, map(_cells, truth))


def _stations(rows: list[Row], tell: Tell | None) -> list[Truth]:
    truth = []
    for row in rows:
        try:
            x, y, z, range_m = (row.number(column) if row.cells.get(column) else math.nan for column in HEADER[1:])
            truth.append(Truth(row.stamp("t_s"), (x, y, z), range_m))
        except ValueError as error:
            if tell:
                tell(Notice(NoticeKind.IGNORED, row.where, str(error)))
    return sorted(truth, key=lambda station: station.t_ns)


def _cells(station: Truth) -> list[str]:
    numbers = (*station.position_m, station.range_m)
    return [format_stamp(station.t_ns), *("" if math.isnan(number) else repr(float(number)) for number in numbers)]
