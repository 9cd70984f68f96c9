"""Corner sets and single corners that do not fit are left out, by name."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leadline.calibration.board import Board, Corners
from leadline.calibration.problem import Fit, Problem, Sight
from leadline.calibration.start import view_pose
from leadline.calibration.views import SIDES, BoardView, sights_of
from leadline.geometry import Pose
from leadline.rig import Rig, Side

SET_FACTOR = 3.0
"""A set whose median distance is this many times the sets' median is left out."""
CORNER_SIGMAS = 6.0
_ROUNDS = 4
_SHARE = 0.3  # of a set's corners, above which all of it is


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A corner set that was left out: its view, camera, the median distance of its corners and why."""

    name: str
    side: Side
    median_px: float
    why: str


@dataclass(frozen=True, eq=False)
class Found:
    """The fit to what remained."""

    fit: Fit
    problem: Problem
    views: list[BoardView]
    left_out: list[LeftOut]
    corners_left_out: int


def without_outliers(
    views: Sequence[BoardView],
    board: Board,
    problem_of: Callable[[list[Sight]], Problem],
    start: Rig,
    poses: Sequence[Pose],
) -> Found:
    """Fit, leave out what does not fit, fit again, until nothing more goes."""
    kept, gone, corners_gone = list(views), list[LeftOut](), 0
    problem = problem_of(sights_of(kept, board))
    fit = problem.solve(start, poses)
    fit = _second_chance(problem, fit, kept, board)
    for _ in range(_ROUNDS):
        bad = _bad_sets(problem, fit, kept)
        trimmed, count = _trimmed(problem, fit, kept, {(o.name, o.side) for o in bad})
        if not bad and not count:
            break
        gone += bad
        corners_gone += count
        present = [i for i, v in enumerate(trimmed) if v.left is not None or v.right is not None]
        kept = [trimmed[i] for i in present]
        problem = problem_of(sights_of(kept, board))
        fit = problem.solve(fit.rig, [fit.poses[i] for i in present])
    return Found(fit, problem, kept, gone, corners_gone)


def _second_chance(problem: Problem, fit: Fit, views: Sequence[BoardView], board: Board) -> Fit:
    """A plane has two poses that look nearly alike. Boards that do not fit start again, the lenses known."""
    strange = {sight.view for sight in _strange(problem, fit)}
    if not strange:
        return fit
    poses = [
        (view_pose(fit.rig, view, board) if i in strange else None) or pose
        for i, (view, pose) in enumerate(zip(views, fit.poses, strict=True))
    ]
    again = problem.solve(fit.rig, poses)
    return again if again.cost * again.sigma_px**2 < fit.cost * fit.sigma_px**2 else fit


def _strange(problem: Problem, fit: Fit) -> list[Sight]:
    medians = np.array([np.median(np.linalg.norm(r, axis=1)) for r in fit.residuals])
    return [s for s, median in zip(problem.sights, medians, strict=True) if median > SET_FACTOR * np.median(medians)]


def _bad_sets(problem: Problem, fit: Fit, views: Sequence[BoardView]) -> list[LeftOut]:
    medians = np.array([np.median(np.linalg.norm(r, axis=1)) for r in fit.residuals])
    limit = SET_FACTOR * float(np.median(medians))
    out = []
    for sight, r, median in zip(problem.sights, fit.residuals, medians, strict=True):
        stray = float(np.mean(np.linalg.norm(r, axis=1) > CORNER_SIGMAS * fit.sigma_px))
        if median > limit or stray > _SHARE:
            corners = views[sight.view].corners(sight.side)
            why = "it is blurred" if corners is not None and corners.blurred else "its corners do not fit the others"
            out.append(LeftOut(views[sight.view].name, sight.side, float(median), why))
    return out


def _trimmed(
    problem: Problem, fit: Fit, views: Sequence[BoardView], bad: set[tuple[str, Side]]
) -> tuple[list[BoardView], int]:
    """The views without bad sets and without single corners that are far off, and how many of those."""
    sets: dict[tuple[int, Side], Corners | None] = {(i, s): v.corners(s) for i, v in enumerate(views) for s in SIDES}
    count = 0
    for sight, r in zip(problem.sights, fit.residuals, strict=True):
        key = (sight.view, sight.side)
        corners = sets[key]
        if (views[sight.view].name, sight.side) in bad or corners is None:
            sets[key] = None
            continue
        near: NDArray[np.bool_] = np.linalg.norm(r, axis=1) <= CORNER_SIGMAS * fit.sigma_px
        if not near.all():
            count += int((~near).sum())
            sets[key] = dataclasses.replace(corners, ids=corners.ids[near], pixels=corners.pixels[near])
    return [BoardView(v.name, v.medium, sets[i, "left"], sets[i, "right"]) for i, v in enumerate(views)], count
