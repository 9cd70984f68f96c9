"""What a sceptic would ask of a calibration: is it good, what is doubtful, what to do next. Each in one line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leadline.calibration.cameras import CameraCalibration
from leadline.calibration.comparison import calibration_sigma_mm, field_points
from leadline.calibration.information import Suggestion, limits, spread, suggestion, with_air
from leadline.calibration.lengths import Halves, board_lengths, halves
from leadline.calibration.views import LAYER_NAMES, SIDES, BoardView
from leadline.calibration.warp import warp_of
from leadline.rig_derivatives import Medium, medium_of
from leadline.rig_parameters import get
from leadline.samples import Array

FEW = 8
"""Views of a medium, below which a calibration is called thin."""
_SAME_DISTANCE = 1.4  # farthest over nearest
CELLS = (6, 4)  # of the image, for its coverage
_COVERED = 0.5
_NOISY_PX = 0.35
_GOOD_MM_AT_1_M = 2.0
_MOVED = 2.0  # of its own standard deviations: then the stated uncertainty is no longer true
_FAR_OFF = 3.0  # standard deviations from a prior


@dataclass(frozen=True, slots=True)
class Verdict:
    """``good`` for use as it is; ``doubts`` in order of weight; ``next_action`` always says something to do."""

    good: bool
    doubts: tuple[str, ...]
    next_action: str

    @property
    def line(self) -> str:
        return "good" if self.good else f"not good: {self.doubts[0]}"


def verdict(calibration: CameraCalibration, halves: Halves | None, suggested: Suggestion | None) -> Verdict:
    """From the calibration itself, its near/far cross-validation and the images that would help most."""
    grave = [*_wrong_model(calibration, halves), *_too_uncertain(calibration)]
    light = [*_thin(calibration), *_strange(calibration)]
    warp, otherwise_sound = warp_of(calibration), not grave
    if warp.sure and not calibration.settings.warp:
        bent = f"the board is bent ({warp}; it moves what was found by {warp.moves:.1f} sigma)"
        (grave if warp.moves > _MOVED else light).append(bent)
        if otherwise_sound:
            return Verdict(not grave, (*grave, *light), "calibrate again with --warp")
    action = str(suggested) if suggested else "check the rig on boards that it has not seen: leadline calibrate check"
    if calibration.rig.port is not None and Medium.WATER not in calibration.media():
        action = "take 15 or more images of the board in water"
    return Verdict(not grave, (*grave, *light), action)


def cross_check(calibration: CameraCalibration) -> Halves | None:
    """Near against far boards in water (in air for a rig without a port); None for too few or one camera."""
    medium = medium_of(calibration.rig)
    views = [v for v in calibration.views if v.medium is medium]
    return halves(calibration.rig, board_lengths(calibration.rig, views, calibration.board, calibration.fit.sigma_px))


def covered(views: Sequence[BoardView], size: tuple[int, int]) -> dict[str, Array]:
    """The number of corners in each cell (rows, columns) of the left and right image."""
    out: dict[str, Array] = {}
    for side in SIDES:
        sets = [c.pixels for v in views if (c := v.corners(side)) is not None]
        if sets:
            out[side] = cell_counts(np.concatenate(sets), size)
    return out


def cell_counts(pixels: Array, size: tuple[int, int]) -> Array:
    """The number of pixels (n, 2) in each cell (rows, columns) of an image; those beside it are in none."""
    columns, rows = CELLS
    place = np.floor(pixels / (size[0] / columns, size[1] / rows)).astype(int)
    inside = ((place >= 0) & (place < (columns, rows))).all(axis=1)
    counts = np.bincount(place[inside] @ (1, columns), minlength=rows * columns)
    return counts.reshape(rows, columns).astype(np.float64)


def band_mm(calibration: CameraCalibration) -> Array:
    """Depth's standard deviation, mm (D, 3), by distance and place of ``field_points``; empty for one camera."""
    if calibration.mono or calibration.rig.port is None:
        return np.zeros((0, 3))
    points = field_points(calibration.rig)
    return calibration_sigma_mm(calibration.rig, points.reshape(-1, 3))[0].reshape(points.shape[:2])


def depth_limits(calibration: CameraCalibration) -> dict[str, float]:
    """What limits the depth at the middle of the field, by group; empty for one camera or without a port."""
    if calibration.mono or calibration.rig.port is None:
        return {}
    return limits(calibration.rig, field_points(calibration.rig)[1:, 0])


def best_images(calibration: CameraCalibration) -> Suggestion | None:
    """The six images that would help most; None for one camera or without a port."""
    if calibration.mono or calibration.rig.port is None:
        return None
    return suggestion(calibration, field_points(calibration.rig)[1:].reshape(-1, 3))


def _wrong_model(calibration: CameraCalibration, halves: Halves | None) -> list[str]:
    out = []
    sets = len(calibration.problem.sights) + len(calibration.left_out)
    if len(calibration.left_out) > 0.25 * sets:
        out.append(
            f"{len(calibration.left_out)} of {sets} corner sets do not fit one rig: check the board and the pairs"
        )
    sigma = calibration.fit.sigma_px
    if sigma > _NOISY_PX:
        why = f"images are blurred, or the board is not flat, or has not {_size(calibration)}"
        out.append(f"corners scatter by {sigma:.2f} px: {why}")
    if halves is not None and halves.differ:
        out.append(
            f"near and far boards disagree by {abs(halves.far - halves.near):.2%} ({halves.sigmas:.0f} sigma): "
            "the port is not flat, or not as described"
        )
    out += [f"{what}: {then}" for what, then in _far_from_prior(calibration)]
    return out


def _size(calibration: CameraCalibration) -> str:
    b = calibration.board
    return f"{b.columns}x{b.rows} corners"


def _far_from_prior(calibration: CameraCalibration) -> list[tuple[str, str]]:
    told = {
        "water.index": ("the water's index", "check --water-state, and that every board was in the water"),
        LAYER_NAMES[0]: ("the glass's thickness", "give --port-thickness"),
        LAYER_NAMES[1]: ("the glass's index", "give --port-index"),
    }
    out = []
    for name, (what, then) in told.items():
        prior = calibration.priors.get(name)
        if prior is None:
            continue
        value = float(get(calibration.rig, [name])[0])
        # what the images alone say is pulled towards the prior: their disagreement is judged before that
        if abs(value - prior.mean) > _FAR_OFF * max(prior.sigma**2 - calibration.fit.sigma(name) ** 2, 1e-18) ** 0.5:
            out.append((f"{what} comes out {value:.4g}, expected {prior.mean:.4g} +-{prior.sigma:.2g}", then))
    return out


def _too_uncertain(calibration: CameraCalibration) -> list[str]:
    band = band_mm(calibration)
    if not len(band):
        return []
    at_1_m = float(band[2, 0])
    if not at_1_m <= _GOOD_MM_AT_1_M:
        return [f"the images fix the depth at 1 m only to {at_1_m:.1f} mm"]
    return []


def _thin(calibration: CameraCalibration) -> list[str]:
    out = []
    for medium in sorted(calibration.media()):
        members = [i for i, v in enumerate(calibration.views) if v.medium is medium]
        if len(members) < FEW:
            out.append(f"only {len(members)} boards in {medium}: take 15 or more")
        ratio = spread([calibration.fit.poses[i] for i in members])
        if ratio < _SAME_DISTANCE:
            z = float(np.mean([calibration.fit.poses[i].t_m[2] for i in members]))
            out.append(f"all boards in {medium} are at about one distance ({z:.2f} m): take some nearer and farther")
    size = (calibration.rig.left.width, calibration.rig.left.height)
    for side, counts in covered(calibration.views, size).items():
        share = float((counts > 0).mean())
        if share < _COVERED:
            out.append(f"boards cover {share:.0%} of the {side} image: bring them into its corners")
    return out


def _without_air(calibration: CameraCalibration) -> str:
    if calibration.mono:
        return "port and lens are hard to tell apart"
    here, both = with_air(calibration, field_points(calibration.rig)[-1, :2])
    return f"the depth at 2.2 m is good to {here:.2f} mm, with the same boards in air too it would be {both:.2f} mm"


def _strange(calibration: CameraCalibration) -> list[str]:
    out = []
    blurred = [v.name for v in calibration.views if any(c is not None and c.blurred for c in (v.left, v.right))]
    if blurred:
        out.append(f"{len(blurred)} images are blurred: {', '.join(blurred[:3])}{' ...' if len(blurred) > 3 else ''}")
    if calibration.left_out:
        names = [f"{o.name} ({o.side})" for o in calibration.left_out]
        out.append(f"left out, they do not fit: {', '.join(names[:4])}{' ...' if len(names) > 4 else ''}")
    port = calibration.rig.port
    if port is not None:
        tilt = float(np.degrees(np.arccos(min(1.0, port.normal[2]))))
        if tilt > 10:
            out.append(f"the port comes out tilted by {tilt:.0f} degrees: check that no image is turned")
        if port.distance_m > 0.15:
            out.append(f"the port comes out {port.distance_m * 1e3:.0f} mm before the cameras: check the board's size")
    if calibration.media() == {Medium.WATER}:
        out.append(f"no images in air: {_without_air(calibration)}")
    if Medium.WATER not in calibration.media():
        out.append("no images in water: this rig is for air; behind a port in water it would be wrong by a quarter")
    return out
