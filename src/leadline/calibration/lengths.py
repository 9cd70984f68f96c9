"""A board's squares measured in millimetres through a rig, near and far: what a wrong model gets wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leadline.calibration.board import Board
from leadline.calibration.views import BoardView
from leadline.rig import Rig
from leadline.rig_derivatives import point_sensitivity
from leadline.samples import Array

SHOWN = 4.0
"""Standard deviations at which two halves count as different: once in 16,000 for a right model."""


@dataclass(frozen=True, slots=True, eq=False)
class BoardLength:
    """One board as the rig measures it: its middle (3,) m, left frame; the relative error of its size.

    scale_noise: of ``scale``, standard deviation from the corners' noise. scale_by: d(scale)/d(uncertain parameters).
    scatter_mm: standard deviation of the squares' sides. flatness_mm: rms distance from a plane.
    """

    name: str
    middle_m: Array
    scale: float
    scale_noise: float
    scale_by: Array
    scatter_mm: float
    flatness_mm: float

    @property
    def distance_m(self) -> float:
        return float(self.middle_m[2])


@dataclass(frozen=True, slots=True)
class Halves:
    """Mean scale errors of the near and of the far half of the boards and how many standard deviations they differ."""

    near: float
    far: float
    sigmas: float

    @property
    def differ(self) -> bool:
        return self.sigmas > SHOWN


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    view: BoardView
    points_m: Array
    cov_m2: Array


def board_lengths(rig: Rig, views: Sequence[BoardView], board: Board, sigma_px: float) -> list[BoardLength]:
    """Every board that both cameras see whole, in order of distance."""
    measured = [m for v in views if (m := _triangulated(rig, v, board, sigma_px)) is not None]
    if not measured:
        return []
    names = _uncertain(rig)
    ends = [0, board.columns - 1, -board.columns, -1]
    outer = np.array([m.points_m[ends] for m in measured]).reshape(-1, 3)
    moved = point_sensitivity(rig, outer, names) if names else np.zeros((len(outer), 3, 0))
    by_board = moved.reshape(len(measured), 4, 3, -1)
    lengths = [_length(m, board, ends, by) for m, by in zip(measured, by_board, strict=True)]
    return sorted(lengths, key=lambda length: length.distance_m)


def halves(rig: Rig, lengths: Sequence[BoardLength]) -> Halves | None:
    """None where there are fewer than four boards, or all are at about one distance."""
    if len(lengths) < 4 or lengths[-1].distance_m < 1.3 * lengths[0].distance_m:
        return None
    middle = len(lengths) // 2
    (near, near_sigma, near_by), (far, far_sigma, far_by) = _mean(lengths[:middle]), _mean(lengths[middle:])
    by = far_by - near_by
    calibration = float(by @ rig.covariance.of(_uncertain(rig)) @ by)
    return Halves(near, far, abs(far - near) / float(np.sqrt(near_sigma**2 + far_sigma**2 + calibration)))


def mean_scale(rig: Rig, lengths: Sequence[BoardLength]) -> tuple[float, float]:
    """Mean relative error of the boards' size, and its standard deviation from the corners and the calibration."""
    mean, noise, by = _mean(lengths)
    return mean, float(np.sqrt(noise**2 + by @ rig.covariance.of(_uncertain(rig)) @ by))


def _uncertain(rig: Rig) -> tuple[str, ...]:
    return tuple(n for n in rig.covariance.names if n != "water.group_index" and not n.startswith("laser."))


def _mean(lengths: Sequence[BoardLength]) -> tuple[float, float, Array]:
    """Weighted scale error; its noise, the larger of what the corners' noise predicts and the boards show; d/d(rig)."""
    scale = np.array([length.scale for length in lengths])
    weights = 1 / np.array([length.scale_noise for length in lengths]) ** 2
    weights /= weights.sum()
    mean = float(weights @ scale)
    predicted = float(np.sqrt(sum(w**2 * m.scale_noise**2 for w, m in zip(weights, lengths, strict=True))))
    shown = float(np.sqrt(weights @ (scale - mean) ** 2 / max(len(scale) - 1, 1)))
    return mean, max(predicted, shown), weights @ np.array([length.scale_by for length in lengths])


def _triangulated(rig: Rig, view: BoardView, board: Board, sigma_px: float) -> _Measured | None:
    if view.left is None or view.right is None:
        return None
    shared, left, right = np.intersect1d(view.left.ids, view.right.ids, return_indices=True)
    if len(shared) < board.columns * board.rows:
        return None
    points, cov = rig.triangulate(view.left.pixels[left], view.right.pixels[right], sigma_px)
    return _Measured(view, points, cov) if np.isfinite(points).all() else None


def _length(measured: _Measured, board: Board, ends: list[int], by_parameters: Array) -> BoardLength:
    """The board's size is the scale of the similarity that carries it onto the points: unlike a mean of sides, which
    noise makes longer, it has no bias."""
    points, middle = measured.points_m, measured.points_m.mean(axis=0)
    true = board.points_m - board.points_m.mean(axis=0)
    u, _, vt = np.linalg.svd((points - middle).T @ true)
    R = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    laid = true @ R.T
    size2 = float((true**2).sum())
    grid = points.reshape(board.rows, board.columns, 3)
    sides = np.concatenate([np.linalg.norm(np.diff(grid, axis=a), axis=2).ravel() for a in (0, 1)])
    return BoardLength(
        measured.view.name,
        middle,
        float((laid * points).sum()) / size2 - 1,
        float(np.sqrt(np.einsum("ni,nij,nj->", laid, measured.cov_m2, laid))) / size2,
        np.einsum("ni,nik->k", laid[ends], by_parameters) / float((true[ends] ** 2).sum()),
        float(sides.std()) * 1e3,
        float(np.linalg.svd(points - middle, compute_uv=False)[2] / np.sqrt(len(points))) * 1e3,
    )
