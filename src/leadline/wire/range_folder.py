"""Boards with a rangefinder: ``ranges.csv`` (image,range_m) and the images, in ``images/`` or beside it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from leadline.errors import InputError
from leadline.wire.notice import Notice, NoticeKind
from leadline.wire.table import Row, read_table

HEADER = ("image", "range_m")


@dataclass(frozen=True, slots=True)
class RangeImage:
    """One image and the raw reading that goes with it, m."""

    name: str
    path: Path
    raw_m: float


@dataclass(frozen=True, slots=True)
class RangeFolder:
    """The rows that make sense, in the table's order; the others are told."""

    path: Path
    images: tuple[RangeImage, ...]
    notices: tuple[Notice, ...] = ()


def is_range_folder(folder: Path) -> bool:
    return (folder / "ranges.csv").is_file()


def read_range_folder(folder: Path) -> RangeFolder:
    """InputError where there is no table, or no row of it has an image."""
    rows = read_table(folder / "ranges.csv", [HEADER])
    images: list[RangeImage] = []
    notices: list[Notice] = []
    for row in rows:
        try:
            images.append(_image(folder, row))
        except ValueError as error:
            notices.append(Notice(NoticeKind.SKIPPED, row.where, str(error)))
    if not images:
        what = f"no row can be used ({notices[0].why})" if notices else "no rows"
        raise InputError(what, str(folder / "ranges.csv"), "give one row (image,range_m) for every image")
    return RangeFolder(folder, tuple(images), tuple(notices))


def _image(folder: Path, row: Row) -> RangeImage:
    name, raw_m = row.text("image"), row.number("range_m")
    if raw_m <= 0:  # devices say 0 or less for "no return"
        raise ValueError(f"range_m {row.cells['range_m']} is not a distance")
    for path in (folder / "images" / name, folder / name):
        if path.is_file():
            return RangeImage(name, path, raw_m)
    raise ValueError(f"no file {name}")
