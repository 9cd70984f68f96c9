"""``solutions.csv`` and ``smoothed.csv``: one row a solution.

Numbers are written with nine significant digits (a nanometre at a metre, far below any sigma, and the same text on
every machine that computes the same double); stamps exactly as the source had them. Numbers are empty only when lost;
a velocity that the method does not have (the paper's, every frame alone) is nan, not empty and not 0.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from leadline.errors import InputError
from leadline.samples import Array, Kind, Rejected, Solution, Stage, Status
from leadline.wire.stamps import format_stamp
from leadline.wire.table import Row, read_table

_POSITION = ("x_m", "y_m", "z_m")
_COV = ("cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz")
_VELOCITY = ("vx_m_s", "vy_m_s", "vz_m_s")
HEADER = ("t_s", "stage", "status", *_POSITION, "range_m", "range_sigma_m", *_COV, *_VELOCITY, "used", "rejected")
_UPPER = np.triu_indices(3)
_RESERVED = str.maketrans({"+": "&", ",": ";", "\n": " ", "\r": " "})


def solution_row(solution: Solution) -> list[str]:
    """The cells of one row, in the order of ``HEADER``."""
    cov = None if solution.cov_m2 is None else np.asarray(solution.cov_m2)[_UPPER]
    not_known = "" if solution.status is Status.LOST else "nan"
    return [
        format_stamp(solution.t_ns),
        str(int(solution.stage)),
        str(solution.status),
        *_numbers(solution.position_m, 3),
        _number(solution.range_m),
        _number(solution.range_sigma_m),
        *_numbers(cov, 6),
        *([not_known] * 3 if solution.velocity_m_s is None else _numbers(solution.velocity_m_s, 3)),
        "+".join(str(kind) for kind in solution.used),
        "+".join(f"{one.kind}:{one.reason.translate(_RESERVED)}" for one in solution.rejected),
    ]


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.9g}"


def _numbers(values: Array | None, count: int) -> list[str]:
    return [""] * count if values is None else [_number(float(value)) for value in values]


def read_solutions(path: Path | str) -> list[Solution]:
    """The solutions of a run, in file order. InputError, with the row, for a table that is not one of ours."""
    solutions = []
    rows = read_table(Path(path), [HEADER])
    for number, row in enumerate(rows, 1):
        try:
            solutions.append(_solution(row))
        except ValueError as error:
            if number == len(rows) and _is_cut(Path(path)):
                break
            raise InputError(str(error), row.where, "give the solutions.csv of a run, unchanged") from None
    return solutions


def _is_cut(path: Path) -> bool:
    """Whether the last row lacks its end: the writer was killed, or had no room."""
    return not path.read_bytes().endswith(b"\n")


def _solution(row: Row) -> Solution:
    if row.missing:
        raise ValueError(f"{len(row.missing)} of {len(HEADER)} cells are missing, the first {row.missing[0]}")
    t_ns = row.stamp("t_s")
    cov = _vector(row, _COV)
    knows_velocity = row.cells[_VELOCITY[0]] != "nan"
    return Solution(
        t_ns,
        Stage(int(row.text("stage"))),
        Status(row.text("status")),
        _vector(row, _POSITION),
        None if cov is None else cov[[0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3),
        _optional(row, "range_m"),
        _optional(row, "range_sigma_m"),
        _vector(row, _VELOCITY) if knows_velocity else None,
        tuple(Kind(kind) for kind in row.cells["used"].split("+") if kind),
        tuple(_rejected(text, t_ns) for text in row.cells["rejected"].split("+") if text),
    )


def _rejected(text: str, t_ns: int) -> Rejected:
    kind, _, reason = text.partition(":")
    return Rejected(Kind(kind), t_ns, reason)


def _optional(row: Row, column: str) -> float | None:
    return row.number(column) if row.cells.get(column) else None


def _vector(row: Row, columns: tuple[str, ...]) -> Array | None:
    if not any(row.cells.get(column) for column in columns):
        return None
    return np.array([row.number(column) for column in columns])
