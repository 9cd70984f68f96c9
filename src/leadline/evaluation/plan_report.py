"""A whole plan: tables, hand-overs, advice, and in words what it rests on."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from leadline.config import Config
from leadline.evaluation.plan import AIMED, DISTANCES_M, Cell, Rehearsal, aimed, table
from leadline.evaluation.plan_advice import Gain, measured, ranked
from leadline.evaluation.plan_rig import with_expected_calibration
from leadline.evaluation.plan_sight import SURFACE_RADIUS_M, Conditions, vector_at
from leadline.evaluation.plan_view import FINE_M, HandOvers, View, hand_overs, views
from leadline.rig import Rig
from leadline.samples import Array, Kind
from leadline.target import Cylinder, Sphere, Surface, Target

BOARDS = 25
MINOR = 0.97  # a change that leaves more than this of a sigma is not worth a sentence


@dataclass(frozen=True, slots=True)
class Plan:
    """``cells`` with all that the rig has; ``without_laser`` at the place that the pilot aims at; ``gains`` ranked."""

    name: str
    target: str
    cells: list[Cell]
    without_laser: list[Cell]
    views: list[View]
    hand_overs: HandOvers
    gains: list[Gain]
    assumptions: list[str]

    def aimed(self) -> list[Cell]:
        return [cell for cell in self.cells if cell.place == AIMED]

    def advice(self) -> list[Gain]:
        return [gain for gain in self.gains if gain.after_m < MINOR * gain.before_m]

    def plain(self) -> dict[str, Any]:
        """For JSON."""
        return dataclasses.asdict(self) | {"advice": [str(gain) for gain in self.advice()]}


def make_plan(
    rig: Rig, name: str, target: Target, conditions: Conditions, config: Config, boards: int, at_m: float
) -> Plan:
    """``boards``: of the calibration that a rig without a covariance is taken to have. ValueError: it cannot be had."""
    stated = bool(rig.covariance.names)

    def calibrated(changed: Rig, more: float) -> Rig:
        return measured(changed, more) if stated else with_expected_calibration(changed, round(more * boards))

    rehearsal = Rehearsal(rig if stated else calibrated(rig, 1.0), target, conditions, config)
    cells = table(rehearsal)
    if not any(cell.each for cell in cells):
        raise ValueError(f"nothing can be measured of the target from {DISTANCES_M[0]:g} to {DISTANCES_M[-1]:g} m")
    bare = rehearsal.without_laser()
    ways = [aimed(rehearsal.rig, cell.distance_m) for cell in cells if cell.place == AIMED]
    return Plan(
        name=name,
        target=target.name,
        cells=cells,
        without_laser=[bare.cell(nearest) for nearest in ways] if rig.laser is not None else [],
        views=views(rig, DISTANCES_M),
        hand_overs=hand_overs(rehearsal),
        gains=ranked(rehearsal, at_m, calibrated),
        assumptions=list(_assumptions(rehearsal, stated, boards, at_m)),
    )


def _assumptions(rehearsal: Rehearsal, stated: bool, boards: int, at_m: float) -> Iterator[str]:
    rig, target, c, config = rehearsal.rig, rehearsal.target, rehearsal.conditions, rehearsal.config
    if isinstance(target, Sphere | Cylinder) and target.diameter_m is None:
        yield f"target of unknown size, taken to be {2 * target.radius_m(vector_of(target)):.2f} m across"
    if isinstance(target, Surface):
        yield f"surface: a flat piece {2 * SURFACE_RADIUS_M:g} m across; a curved one is worse by what a quadric misses"
    yield (
        f"pictures: noise {c.noise_grey:g} grey levels a pixel; texture {c.texture_grey_px:g} grey levels a pixel from "
        f"close by, falling by exp(-{c.attenuation_per_m:g} d); two views of a patch unlike by "
        f"{c.unlike_px_per_rad:g} px a radian between them; spot's centre good to {c.spot_px:g} px in one image"
    )
    yield (
        f"filtered: a still target after {c.seconds:g} s at {c.frames_hz:g} frames and {c.readings_hz:g} readings a "
        "second; what moves is worse by what the filter's settings allow"
    )
    if stated:
        yield "calibration: as the rig file states it"
    elif boards:
        yield f"calibration: the rig states none; {boards} boards in air and as many in water are taken for granted"
    else:
        yield "calibration: taken to be exact"
    bias_m = at_m**2 * config.status.bias_px / (rig.focal_outside_px * rig.baseline_m)
    yield (
        f"no averaging removes: matching bias of {config.status.bias_px:g} px, {1e3 * bias_m:.2g} mm at {at_m:g} m; "
        f"outline bias of {config.outline.bias_sigma_px:g} px (the outline is no better than that); a surface that is "
        f"{1e3 * config.stereo.roughness_m:g} mm rough (which limits stereo from close by)"
    )


def vector_of(target: Target) -> Array:
    """The target's vector a metre ahead."""
    return vector_at(target, np.array([0.0, 0.0, 1.0]))


def lines(plan: Plan) -> Iterator[str]:
    """The view, the hand-overs and the advice in words."""
    h = plan.hand_overs
    yield f"both cameras see the same from {_m(h.both_from_m)} on"
    near, far = plan.views[0], plan.views[-1]
    yield (
        f"overlap {near.overlap:.0%} of the image at {near.distance_m:g} m, {far.overlap:.0%} at {far.distance_m:g} m; "
        f"disparity {near.disparity_px:.0f} to {far.disparity_px:.0f} px"
    )
    if h.fills_until_m is not None:
        yield f"the target fills the view up to {_m(h.fills_until_m)}" + (
            f", is wholly in both images from {_m(h.whole_from_m)} on" if h.whole_from_m is not None else ""
        )
    for kind, (first, last) in h.spans_m.items():
        yield f"{KINDS[kind]}: from {_m(first)} to {_m(last)}"
    if h.spot_left_m is not None and h.spot_right_m is not None:
        yield (
            f"nearer than {_m(h.spot_left_m[0])} the spot leaves the left image, nearer than {_m(h.spot_right_m[0])} "
            f"the right one; it is larger than a pixel up to {_m(h.spot_resolved_until_m)}"
        )
    yield from (str(gain) for gain in plan.advice())


KINDS = {
    Kind.STEREO.value: "stereo on the target",
    Kind.SPOT.value: "the laser's spot",
    Kind.LASER.value: "the laser meets the target",
    Kind.SIZE.value: "the outline",
}


def _m(value: float | None) -> str:
    if value is None:
        return "nowhere"
    return f"{value:.2f} m" if value < FINE_M[-1] else f"{value:.0f} m and more"
