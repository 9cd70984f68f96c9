"""`calibrate check`: boards that the calibration has not seen, measured through the rig.

Three questions: does the rig explain the pixels (board poses free, all else fixed)? Do the squares measure right? Do
near and far boards want the same focal length? The last exposes a wrong model: a pinhole in water fits each distance
and none together.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from leadline.calibration.board import Board
from leadline.calibration.cameras import WARP_PRIOR
from leadline.calibration.lengths import BoardLength, Halves, board_lengths, halves, mean_scale
from leadline.calibration.outliers import Found, without_outliers
from leadline.calibration.problem import WARP_NAMES, Problem
from leadline.calibration.start import view_pose
from leadline.calibration.verdict import Verdict, covered
from leadline.calibration.views import BoardView, numbered_alike
from leadline.errors import InputError
from leadline.geometry import Pose
from leadline.rig import Rig
from leadline.rig_derivatives import medium_of
from leadline.rig_parameters import get

_FOCAL = ("left.fx_px", "left.fy_px", "right.fx_px", "right.fy_px")
_MAY_BEND = dict.fromkeys(WARP_NAMES, WARP_PRIOR)  # the board's fault is not the rig's
_NOISE_PX = 0.15  # of corners, where the rig file does not say
_BINS_M = (0.0, 0.6, 1.2, np.inf)
_FEW = 6
_SCALE = 5e-4  # relative: half a millimetre at a metre
_FOCAL_SIGMAS = 5.0


@dataclass(frozen=True, eq=False)
class HeldOut:
    """What the boards say of a rig. scale: mean relative error of their size and its sigma; focal: the same, near and
    far, of the focal length that each half wants; sizes by board, in order of distance."""

    found: Found
    expected_px: float
    lengths: tuple[BoardLength, ...]
    scale: tuple[float, float]
    halves: Halves | None
    focal: Halves | None
    verdict: Verdict


def check_rig(rig: Rig, views: Sequence[BoardView], board: Board, size: tuple[int, int]) -> HeldOut:
    """Judge a rig by boards. InputError where the images are not this rig's, or no pair shows the board."""
    if size != (rig.left.width, rig.left.height):
        what = f"the images are {size[0]}x{size[1]}, the rig's {rig.left.width}x{rig.left.height}"
        raise InputError(what, "--dive", "give images of the rig's own size")
    medium = medium_of(rig)
    usable = [BoardView(v.name, medium, v.left, v.right) for v in numbered_alike(views, board) if v.left and v.right]
    if not usable:
        raise InputError("no pair shows the board in both images", "--dive", "check --board; a check needs pairs")
    poses = [view_pose(rig, view, board) or Pose(np.eye(3), [0.0, 0.0, 1.0]) for view in usable]
    found = without_outliers(usable, board, lambda sights: Problem(sights, WARP_NAMES, _MAY_BEND), rig, poses)
    lengths = board_lengths(rig, found.views, board, found.fit.sigma_px)
    if not lengths:
        raise InputError("the rig sees no board whole", "--dive", "check that rig and images belong together")
    scale, near_far = mean_scale(rig, lengths), halves(rig, lengths)
    expected = float(rig.provenance.get("corner_sigma_px", _NOISE_PX))
    focal = _focal_halves(rig, found)
    judged = _judge(found, expected, scale, near_far, focal, size)
    return HeldOut(found, expected, tuple(lengths), scale, near_far, focal, judged)


def by_distance(lengths: Sequence[BoardLength], board: Board) -> list[tuple[float, int, float, float]]:
    """Groups in order of distance: mean distance m, boards, mean error of a square mm, scatter mm."""
    groups = np.array_split(np.array(lengths, dtype=object), max(1, min(5, len(lengths) // 2)))
    return [
        (
            float(np.mean([b.distance_m for b in group])),
            len(group),
            float(np.mean([b.scale for b in group])) * board.square_m * 1e3,
            float(np.mean([b.scatter_mm for b in group])),
        )
        for group in groups
    ]


def _focal_halves(rig: Rig, found: Found) -> Halves | None:
    """The focal length that the near and the far half of the boards want, relative to the rig's; None for too few."""
    poses = found.fit.poses
    order = np.argsort([pose.t_m[2] for pose in poses])
    if len(order) < 4 or poses[order[-1]].t_m[2] < 1.3 * poses[order[0]].t_m[2]:
        return None
    middle = len(order) // 2
    (near, near_sigma), (far, far_sigma) = (
        _focal(rig, found, half) for half in (order[:middle].tolist(), order[middle:].tolist())
    )
    return Halves(near, far, abs(far - near) / float(np.hypot(near_sigma, far_sigma)))


def _focal(rig: Rig, found: Found, half: Sequence[int]) -> tuple[float, float]:
    place = {int(view): i for i, view in enumerate(half)}
    sights = [dataclasses.replace(s, view=place[s.view]) for s in found.problem.sights if s.view in place]
    fit = Problem(sights, (*_FOCAL, *WARP_NAMES), _MAY_BEND).solve(rig, [found.fit.poses[i] for i in half])
    before = get(rig, _FOCAL)
    weights = 0.25 / before
    factor = float(weights @ (get(fit.rig, _FOCAL) - before))
    count = len(_FOCAL)
    return factor, float(np.sqrt(weights @ fit.covariance[:count, :count] @ weights))


def _judge(
    found: Found,
    expected_px: float,
    scale: tuple[float, float],
    near_far: Halves | None,
    focal: Halves | None,
    size: tuple[int, int],
) -> Verdict:
    grave, light = list[str](), list[str]()
    noise = found.fit.sigma_px
    if noise > max(3 * expected_px, 0.2):
        grave.append(f"the rig explains the boards to {noise:.2f} px only, corners are good to {expected_px:.2f} px")
    if len(found.left_out) > 0.25 * (len(found.left_out) + len(found.problem.sights)):
        grave.append(f"{len(found.left_out)} corner sets do not fit the rig at all")
    mean, sigma = scale
    if abs(mean) > max(4 * sigma, _SCALE):
        grave.append(f"boards come out {mean:+.2%} (+-{sigma:.2%}) of their size: check --square, the water, the port")
    if focal is not None and focal.sigmas > _FOCAL_SIGMAS and abs(focal.far - focal.near) > _SCALE:
        grave.append(
            f"near boards want a focal length {focal.near - focal.far:+.2%} from that of far ones "
            f"({focal.sigmas:.0f} sigma): the model is wrong, or the port or the water has changed"
        )
    if near_far is not None and near_far.differ and abs(near_far.far - near_far.near) > _SCALE:
        grave.append(f"near and far boards differ in size by {abs(near_far.far - near_far.near):.2%}")
    light += [f"left out, it does not fit: {o.name} ({o.side}): {o.why}" for o in found.left_out[:4]]
    if len(found.views) < _FEW:
        light.append(f"only {len(found.views)} boards: take {_FEW} or more")
    if near_far is None:
        light.append("the boards are at about one distance: near and far could not be compared")
    action = "calibrate again: leadline calibrate cameras" if grave else _where_next(found, size)
    return Verdict(not grave, (*grave, *light), action)


def _where_next(found: Found, size: tuple[int, int]) -> str:
    """The distance and the part of the image with the fewest boards."""
    z = np.array([pose.t_m[2] for pose in found.fit.poses])
    bins = [int(((z >= low) & (z < high)).sum()) for low, high in pairwise(_BINS_M)]
    distance = (0.4, 0.9, 1.8)[int(np.argmin(bins))]
    counts = covered(found.views, size)["left"]
    rows, columns = counts.shape
    quarters = counts.reshape(2, rows // 2, 2, columns // 2).sum(axis=(1, 3))
    down, across = divmod(int(np.argmin(quarters)), 2)
    place = f"{('upper', 'lower')[down]} {('left', 'right')[across]}"
    return f"to be surer, take {_FEW} more images at {distance} m in the {place}"
