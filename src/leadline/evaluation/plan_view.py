"""What a rig sees of a target on its way in: overlap, disparity, where the spot runs, from where to where each of its
measurements can be had. Geometry only; the accuracies are in ``plan``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from leadline.evaluation.plan import Rehearsal, aimed
from leadline.evaluation.plan_sight import box_of, vector_at
from leadline.rig import Rig
from leadline.samples import Array, Kind

FINE_M = tuple(float(v) for v in np.geomspace(0.05, 6.0, 100))
FILLS = 0.95  # a box this much of the image high or wide fills the view
SMALLEST_SPOT_PX = 1.0  # radius below which a spot is a point
Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class View:
    """At one distance straight ahead. overlap: share of the left image that the right camera sees too."""

    distance_m: float
    overlap: float
    disparity_px: float
    spot_left_px: tuple[float, float] | None
    spot_right_px: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class HandOvers:
    """Distances, m; None where it never happens between ``FINE_M``'s ends.

    both_from: from where on both cameras see the same thing. whole_from: the target is wholly in both images.
    fills_until: it fills the left image up to there. spot_left, spot_right: where that camera sees the spot.
    spot_resolved_until: farther off it is smaller than a pixel. spans: where each kind of measurement can be had.
    """

    both_from_m: float | None
    whole_from_m: float | None
    fills_until_m: float | None
    spot_left_m: Span | None
    spot_right_m: Span | None
    spot_resolved_until_m: float | None
    spans_m: dict[str, Span]


def views(rig: Rig, distances_m: Sequence[float]) -> list[View]:
    """One for each distance that the rig sees at all."""
    out = []
    for z in distances_m:
        share, disparity = _overlap(rig, z)
        if np.isfinite(disparity):  # not so within the port
            out.append(View(z, share, disparity, *_spot(rig, z)))
    return out


def hand_overs(rehearsal: Rehearsal) -> HandOvers:
    """Of a target that comes nearer along the beam, or along the middle of the common view."""
    rig, target = rehearsal.rig, rehearsal.target
    spots = {z: _spot(rig, z) for z in FINE_M}
    seen = _kinds(rehearsal)
    spans = {kind.value: _span([z for z in FINE_M if kind.value in seen.get(z, ())].__contains__) for kind in Kind}
    boxes = {z: [box_of(rig, target, _at(rehearsal, z), side) for side in ("left", "right")] for z in seen}

    def whole(z: float) -> bool:
        return z in boxes and all(box is not None and _whole(rig, box) for box in boxes[z])

    def fills(z: float) -> bool:
        return z in boxes and (box := boxes[z][0]) is not None and _fills(rig, box)

    resolved = None
    if rig.laser is not None:
        resolved = rehearsal.config.beam.spot_radius_m * rig.focal_outside_px / SMALLEST_SPOT_PX
    return HandOvers(
        both_from_m=_first(lambda z: _overlap(rig, z)[0] > 0),
        whole_from_m=_first(whole),
        fills_until_m=_last(fills),
        spot_left_m=_span(lambda z: spots[z][0] is not None),
        spot_right_m=_span(lambda z: spots[z][1] is not None),
        spot_resolved_until_m=resolved,
        spans_m={kind: span for kind, span in spans.items() if span is not None},
    )


def _at(rehearsal: Rehearsal, distance_m: float) -> Array:
    return vector_at(rehearsal.target, aimed(rehearsal.rig, distance_m))


def _kinds(rehearsal: Rehearsal) -> dict[float, set[str]]:
    """What can be measured, for each distance at which both cameras see something."""
    out = {}
    for z in FINE_M:
        nearest = aimed(rehearsal.rig, z)
        if np.isfinite(nearest).all():
            out[z] = rehearsal.kinds(nearest)
    return out


def _overlap(rig: Rig, z_m: float) -> tuple[float, float]:
    """Share of the left image seen by the right camera too at a depth, and the disparity in its middle, px."""
    camera = rig.left
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, 49), np.linspace(0, camera.height - 1, 28))
    q_px = np.stack([u.ravel(), v.ravel()], axis=1)
    origins, directions = rig.rays(q_px)
    with np.errstate(invalid="ignore", divide="ignore"):
        points = origins + ((z_m - origins[:, 2]) / directions[:, 2])[:, None] * directions
    right = rig.project(points)[1]
    with np.errstate(invalid="ignore"):
        inside = ((right >= 0) & (right <= [rig.right.width - 1, rig.right.height - 1])).all(axis=1)
    middle = rig.project(np.array([[0.0, 0.0, z_m]]))
    return float(inside.mean()), float(middle[0][0, 0] - middle[1][0, 0])


def _spot(rig: Rig, distance_m: float) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
    """Where the beam is seen at this length, in both images."""
    if rig.laser is None:
        return None, None
    point = (rig.laser.origin_m + distance_m * rig.laser.direction)[None]
    out: list[tuple[float, float] | None] = []
    for q_px, camera in zip(rig.project(point), (rig.left, rig.right), strict=True):
        u, v = (float(value) for value in q_px[0])
        out.append((u, v) if 0 <= u <= camera.width - 1 and 0 <= v <= camera.height - 1 else None)
    return out[0], out[1]


def _whole(rig: Rig, box: tuple[float, float, float, float]) -> bool:
    x, y, width, height = box
    return x > 0 and y > 0 and x + width < rig.left.width and y + height < rig.left.height


def _fills(rig: Rig, box: tuple[float, float, float, float]) -> bool:
    return box[2] >= FILLS * rig.left.width or box[3] >= FILLS * rig.left.height


def _first(holds: Callable[[float], bool]) -> float | None:
    return next((z for z in FINE_M if holds(z)), None)


def _last(holds: Callable[[float], bool]) -> float | None:
    return next((z for z in reversed(FINE_M) if holds(z)), None)


def _span(holds: Callable[[float], bool]) -> Span | None:
    """The nearest and the farthest distance at which it holds."""
    first, last = _first(holds), _last(holds)
    return None if first is None or last is None else (first, last)
