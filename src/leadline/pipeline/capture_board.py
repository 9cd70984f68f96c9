"""Guided capture of board images: find the corners, say what is wrong, save what is missing, try the calibration."""

from __future__ import annotations

import dataclasses
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from leadline.calibration.amiss import amiss
from leadline.calibration.board import Board, Corners, find_corners
from leadline.calibration.cameras import CameraSettings
from leadline.calibration.coverage import BANDS, BOARDS, EACH_BAND, EACH_TILT, TILTS, Stance
from leadline.calibration.guide import Guide
from leadline.calibration.trial import Trial, trial
from leadline.calibration.views import BoardView, numbered_alike
from leadline.errors import InputError
from leadline.pipeline.calibrate_cameras import find_boards
from leadline.pipeline.capture_files import CaptureFolder
from leadline.pipeline.capture_steady import Steady
from leadline.rig import Rig
from leadline.rig_derivatives import Medium
from leadline.samples import Array, Image, StereoFrame
from leadline.sinks.web_capture import Look, Status, Wanted
from leadline.wire.images import encode_png

_QUICK_WIDTHS_PX = 1280, 1920  # to which a live picture is brought, to ask whether there is a board at all
_QUICK = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK


class BoardCapture:
    """``Capture``: pairs in ``out/left`` and ``out/right``, as `calibrate cameras` reads them.

    rig: what is known of the cameras (its port's glass too). patient: a recorded source waits for the trial, and
    pictures far apart are taken as stills.
    """

    what = "board"

    def __init__(
        self, out: Path, board: Board, medium: Medium, rig: Rig | None = None, *, patient: bool = False
    ) -> None:
        self._board, self._medium, self._given, self._patient = board, medium, rig, patient
        kind = {
            "what": self.what,
            "board": {"size": f"{board.columns}x{board.rows}", "square_m": board.square_m, **_markers(board)},
            "medium": str(medium),
        }
        self.folder = CaptureFolder(out, ("right", "left"), kind)
        self.guide = self._begun()
        self._pool = ThreadPoolExecutor(2, "leadline-capture")
        self._trying: tuple[Future[Trial], tuple[str, ...]] | None = None
        self._steady = Steady(stills=patient)
        self._settings = _settings(rig)
        self._tales: list[str] = []
        self._try()

    def _begun(self) -> Guide | None:
        """With what is there already, seen as `calibrate cameras` will see it; None where there is nothing."""
        if not self.folder.names:
            return None
        found = find_boards(self.folder.out, self._medium, self._board)
        views = []
        for view in found.views:
            name = Path(view.name).stem
            if view.left is None or view.right is None:
                self.folder.set_aside(name, "no board is found in it")
            else:
                views.append(dataclasses.replace(view, name=name))
        return Guide(self._board, self._medium, found.size, self._given, views)

    # -- frames ------------------------------------------------------------------------------------------------------

    def take(self, frame: StereoFrame) -> Look:
        """Judge a frame, and save it if it is good and brings something."""
        guide = self._guided(frame)
        self._collect()
        left, right = self._pool.map(self._corners, (frame.left, frame.right))
        look = self._judge(guide, frame, left, right)
        dots = {"left": left, "right": right}
        return Look(
            look.state, look.words, {side: _points(one.pixels) for side, one in dots.items() if one is not None}
        )

    def _judge(self, guide: Guide, frame: StereoFrame, left: Corners | None, right: Corners | None) -> Look:
        wrong = amiss((frame.left, left), (frame.right, right), self._board)
        if wrong is not None or left is None or right is None:
            self._steady.forget()
            return Look("bad", "" if wrong is None else wrong.words)
        view = numbered_alike([BoardView(self.folder.next_name(), self._medium, left, right)], self._board)[0]
        still = self._steady.judge(frame, left.pixels)
        stance = guide.stance(view)
        if stance is None:
            return Look("bad", "The corners fit no board: check --board (it counts inner corners).")
        if why := guide.useless(view, stance):
            return Look("same", why)
        if not still:
            return Look("wait", "Good. Hold the board still …")
        self._save(frame, view, stance)
        guide.add(view)
        self._changed()
        return Look("saved", f"Saved: image {len(guide.views)}.")

    def _save(self, frame: StereoFrame, view: BoardView, stance: Stance) -> None:
        note = {
            "t_s": frame.t_s,
            "distance_m": round(stance.distance_m, 3),
            "tilt_deg": {"top": round(stance.top_deg, 1), "left": round(stance.left_deg, 1)},
            "edge_px": [round(one.edge_px, 2) for one in (view.left, view.right) if one is not None],
        }
        self.folder.save([(encode_png(frame.right), ".png"), (encode_png(frame.left), ".png")], note)

    def undo(self) -> str:
        """Take the last one out again; in words what was done."""
        if self.guide is None or not self.guide.views:
            return "There is nothing to take out."
        last = self.guide.names[-1]
        self.folder.set_aside(last, "taken out by hand")
        self.guide.remove([last])
        self._changed()
        return f"Image {len(self.guide.views) + 1} is taken out."

    def tales(self) -> list[str]:
        """What has happened by itself since the last call."""
        tales, self._tales = self._tales, []
        return tales

    def keep(self, frame: StereoFrame) -> str:
        return "Board images are saved by themselves when they are good."

    def _corners(self, image: Image) -> Corners | None:
        if not self._patient and self._board.charuco is None and not _there(image, self._board):
            return None
        return find_corners(image, self._board)

    def _guided(self, frame: StereoFrame) -> Guide:
        """InputError for pictures of another size than the rig's, or than those that are there."""
        size = frame.left.shape[1], frame.left.shape[0]
        if self._given is not None and size != (self._given.left.width, self._given.left.height):
            lens = self._given.left
            what = f"the pictures are {size[0]}x{size[1]}, the rig is for {lens.width}x{lens.height}"
            raise InputError(what, "--rig", "leave it out, or give the rig of this camera")
        if self.guide is None:
            self.guide = Guide(self._board, self._medium, size, self._given)
        elif size != self.guide.size:
            before = f"{self.guide.size[0]}x{self.guide.size[1]}"
            what = f"the pictures are {size[0]}x{size[1]}, those that are there {before}"
            raise InputError(what, str(self.folder.out), "give a new folder to --out, or the same camera setting")
        return self.guide

    # -- the trial calibration ---------------------------------------------------------------------------------------

    def _changed(self) -> None:
        self._try()
        self._write()

    def _try(self, *, at_end: bool = False) -> None:
        """In another thread: it takes a second, in which the pictures go on.

        A recorded source waits for the last one.
        """
        guide = self.guide
        if guide is None or not guide.wants_trial or self._trying is not None:
            return
        if self._patient and not (guide.coverage.complete or at_end):
            return
        work = self._pool.submit(trial, list(guide.views), self._board, guide.size, self._settings)
        self._trying = work, guide.names
        if self._patient:
            work.exception()
            self._collect()

    def _collect(self) -> None:
        """The trial that is done; one of other images than these is followed by another."""
        if self.guide is None or self._trying is None or not self._trying[0].done():
            return
        (work, names), self._trying = self._trying, None
        for name in self.guide.take(work.result(), names):
            self.folder.set_aside(name, "does not fit the others")
            self._tales.append("An image does not fit the others and is set aside: moved, or not sharp?")
        self._changed()

    # -- for the page and for the end --------------------------------------------------------------------------------

    @property
    def enough(self) -> bool:
        return self.guide is not None and self.guide.enough

    @property
    def missing(self) -> tuple[str, ...]:
        return ("everything: no picture has come",) if self.guide is None else self.guide.missing

    def status(self) -> Status:
        guide = self.guide
        if guide is None:
            return Status(0, BOARDS, 0.0, "Waiting for the first picture")
        coverage, advice = guide.coverage, None if guide.enough else guide.advice
        bands = [Wanted(coverage.where(name), coverage.bands[name], EACH_BAND) for name in BANDS]
        tilts = [Wanted(f"{name} edge", coverage.tilts[name], EACH_TILT) for name in TILTS]
        return Status(
            count=len(guide.views),
            want=BOARDS,
            share=coverage.share,
            next=guide.next,
            tilt="" if advice is None else advice.tilt or "square",
            cells={side: _cells(cells, coverage.needed[side]) for side, cells in coverage.cells.items()},
            lists={"Distance": bands, "Tilted towards the camera": tilts},
            missing=guide.missing,
            quality=self._quality(),
            enough=guide.enough,
            outline={} if advice is None else {side: _points(q) for side, q in advice.outline_px.items()},
        )

    def _quality(self) -> str:
        found = None if self.guide is None else self.guide.tried
        if found is None or not found.depth_mm:
            return "" if found is None else "; ".join(found.doubts)
        _, at_1_m, far = found.depth_mm
        return f"These images alone: depth good to ±{at_1_m[0]:.1f} mm at 1 m, ±{far[0]:.1f} mm at 2.2 m (1 sigma)"

    def _write(self) -> None:
        self.folder.write({"enough": self.enough, "missing": list(self.missing), "quality": self._quality()})

    def finish(self) -> list[str]:
        """Write what was judged; the next step, a line each."""
        self._try(at_end=True)
        while self._trying is not None:
            self._trying[0].exception()
            self._collect()
        self._pool.shutdown()
        self._write()
        if self.guide is None or not self.guide.enough:
            return []
        board = f"--board {self._board.columns}x{self._board.rows} --square {self._board.square_m:g}"
        side = "--water" if self._medium is Medium.WATER else "--air"
        warp = " --warp" if self.guide.tried and self.guide.tried.warp else ""
        return [f"next: leadline calibrate cameras {side} {self.folder.out} {board}{warp} --out rig.yaml"]


def _markers(board: Board) -> dict[str, Any]:
    marks = board.charuco
    return {} if marks is None else {"charuco": marks.dictionary, "marker_m": marks.marker_m}


def _settings(rig: Rig | None) -> CameraSettings:
    if rig is None or rig.port is None or not rig.port.layers:
        return CameraSettings()
    thickness_m, index = rig.port.layers[0]
    return CameraSettings(thickness_m, index)


def _there(image: Image, board: Board) -> bool:
    """A quick look, at two sizes: it misses squares of less than 14 pixels. The detector itself takes a second to be
    sure that there is none."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    width = grey.shape[1]
    sizes = dict.fromkeys((min(width, _QUICK_WIDTHS_PX[0]), min(2 * width, _QUICK_WIDTHS_PX[1])))
    return any(_quickly(grey, size / width, board) for size in sizes)


def _quickly(grey: Any, factor: float, board: Board) -> bool:
    way = cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR
    scaled = grey if factor == 1 else cv2.resize(grey, None, fx=factor, fy=factor, interpolation=way)
    return bool(cv2.findChessboardCorners(scaled, board.size, flags=_QUICK)[0])


def _points(pixels: Array) -> list[Any]:
    return np.round(pixels, 1).tolist() if np.isfinite(pixels).all() else []


def _cells(cells: Any, needed: Any) -> list[list[str]]:
    return [
        ["idle" if not want else "yes" if has else "no" for has, want in zip(row, wants, strict=True)]
        for row, wants in zip(cells, needed, strict=True)
    ]
