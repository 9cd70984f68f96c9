"""What the page draws into the two images and around them: plain lists of numbers, None where there is none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from leadline.rig import Rig, Side
from leadline.samples import Array, Detection, Kind, LaserRange, Solution, StereoFrame
from leadline.target import Sphere, Target

BEAM_FROM_M, BEAM_TO_M, BEAM_POINTS = 0.2, 5.0, 48
READING_KEPT_NS = 300_000_000  # an older reading says no more where the spot is
OUTLINE_POINTS = 49
SIDES: tuple[Side, Side] = ("left", "right")


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A frame with what was found in it, and the reading that stood then."""

    number: int
    frame: StereoFrame
    boxes: tuple[Detection, ...]
    solution: Solution
    reading: LaserRange | None


def beam(rig: Rig) -> dict[str, list[Any]] | None:
    """Where the laser's spot can be: its beam from 0.2 to 5 m in both images; None for a rig without a laser."""
    if rig.laser is None:
        return None
    lengths_m = np.geomspace(BEAM_FROM_M, BEAM_TO_M, BEAM_POINTS)[:, None]
    points_m = rig.laser.origin_m + lengths_m * rig.laser.direction
    return {side: pixels(rig.project_one(points_m, side)) for side in SIDES}


def view(rig: Rig) -> dict[str, list[float]]:
    """What the left camera sees: the directions (x, y, z) at the middle of each edge of its image."""
    width, height = rig.left.width - 1.0, rig.left.height - 1.0
    edges = {
        "left": (0, height / 2),
        "right": (width, height / 2),
        "top": (width / 2, 0),
        "bottom": (width / 2, height),
    }
    _, directions = rig.rays(np.array(list(edges.values())), "left")
    return {name: numbers(one) for name, one in zip(edges, directions, strict=True)}


def overlay(rig: Rig, target: Target, picture: Picture) -> dict[str, Any]:
    """Boxes (of the left image), the spot where the reading puts it, the target's place and outline in both images."""
    solution, lit_m = picture.solution, _lit_m(rig, picture)
    return {
        "boxes": [
            {"box": numbers(one.box_px, 1), "label": one.label, "score": number(one.score, 2)} for one in picture.boxes
        ],
        "spot": None if lit_m is None else {side: pixel(rig.project_one(lit_m[None], side)[0]) for side in SIDES},
        "spot_seen": Kind.SPOT in solution.used,
        "target": None
        if solution.position_m is None
        else {side: pixel(rig.project_one(solution.position_m[None], side)[0]) for side in SIDES},
        "outline": _outline(rig, target, solution),
    }


def _lit_m(rig: Rig, picture: Picture) -> Array | None:
    reading = picture.reading
    if rig.laser is None or reading is None or abs(picture.frame.t_ns - reading.t_ns) > READING_KEPT_NS:
        return None
    return rig.laser.point_m(reading.range_m)


def _outline(rig: Rig, target: Target, solution: Solution) -> dict[str, list[Any]] | None:
    """A ball's rim as each camera sees it: where straight lines from the camera touch the ball that was located."""
    if not isinstance(target, Sphere) or solution.position_m is None or solution.range_m is None:
        return None
    radius_m = float(np.linalg.norm(solution.position_m)) - solution.range_m
    eyes = {"left": np.zeros(3), "right": rig.T_left_right.t_m}
    rims = {side: _rim_m(solution.position_m - eyes[side], radius_m) for side in SIDES}
    if any(rim is None for rim in rims.values()):
        return None
    return {side: pixels(rig.project_one(rim + eyes[side], side)) for side, rim in rims.items() if rim is not None}


def _rim_m(centre_m: Array, radius_m: float) -> Array | None:
    """(N, 3) of a ball seen from the origin; None from inside."""
    distance_m = float(np.linalg.norm(centre_m))
    if not 0 < radius_m < distance_m:
        return None
    share = (radius_m / distance_m) ** 2
    along = centre_m / distance_m
    across = np.cross(along, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    angle = np.linspace(0, 2 * np.pi, OUTLINE_POINTS)[:, None]
    ring = np.cos(angle) * across + np.sin(angle) * np.cross(along, across)
    return np.asarray(centre_m * (1 - share) + radius_m * np.sqrt(1 - share) * ring)


def pixels(points_px: Array) -> list[Any]:
    return [pixel(point) for point in points_px]


def pixel(point_px: Array) -> list[float] | None:
    return [round(float(one), 1) for one in point_px] if np.isfinite(point_px).all() else None


def number(value: float | None, digits: int = 5) -> float | None:
    """JSON knows no NaN."""
    return None if value is None or not np.isfinite(value) else round(float(value), digits)


def numbers(values: Any, digits: int = 5) -> list[Any]:
    return [number(one, digits) for one in values]
