"""A dive as a folder: ``frames.csv``, ``laser.csv``, optional ``motion.csv``, ``truth.csv`` and ``rig.yaml``.

Tables are read on opening, images when their turn comes. A row that makes no sense is left out and told with its place;
InputError only where no dive is left.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from leadline.errors import InputError
from leadline.samples import Image, LaserRange, StereoFrame, VehicleMotion
from leadline.wire.images import SizeError, decode_image, require_same_size
from leadline.wire.notice import Notice, NoticeKind
from leadline.wire.table import Row, read_table

FRAME_HEADERS = (("t_s", "left", "right"), ("t_s", "stereo"))
LASER_HEADER = ("t_s", "range_m")
VELOCITY, ROTATION = ("vx_m_s", "vy_m_s", "vz_m_s"), ("wx_rad_s", "wy_rad_s", "wz_rad_s")
MOTION_SIGMAS = ("velocity_sigma_m_s", "rotation_sigma_rad_s")

Tell = Callable[[Notice], None]


@dataclass(frozen=True, slots=True)
class FrameEntry:
    """One row of ``frames.csv``. ``files`` are (left, right), or one side-by-side file; ``name`` as in the table."""

    where: str
    files: tuple[Path, ...]
    name: str
    t_ns: int
    arrival_ns: int | None
    left_t_ns: int | None
    right_t_ns: int | None
    laser_on: bool | None = None

    def load(self) -> StereoFrame:
        """Read the images. Raises ValueError with the file and what is the matter with it."""
        contents = [_decoded(path) for path in self.files]
        if len(contents) == 1:
            left, right = split_side_by_side(contents[0][1])
            encoded = None  # the source's bytes are of both images together
        else:
            (left_bytes, left), (right_bytes, right) = contents
            encoded = (left_bytes, right_bytes)
        require_same_size(left, right)
        times = self.arrival_ns, self.left_t_ns, self.right_t_ns
        return StereoFrame(self.t_ns, left, right, *times, self.name, encoded, self.laser_on)


def split_side_by_side(image: Image) -> tuple[Image, Image]:
    """(H, 2W[, 3]) -> left half, right half (each (H, W[, 3])). Raises SizeError for an odd width."""
    width = image.shape[1]
    if width % 2:
        raise SizeError(f"a side-by-side image needs an even width, not {width}")
    return np.ascontiguousarray(image[:, : width // 2]), np.ascontiguousarray(image[:, width // 2 :])


def _decoded(path: Path) -> tuple[bytes, Image]:
    try:
        data = path.read_bytes()
        return data, decode_image(data)
    except OSError as error:
        raise ValueError(f"{path.name}: {error.strerror or error}") from None
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from None


def read_frames(folder: Path, tell: Tell) -> list[FrameEntry]:
    """The rows of ``frames.csv`` in file order, those with a missing image left out. InputError if none is left."""
    rows = read_table(folder / "frames.csv", FRAME_HEADERS)
    entries: list[FrameEntry] = []
    missing = ""
    for row in rows:
        try:
            entry = _frame_entry(folder, row)
            absent = [path.name for path in entry.files if not path.is_file()]
            if absent:
                missing = missing or absent[0]
                raise ValueError(f"no file {absent[0]}")
            entries.append(entry)
        except ValueError as error:
            tell(Notice(NoticeKind.SKIPPED, row.where, str(error)))
    if not entries:
        what = "no rows" if not rows else f"no image is there ({missing} ...)" if missing else "no row can be read"
        raise InputError(what, str(folder / "frames.csv"), "give one row and its images for every stereo frame")
    return entries


def _frame_entry(folder: Path, row: Row) -> FrameEntry:
    columns = ("left", "right") if "left" in row.cells else ("stereo",)
    names = [row.text(column) for column in columns]
    return FrameEntry(
        row.where,
        tuple(folder / name for name in names),
        names[0],
        row.stamp("t_s"),
        row.optional_stamp("t_arrival_s"),
        row.optional_stamp("t_left_s"),
        row.optional_stamp("t_right_s"),
        _switch(row, "laser_on"),
    )


def _switch(row: Row, column: str) -> bool | None:
    cell = (row.cells.get(column) or "").strip()
    if cell not in {"", "0", "1"}:
        raise ValueError(f"{column} is {cell}, not 0 or 1")
    return None if cell == "" else cell == "1"


def read_laser(folder: Path, tell: Tell) -> list[tuple[str, LaserRange]]:
    """The readings of ``laser.csv`` in file order with their places; [] without the file (a dive may have no laser)."""
    path = folder / "laser.csv"
    if not path.is_file():
        return []
    readings = []
    for row in read_table(path, [LASER_HEADER]):
        try:
            readings.append((row.where, _laser_range(row, tell)))
        except ValueError as error:
            tell(Notice(NoticeKind.SKIPPED, row.where, str(error)))
    return readings


def _laser_range(row: Row, tell: Tell) -> LaserRange:
    range_m = row.number("range_m")
    if range_m <= 0:  # devices say 0 or less for "no return"
        raise ValueError(f"range_m {row.cells['range_m']} is not a distance")
    t_ns, arrival_ns = row.stamp("t_s"), row.optional_stamp("t_arrival_s")
    quality = None
    if row.cells.get("quality"):
        try:
            quality = row.number("quality")
        except ValueError as error:
            tell(Notice(NoticeKind.IGNORED, row.where, str(error)))
    return LaserRange(t_ns, range_m, quality, arrival_ns)


def read_motion(folder: Path, tell: Tell) -> list[tuple[str, VehicleMotion]]:
    """The rows of ``motion.csv`` in file order with their places; [] without the file."""
    path = folder / "motion.csv"
    if not path.is_file():
        return []
    motions = []
    for row in read_table(path, [("t_s", *VELOCITY), ("t_s", *ROTATION)]):
        try:
            motions.append((row.where, _vehicle_motion(row)))
        except ValueError as error:
            tell(Notice(NoticeKind.SKIPPED, row.where, str(error)))
    return motions


def _vehicle_motion(row: Row) -> VehicleMotion:
    velocity, rotation = _vector(row, VELOCITY), _vector(row, ROTATION)
    if velocity is None and rotation is None:
        raise ValueError("neither a velocity nor a rotation")
    sigmas = {name: row.number(name) for name in MOTION_SIGMAS if row.cells.get(name)}
    for name, sigma in sigmas.items():
        if sigma <= 0:
            raise ValueError(f"{name} must be positive")
    return VehicleMotion(row.stamp("t_s"), velocity, rotation, **sigmas, arrival_ns=row.optional_stamp("t_arrival_s"))


def _vector(row: Row, columns: tuple[str, ...]) -> tuple[float, float, float] | None:
    """None where all three cells are empty (a sensor without its lock); ValueError where only some are."""
    if not any(row.cells.get(column) for column in columns):
        return None
    x, y, z = (row.number(column) for column in columns)
    return x, y, z
