"""`calibrate cameras` from folders to files: find the boards, calibrate, compare, write the rig and its page."""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from leadline.calibration.board import Board, find_corners
from leadline.calibration.cameras import CameraCalibration, CameraSettings, calibrate_cameras
from leadline.calibration.comparison import ModelError, comparison, pinhole_in_water
from leadline.calibration.heldout import HeldOut, check_rig
from leadline.calibration.verdict import Verdict, best_images, cross_check, verdict
from leadline.calibration.views import BoardView
from leadline.errors import InputError
from leadline.evaluation.calibration_report import write_page
from leadline.files import make_folder
from leadline.rig import Rig
from leadline.rig_derivatives import Medium, medium_of
from leadline.wire.calibration_folder import CalibrationFolder, ImagePair, read_calibration_folder
from leadline.wire.camera_file import write_camera
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
            both = {"left": (view.left, pair.left), "right": (view.right, pair.right)}
            for side, (corners, file) in both.items():
                if corners is None and file is not None:
                    out.append(f"{file.name} ({side})" if pair.left == pair.right else file.name)
        return out


def find_boards(path: Path, medium: Medium, board: Board, tick: Tick = lambda done, total: None) -> Boards:
    """Look for the board in all images of a folder. InputError for a folder or an image that is no good."""
    folder = read_calibration_folder(path)
    sizes: dict[tuple[int, int], str] = {}
    views = list[BoardView]()

    def look(pair: ImagePair) -> tuple[list[tuple[int, int]], BoardView]:
        left, right = pair.load()
        seen = [find_corners(image, board) for image in (left, right) if image is not None]
        seen_sizes = [(image.shape[1], image.shape[0]) for image in (left, right) if image is not None]
        return seen_sizes, BoardView(pair.name, medium, seen[0], None if right is None else seen[1])

    with ThreadPoolExecutor(_THREADS) as pool:
        for done, (seen_sizes, view) in enumerate(pool.map(look, folder.pairs), start=1):
            views.append(view)
            pair = folder.pairs[done - 1]
            for size, file in zip(seen_sizes, (pair.left, pair.right), strict=False):
                sizes.setdefault(size, "" if file is None else file.name)
            tick(done, len(folder.pairs))
    if len(sizes) > 1:
        (a, file_a), (b, file_b), *_ = sizes.items()
        what = f"images differ in size: {file_a} {a[0]}x{a[1]}, {file_b} {b[0]}x{b[1]}"
        raise InputError(what, str(path), "use images of one size, as the cameras give them")
    return Boards(folder, tuple(views), next(iter(sizes)), folder.notices)


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


@dataclass(frozen=True, eq=False)
class CameraReport:
    """A finished `calibrate cameras`: what the command line prints and the page shows."""

    calibration: CameraCalibration
    sets: tuple[Boards, ...]
    models: tuple[ModelError, ...]
    verdict: Verdict
    files: tuple[Path, ...]


def calibrate(
    board: Board,
    out: Path,
    *,
    air: Path | None = None,
    water: Path | None = None,
    air_port: bool = False,
    settings: CameraSettings | None = None,
    tick: Tick = lambda done, total: None,
) -> CameraReport:
    """Calibrate from folders and write the rig file and its page. InputError says what is wrong with the images."""
    if air is None and water is None:
        raise InputError("there are no images", "--air, --water", "give one of them, or both")
    make_folder(out.parent)
    in_air = Medium.AIR_BEHIND_PORT if air_port else Medium.AIR
    places = [(path, medium) for path, medium in ((air, in_air), (water, Medium.WATER)) if path is not None]
    sets = tuple(find_boards(path, medium, board, tick) for path, medium in places)
    _require_alike(sets)
    views = [view for boards in sets for view in boards.views]
    calibration = calibrate_cameras(views, board, sets[0].size, settings or CameraSettings())
    pinhole = pinhole_in_water(calibration)
    models = comparison(calibration, pinhole.rig if pinhole else None)
    near_far = cross_check(calibration)
    judged = verdict(calibration, near_far, best_images(calibration))
    rig = dataclasses.replace(
        calibration.rig,
        pinhole_water=None if pinhole is None else (pinhole.rig.left, pinhole.rig.right),
        provenance=_provenance(calibration, sets, judged),
    )
    page = out.with_suffix(".html")
    if calibration.mono:
        write_camera(out, rig)
    else:
        rig.save(out)
    report = CameraReport(calibration, sets, tuple(models), judged, (out, page))
    write_page(page, report.calibration, models, judged, [line for b in sets for line in remarks(b)])
    return report


def _require_alike(sets: Sequence[Boards]) -> None:
    if len({b.size for b in sets}) > 1:
        sizes = " and ".join(f"{b.size[0]}x{b.size[1]} ({b.folder.path})" for b in sets)
        raise InputError(f"images differ in size: {sizes}", "--air, --water", "use the same cameras as they are")
    if len({b.folder.mono for b in sets}) > 1:
        one = next(b.folder.path for b in sets if b.folder.mono)
        raise InputError("has one camera's images, the other folder two", str(one), "name them left* and right*")


def remarks(boards: Boards) -> list[str]:
    """What was strange about a folder, and where no board was found."""
    lines = [str(notice) for notice in boards.notices]
    missed = boards.not_found
    if missed:
        names = ", ".join(missed[:4]) + (" ..." if len(missed) > 4 else "")
        lines.append(f"{boards.folder.path}: no board found in {len(missed)} images: {names}")
    return lines


def _provenance(calibration: CameraCalibration, sets: Sequence[Boards], judged: Verdict) -> dict[str, object]:
    fit, board = calibration.fit, calibration.board
    return {
        "source": "leadline calibrate cameras",
        "date": now(),
        "board": {
            "columns": board.columns,
            "rows": board.rows,
            "square_m": board.square_m,
            "warp_m": [round(float(w), 7) for w in fit.warp_m],
        },
        "inputs": inputs_of(sets),
        "views": len(calibration.views),
        "corners": int(sum(len(r) for r in fit.residuals)),
        "rms_px": round(fit.rms_px, 5),
        "corner_sigma_px": round(fit.sigma_px, 5),
        "left_out": [f"{o.name} ({o.side}): {o.why}" for o in calibration.left_out],
        "verdict": judged.line,
    }


def check(rig_file: str, path: Path, board: Board, tick: Tick = lambda done, total: None) -> tuple[HeldOut, list[str]]:
    """`calibrate check`: a rig judged by the boards of a folder or dive, and what was strange about the folder."""
    rig = Rig.load(rig_file)
    boards = find_boards(path, medium_of(rig), board, tick)
    return check_rig(rig, boards.views, board, boards.size), remarks(boards)
