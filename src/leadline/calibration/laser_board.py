"""A rangefinder whose beam cannot be seen: its readings to the plane of a board that the camera sees.

raw = scale * n . (p - o) / (n . d) + offset, n and p the board's normal and a point of it. Boards at many angles and
distances fix the beam's origin o (but for its place along the beam, see ``leadline.calibration.laser``) and its
direction d. Rangefinders have a true minimum range below which they still answer, wrongly. It is the distance below
which readings spoil the fit of the longer ones; they are named, not averaged in.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from leadline.calibration.board import Board, Corners
from leadline.calibration.group_index import with_group_index
from leadline.calibration.laser import ALONG_SIGMA_M, LASER, SCALE_SIGMA
from leadline.calibration.start import board_pose
from leadline.errors import InputError
from leadline.geometry import Beam, Camera, Pose
from leadline.rig import Rig
from leadline.rig_covariance import RigCovariance
from leadline.rig_parameters import get, replaced
from leadline.samples import Array

MIN_BOARDS = 8
OUTLIER_SIGMAS = 4.0
FOLDS = 5
NEARLY = 1.2  # as good as the best choice of a minimum
_LOOSE = (1.0, 1.0)  # origin across, m; direction, rad: nothing known

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class BoardReading:
    """One image: its name, the board in it and the raw reading, m."""

    name: str
    corners: Corners
    raw_m: float


@dataclass(frozen=True, slots=True, eq=False)
class BoardBeamFit:
    """The beam (in air), which readings made it and how well it fits; all arrays in the order of ``names``."""

    beam: Beam
    covariance: RigCovariance
    names: tuple[str, ...]
    raw_m: Array
    residual_m: Array
    used: Mask
    minimum_m: float | None  # the device's true minimum; None where the readings show none
    bias_m: float  # of the readings below it
    held_out_m: Array  # residuals of the readings used (in their order), each predicted by a fit without it

    @property
    def rms_m(self) -> float:
        return float(np.sqrt(np.mean(self.residual_m[self.used] ** 2)))

    @property
    def held_out_rms_m(self) -> float:
        return float(np.sqrt(np.mean(self.held_out_m**2)))

    @property
    def outliers(self) -> tuple[str, ...]:
        """Names of single readings left out, those below the minimum aside."""
        low = self.raw_m < (self.minimum_m or 0.0)
        return tuple(name for name, out in zip(self.names, ~self.used & ~low, strict=True) if out)


def calibrate_laser_board(
    readings: Sequence[BoardReading], board: Board, camera: Camera, known: RigCovariance | None = None
) -> BoardBeamFit:
    """Beam of an unseen laser in the camera's frame, in air. InputError where the boards do not fix it.

    known: the rig's covariance; the camera (``left.``) is held, but its uncertainty goes into the beam's.
    """
    readings, planes = _planes(readings, board, camera)
    raw_m = np.array([r.raw_m for r in readings])
    minimum, used = _sound(planes, raw_m)
    x = _fit(planes[used], raw_m[used])
    residual = raw_m - _predicted(x, planes)
    sigma = float(np.sqrt(np.sum(residual[used] ** 2) / max(used.sum() - 6, 1)))
    seen = [reading for reading, kept in zip(readings, used, strict=True) if kept]
    beam, covariance = _beam(x, planes[used], sigma)
    if known is not None:
        covariance = _with_camera(covariance, x, seen, board, camera, known)
    across = float(np.sqrt(np.trace(covariance.of(LASER[:3])) - ALONG_SIGMA_M**2))
    if across > 0.1:
        raise InputError(
            f"the boards do not fix the beam (its origin is good to {across:.2f} m only)",
            "",
            "tilt the board to all sides by 20-40 degrees, at several distances",
        )
    low = raw_m < (minimum or 0.0)
    bias = float(np.median(residual[low])) if low.any() else 0.0
    return BoardBeamFit(
        beam, covariance, tuple(r.name for r in readings), raw_m, residual, used, minimum, bias,
        _held_out(planes[used], raw_m[used]),
    )  # fmt: skip


def with_laser(rig: Rig, fit: BoardBeamFit) -> Rig:
    """The rig with this beam in the place of its own; the covariance of cameras and port stays."""
    group = rig.water.group_index if rig.water is not None else 1.0
    known = rig.covariance if rig.water is None else with_group_index(rig.covariance)
    others = tuple(n for n in known.names if not n.startswith("laser."))
    matrix = fit.covariance.of(LASER + others)
    matrix[len(LASER) :, len(LASER) :] = known.of(others)
    laser = dataclasses.replace(fit.beam, group_index=group)
    return dataclasses.replace(rig, laser=laser, covariance=RigCovariance(LASER + others, matrix))


def _planes(readings: Sequence[BoardReading], board: Board, camera: Camera) -> tuple[list[BoardReading], Array]:
    """The readings whose board has a place, and normal and a point of each board's plane (N, 6), camera frame."""
    poses = [board_pose(camera, r.corners, board) for r in readings]
    kept = [(r, pose) for r, pose in zip(readings, poses, strict=True) if pose is not None]
    require_boards(len(kept), len(readings))
    planes = [np.concatenate([pose.R[:, 2], pose.apply(board.points_m).mean(axis=0)]) for _, pose in kept]
    return [r for r, _ in kept], np.array(planes)


def require_boards(found: int, images: int) -> None:
    """InputError where too few boards were found."""
    if found < MIN_BOARDS:
        what = f"the board is seen in {found} of {images} images, {MIN_BOARDS} are needed"
        raise InputError(what, "", "check --board (inner corners), or take more images at many angles")


def _direction(x: Array) -> Array:
    direction = np.array([x[2], x[3], 1.0])
    return np.asarray(direction / np.linalg.norm(direction))


def _predicted(x: Array, planes: Array) -> Array:
    """Readings (N,) for x = origin x, y (at z = 0), direction x/z, y/z, scale, offset."""
    normal, point = planes[:, :3], planes[:, 3:]
    origin = np.array([x[0], x[1], 0.0])
    length = np.einsum("ij,ij->i", normal, point - origin) / (normal @ _direction(x))
    return np.asarray(x[4] * length + x[5])


def _fit(planes: Array, raw_m: Array, *, robust: bool = False) -> Array:
    def misses(x: Array) -> Array:
        return np.concatenate([(raw_m - _predicted(x, planes)) / 0.01, [(x[4] - 1.0) / SCALE_SIGMA, x[5] / 1.0]])

    start = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    fit = least_squares(misses, start, loss="cauchy" if robust else "linear", x_scale=[0.1, 0.1, 0.1, 0.1, 0.01, 0.1])
    return np.asarray(fit.x, np.float64)


def _sound(planes: Array, raw_m: Array) -> tuple[float | None, Mask]:
    """The true minimum, and the readings to fit.

    All readings from a shortest one on are fitted, for every choice of it up to the middle. The residual settles once
    the wrong readings are out: the shortest choice that is nearly as good as the best is the minimum.
    """
    choices = np.unique(np.sort(raw_m)[: len(raw_m) // 2])
    fits = [_fit(planes[raw_m >= c], raw_m[raw_m >= c], robust=True) for c in choices]
    far = np.abs(raw_m - _predicted(fits[-1], planes))[raw_m >= choices[-1]]
    bound = OUTLIER_SIGMAS * max(1.4826 * float(np.median(far)), 0.002)
    spreads = [_spread(x, planes[raw_m >= c], raw_m[raw_m >= c], bound) for x, c in zip(fits, choices, strict=True)]
    place = next(i for i, spread in enumerate(spreads) if spread <= NEARLY * min(spreads))
    kept = raw_m >= choices[place]
    residual = np.abs(raw_m - _predicted(fits[place], planes))
    sigma = max(1.4826 * float(np.median(residual[kept])), 0.002)
    if np.sum(~kept) < 2 or np.median(residual[~kept]) < 2 * sigma:
        return None, residual <= OUTLIER_SIGMAS * sigma
    good = kept & (residual <= OUTLIER_SIGMAS * sigma)
    return float(raw_m[good].min()), good


def _spread(x: Array, planes: Array, raw_m: Array, bound_m: float) -> float:
    """Standard deviation about the fit; one blunder counts no more than the bound."""
    bounded = np.minimum(np.abs(raw_m - _predicted(x, planes)), bound_m)
    return float(np.sqrt(np.sum(bounded**2) / max(len(raw_m) - 6, 1)))


def _beam(x: Array, planes: Array, sigma_m: float) -> tuple[Beam, RigCovariance]:
    """The beam with its origin abreast of the pupil, and the covariance of LASER."""
    steps = np.array([1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5])
    jacobian = np.stack(
        [(_predicted(x + e, planes) - _predicted(x - e, planes)) / (2 * e.sum()) for e in np.diag(steps)], axis=1
    )
    prior = np.diag([1 / _LOOSE[0], 1 / _LOOSE[0], 1 / _LOOSE[1], 1 / _LOOSE[1], 1 / SCALE_SIGMA, 1.0]) ** 2
    cov = np.linalg.inv(jacobian.T @ jacobian / sigma_m**2 + prior)
    lift = np.stack([(_named(x + e) - _named(x - e)) / (2 * e.sum()) for e in np.diag(steps)], axis=1)
    named = _named(x)
    # Sliding along the beam: origin by d, offset by the scale. One reading cannot tell; the doubt is stated as one.
    slide = np.concatenate([named[3:6], np.zeros(4), named[6:7]])
    cov = lift @ cov @ lift.T + ALONG_SIGMA_M**2 * np.outer(slide, slide)
    beam = Beam(named[:3], named[3:6], named[6], named[7], range_sigma_m=sigma_m)
    return beam, RigCovariance(LASER, (cov + cov.T) / 2)


def _with_camera(
    covariance: RigCovariance, x: Array, readings: Sequence[BoardReading], board: Board, camera: Camera,
    known: RigCovariance,
) -> RigCovariance:  # fmt: skip
    """The beam's covariance with what the camera's uncertainty adds, and the correlations between both: the fit again,
    with the camera one standard deviation off along each of its covariance's axes."""
    names = tuple(n for n in known.names if n.startswith("left."))
    if not names:
        return covariance
    rig, root = Rig(camera, camera, Pose.identity()), known.root(names)
    moved = []
    for part in root.T:
        kept, planes = _planes(readings, board, replaced(rig, names, get(rig, names) + part).left)
        moved.append(_named(_fit(planes, np.array([r.raw_m for r in kept]))) - _named(x))
    D = np.stack(moved, axis=1)
    cross = D @ root.T
    matrix = np.block([[covariance.of(LASER) + D @ D.T, cross], [cross.T, known.of(names)]])
    return RigCovariance(LASER + names, matrix)


def _named(x: Array) -> Array:
    """x in terms of LASER (8,), the origin moved along the beam to abreast of the pupil."""
    direction, origin = _direction(x), np.array([x[0], x[1], 0.0])
    back = float(origin @ direction)
    return np.concatenate([origin - back * direction, direction, [x[4], x[5] - x[4] * back]])


def _held_out(planes: Array, raw_m: Array) -> Array:
    """Residuals (N,) of readings that the fit has not seen, each in its turn."""
    misses = np.empty(len(raw_m))
    for fold in range(FOLDS):
        out = np.arange(len(raw_m)) % FOLDS == fold
        misses[out] = raw_m[out] - _predicted(_fit(planes[~out], raw_m[~out]), planes[out])
    return misses
