"""``truth.csv``: t_s,x_m,y_m,z_m,range_m. A cell may be empty where the truth is not known (NaN)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path

from leadline.samples import Truth
from leadline.wire.notice import Notice, NoticeKind
from leadline.wire.stamps import format_stamp
from leadline.wire.table import read_table, write_table

HEADER = ("t_s", "x_m", "y_m", "z_m", "range_m")


def read_truth(path: Path | str, tell: Callable[[Notice], None] | None = None) -> list[Truth]:
    """The truth in order of time. A row that cannot be read is left out and told; InputError for a wrong header."""
    truth = []
    for row in read_table(Path(path), [HEADER]):
        try:
            x, y, z, range_m = (row.number(column) if row.cells.get(column) else math.nan for column in HEADER[1:])
            truth.append(Truth(row.stamp("t_s"), (x, y, z), range_m))
        except ValueError as error:
            if tell:
                tell(Notice(NoticeKind.IGNORED, row.where, str(error)))
    return sorted(truth, key=lambda station: station.t_ns)


def write_truth(path: Path | str, truth: Iterable[Truth]) -> None:
    write_table(Path(path), HEADER, map(truth_row, truth))


def truth_row(station: Truth) -> list[str]:
    numbers = (*station.position_m, station.range_m)
    return [format_stamp(station.t_ns), *("" if math.isnan(number) else repr(float(number)) for number in numbers)]
