"""Guided capture of board images: find the corners, say what is wrong, save what is missing, try the calibration."""

from __future__ import annotations

import dataclasses
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from leadline.calibration.advice import Advice, advised
from leadline.calibration.amiss import amiss
from leadline.calibration.board import Board, Corners, find_corners
from leadline.calibration.cameras import CameraSettings
from leadline.calibration.coverage import (
    BANDS,
    BOARDS,
    EACH_BAND,
    EACH_TILT,
    TILTS,
    Coverage,
    Stance,
    coverage_of,
    guessed_rig,
    stance_of,
)
from leadline.calibration.trial import FIRST, Trial, trial
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

_QUICK_WIDTH_PX = 1280  # a live picture no wider than this is asked first whether there is a board at all
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
        self._views: list[BoardView] = []
        self._size: tuple[int, int] | None = None
        self._pool = ThreadPoolExecutor(2, "leadline-capture")
        self._trying: tuple[Future[Trial], tuple[str, ...]] | None = None
        self._tried: tuple[Trial, tuple[str, ...]] | None = None
        self._steady = Steady(stills=patient)
        self._settings = _settings(rig)
        self._go_on()
        self._refresh()
        self._try()

    def _go_on(self) -> None:
        """With what is there already, seen as `calibrate cameras` will see it."""
        if not self.folder.names:
            return
        found = find_boards(self.folder.out, self._medium, self._board)
        self._size = found.size
        for view in found.views:
            name = Path(view.name).stem
            if view.left is None or view.right is None:
                self.folder.set_aside(name, "no board is found in it")
            else:
                self._views.append(BoardView(name, self._medium, view.left, view.right))
        self._views = numbered_alike(self._views, self._board)

    # -- frames ------------------------------------------------------------------------------------------------------

    def take(self, frame: StereoFrame) -> Look:
        """Judge a frame, and save it if it is good and brings something."""
        self._require_size(frame)
        self._collect()
        left, right = self._pool.map(self._corners, (frame.left, frame.right))
        look = self._judge(frame, left, right)
        dots = {"left": left, "right": right}
        return Look(look.state, look.words, {side: _dots(one) for side, one in dots.items() if one is not None})

    def _judge(self, frame: StereoFrame, left: Corners | None, right: Corners | None) -> Look:
        wrong = amiss((frame.left, left), (frame.right, right), self._board)
        if wrong is not None or left is None or right is None:
            self._steady.forget()
            return Look("bad", "" if wrong is None else wrong.words)
        view = numbered_alike([BoardView(self.folder.next_name(), self._medium, left, right)], self._board)[0]
        still = self._steady.judge(frame, left.pixels)
        stance = stance_of(self._rig, view, self._board)
        if stance is None:
            return Look("bad", "The corners fit no board: check --board (it counts inner corners).")
        if why := self._useless(view, stance):
            return Look("same", why)
        if not still:
            return Look("wait", "Good. Hold the board still …")
        return self._save(frame, view, stance)

    def _useless(self, view: BoardView, stance: Stance) -> str:
        """Why the image would not help; empty where it does."""
        away = [stance.away(other) for other in self._coverage.stances]
        if away and min(away) < 1:
            return f"Like image {int(np.argmin(away)) + 1}, which is saved: move on."
        if self._coverage.complete:  # and yet the calibration is not good: whatever is different helps
            return ""
        more = coverage_of([*self._views, view], self._board, self._rig, self._sure_size)
        return "" if self._coverage.adds(more, stance) else "Seen well, but nothing that is missing: see what is next."

    def _save(self, frame: StereoFrame, view: BoardView, stance: Stance) -> Look:
        note = {
            "t_s": frame.t_s,
            "distance_m": round(stance.distance_m, 3),
            "tilt_deg": {"top": round(stance.top_deg, 1), "left": round(stance.left_deg, 1)},
            "edge_px": [round(one.edge_px, 2) for one in (view.left, view.right) if one is not None],
        }
        self.folder.save([(encode_png(frame.right), ".png"), (encode_png(frame.left), ".png")], note)
        self._views.append(view)
        self._changed()
        return Look("saved", f"Saved: image {len(self._views)}.")

    def undo(self) -> str:
        """Take the last one out again; in words what was done."""
        if not self._views:
            return "There is nothing to take out."
        last = self._views.pop()
        self.folder.set_aside(last.name, "taken out by hand")
        self._changed()
        return f"Image {len(self._views) + 1} is taken out."

    def keep(self, frame: StereoFrame) -> str:
        return "Board images are saved by themselves when they are good."

    def _corners(self, image: Image) -> Corners | None:
        if not self._patient and self._board.charuco is None and not _there(image, self._board):
            return None
        return find_corners(image, self._board)

    # -- what there is -----------------------------------------------------------------------------------------------

    @property
    def _names(self) -> tuple[str, ...]:
        return tuple(view.name for view in self._views)

    @property
    def _sure_size(self) -> tuple[int, int]:
        assert self._size is not None
        return self._size

    @property
    def _judged(self) -> Trial | None:
        """The trial of just these images."""
        return self._tried[0] if self._tried and self._tried[1] == self._names else None

    @property
    def enough(self) -> bool:
        return (
            self._coverage_or_none is not None and self._coverage.complete and bool(self._judged and self._judged.good)
        )

    @property
    def missing(self) -> tuple[str, ...]:
        if self._coverage_or_none is None:
            return ("everything: no picture has come",)
        if self._coverage.missing:
            return tuple(self._coverage.missing)
        if self._judged is None:
            return ("the trial calibration",)
        return self._judged.doubts

    def _changed(self) -> None:
        self._refresh()
        self._try()
        self._write()

    def _write(self) -> None:
        self.folder.write({"enough": self.enough, "missing": list(self.missing), "quality": self._quality()})

    def _refresh(self) -> None:
        """What the images have and what is next, after each change."""
        self._coverage_or_none: Coverage | None = None
        if self._size is None:
            return
        tried = self._tried[0].rig if self._tried else None
        guess = guessed_rig(self._views, self._board, self._size, self._medium)
        self._rig = self._given or tried or guess
        self._coverage_or_none = coverage_of(self._views, self._board, self._rig, self._size)
        self._advice: Advice | None = advised(self._coverage, self._rig, self._board, self._medium)

    @property
    def _coverage(self) -> Coverage:
        assert self._coverage_or_none is not None
        return self._coverage_or_none

    def _require_size(self, frame: StereoFrame) -> None:
        size = frame.left.shape[1], frame.left.shape[0]
        if self._given is not None and size != (self._given.left.width, self._given.left.height):
            lens = self._given.left
            what = f"the pictures are {size[0]}x{size[1]}, the rig is for {lens.width}x{lens.height}"
            raise InputError(what, "--rig", "leave it out, or give the rig of this camera")
        if self._size is None:
            self._size = size
            self._refresh()
        elif size != self._size:
            before = f"{self._size[0]}x{self._size[1]}"
            what = f"the pictures are {size[0]}x{size[1]}, those that are there {before}"
            raise InputError(what, str(self.folder.out), "give a new folder to --out, or the same camera setting")

    # -- the trial calibration ---------------------------------------------------------------------------------------

    def _try(self) -> None:
        if len(self._views) < FIRST or self._size is None or self._trying is not None:
            return
        views, names = list(self._views), self._names
        work = self._pool.submit(trial, views, self._board, self._size, self._settings)
        self._trying = work, names
        if self._patient:
            work.result()
            self._collect()

    def _collect(self) -> None:
        """The trial that is done; one of other images than these is followed by another."""
        if self._trying is None:
            if self._judged is None:
                self._try()
            return
        if not self._trying[0].done():
            return
        (work, names), self._trying = self._trying, None
        found = work.result()
        if found.unfit and len(found.unfit) <= len(names) // 4:
            for name in set(found.unfit) & set(self._names):
                self.folder.set_aside(name, "does not fit the others")
            self._views = [view for view in self._views if view.name not in found.unfit]
            names = tuple(name for name in names if name not in found.unfit)
            found = dataclasses.replace(found, unfit=())
        self._tried = found, names
        self._refresh()
        self._write()
        if names != self._names:
            self._try()

    # -- for the page and for the end --------------------------------------------------------------------------------

    def status(self) -> Status:
        if self._coverage_or_none is None:
            return Status(0, BOARDS, 0.0, "Waiting for the first picture")
        coverage, advice = self._coverage, self._advice
        sides = coverage.cells.items()
        return Status(
            count=len(self._views),
            want=BOARDS,
            share=coverage.share,
            next=self._next(),
            tilt="" if advice is None or self.enough else advice.tilt or "square",
            cells={side: _cells(cells, coverage.needed[side]) for side, cells in sides},
            lists={
                "Distance": [Wanted(coverage.where(name), coverage.bands[name], EACH_BAND) for name in BANDS],
                "Tilted towards the camera": [
                    Wanted(f"{name} edge", coverage.tilts[name], EACH_TILT) for name in TILTS
                ],
            },
            missing=self.missing,
            quality=self._quality(),
            enough=self.enough,
            outline={} if advice is None or self.enough else {k: _points(q) for k, q in advice.outline_px.items()},
        )

    def _next(self) -> str:
        if self.enough:
            return "Enough: these images make a good calibration."
        if self._coverage.complete and self._judged is None:
            return "Trying the calibration …"
        if self._advice is None:
            return "Show the board elsewhere, nearer, farther, tilted."
        return self._advice.words + "."

    def _quality(self) -> str:
        if self._tried is None:
            return ""
        found = self._tried[0]
        if found.rig is None or not found.depth_mm:
            return "; ".join(found.doubts)
        _, at_1_m, far = found.depth_mm
        return f"These images alone: depth good to ±{at_1_m[0]:.1f} mm at 1 m, ±{far[0]:.1f} mm at 2.2 m (1 sigma)"

    def finish(self) -> list[str]:
        """Write what was judged; the next step, a line each."""
        while self._trying is not None:
            self._trying[0].exception()
            self._collect()
        self._pool.shutdown()
        self._write()
        if not self.enough:
            return []
        board = f"--board {self._board.columns}x{self._board.rows} --square {self._board.square_m:g}"
        side = "--water" if self._medium is Medium.WATER else "--air"
        warp = " --warp" if self._tried and self._tried[0].warp else ""
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
    """A quick look: the detector takes a second to be sure that there is none."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    factor = min(1.0, _QUICK_WIDTH_PX / grey.shape[1])
    if factor < 1:
        grey = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    return bool(cv2.findChessboardCorners(grey, board.size, flags=_QUICK)[0])


def _dots(corners: Corners) -> list[Any]:
    return np.round(corners.pixels, 1).tolist()  # type: ignore[no-any-return]


def _points(pixels: Array) -> list[Any]:
    return np.round(pixels, 1).tolist() if np.isfinite(pixels).all() else []


def _cells(cells: Any, needed: Any) -> list[list[str]]:
    return [
        ["idle" if not want else "yes" if has else "no" for has, want in zip(row, wants, strict=True)]
        for row, wants in zip(cells, needed, strict=True)
    ]
