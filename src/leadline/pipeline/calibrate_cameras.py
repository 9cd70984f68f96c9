"""`calibrate cameras` from folders to files: find the boards, calibrate, compare, write the rig and its page."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from leadline.calibration.board import Board, Corners, find_corners
from leadline.calibration.derivatives import Medium
from leadline.calibration.views import BoardView
from leadline.errors import InputError
from leadline.wire.calibration_folder import CalibrationFolder, read_calibration_folder, read_image
from leadline.wire.notice import Notice

Tick = Callable[[int, int | None], object]
_THREADS = 2  # decoding and finding corners release the interpreter's lock


@dataclass(frozen=True, eq=False)
class Boards:
    """The boards found in a folder: a view for every pair (both corner sets None where nothing was found)."""

    folder: CalibrationFolder
    views: tuple[BoardView, ...]
    size: tuple[int, int]
    notices: tuple[Notice, ...] = field(default=())

    @property
    def not_found(self) -> list[str]:
        """Images in which the board was not seen."""
        out = []
        for view, pair in zip(self.views, self.folder.pairs, strict=True):
            sides = [(view.left, pair.left), (view.right, pair.right)]
            out += [path.name for corners, path in sides if corners is None and path is not None]
        return out


def find_boards(path: Path, medium: Medium, board: Board, tick: Tick = lambda done, total: None) -> Boards:
    """Look for the board in all images of a folder. InputError for a folder or an image that is no good."""
    folder = read_calibration_folder(path)
    files = folder.files()
    sizes: dict[tuple[int, int], Path] = {}
    corners: dict[Path, Corners | None] = {}

    def look(file: Path) -> tuple[Path, tuple[int, int], Corners | None]:
        image = read_image(file)
        return file, (image.shape[1], image.shape[0]), find_corners(image, board)

    with ThreadPoolExecutor(_THREADS) as pool:
        for done, (file, size, found) in enumerate(pool.map(look, files), start=1):
            sizes.setdefault(size, file)
            corners[file] = found
            tick(done, len(files))
    if len(sizes) > 1:
        (a, file_a), (b, file_b), *_ = sizes.items()
        what = f"images differ in size: {file_a.name} {a[0]}x{a[1]}, {file_b.name} {b[0]}x{b[1]}"
        raise InputError(what, str(path), "use images of one size, as the cameras give them")
    views = tuple(
        BoardView(p.name, medium, corners[p.left], None if p.right is None else corners[p.right]) for p in folder.pairs
    )
    return Boards(folder, views, next(iter(sizes)), folder.notices)


def now() -> str:
    """The date and time for a rig's provenance."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


def inputs_of(sets: Sequence[Boards]) -> dict[str, dict[str, object]]:
    """What went into a calibration, for a rig's provenance: folders, counts, hashes."""
    return {
        str(b.views[0].medium): {
            "folder": str(b.folder.path),
            "pairs" if not b.folder.mono else "images": len(b.folder.pairs),
            "sha256": b.folder.digest(),
        }
        for b in sets
    }
