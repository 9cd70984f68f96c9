"""Approaches to a ball with errors drawn as they are stated: no pictures, but all that a picture would be measured as.

The localizer believes a rig with a covariance; the true one is drawn from it for every approach, and so are the errors
that all frames share (matching, outline) and the noise of each frame. The true rig projects patches, outline and spot
to pixels and takes the laser's readings; the localizer's own fits, with the believed rig, make measurements of them.
"""

from __future__ import annotations

import copy
import dataclasses
from functools import cache

import numpy as np

from leadline.config import Config
from leadline.evaluation.plan_rig import with_expected_calibration
from leadline.evaluation.plan_sight import Conditions, box_of, expected_points
from leadline.localizer import Localizer
from leadline.localizer.sight import Found, Sight
from leadline.ranging.outline import SIDES, OutlineRanger, _Edges
from leadline.ranging.shape_fit import fit
from leadline.rig import Rig
from leadline.rig_parameters import get, replaced
from leadline.samples import NS_PER_S, Array, Detection, Kind, LaserRange, Measurement, StereoFrame
from leadline.target import Sphere

BALL = Sphere(0.34)
CONDITIONS = Conditions()
CONFIG = Config()
CONFIG = CONFIG.model_copy(update={"stereo": CONFIG.stereo.model_copy(update={"roughness_m": 0.0})})
RATE_HZ = 10.0
NO_IMAGE = np.zeros((1, 1), np.uint8)


@cache
def believed_rig() -> Rig:
    """The paper's at 640 x 360, as 25 + 25 boards would calibrate it."""
    return with_expected_calibration(Rig.load("paper").scaled(1 / 3), 25)


@cache
def prototype(*, exact: bool = False) -> Localizer:
    """Its tables take long to make. exact: it knows of no error of its rig."""
    rig = dataclasses.replace(believed_rig(), covariance=Rig.load("paper").covariance) if exact else believed_rig()
    return Localizer(rig, BALL, None, CONFIG)


def drawn(rig: Rig, rng: np.random.Generator) -> Rig:
    names = rig.covariance.names
    return replaced(rig, names, get(rig, names) + rig.covariance.root(names) @ rng.standard_normal(len(names)))


class Approach:
    """A way past a distance, beside the beam by a little; what is measured on it is drawn once and kept."""

    def __init__(self, seed: int, distance_m: float, frames: int, speed_m_s: float = 0.15) -> None:
        self._rng = rng = np.random.default_rng((29, seed))
        self.believed, self.true = believed_rig(), drawn(believed_rig(), rng)
        laser = self.true.laser
        assert laser is not None
        nearest = laser.origin_m + distance_m * laser.direction + np.append(rng.uniform(-0.05, 0.05, 2), 0.0)
        self._last = nearest * (1 + BALL.radius_m(nearest) / float(np.linalg.norm(nearest)))
        self._velocity = -speed_m_s * nearest / np.linalg.norm(nearest) + rng.normal(0, 0.01, 3)
        self._bias_px, self._outline = CONFIG.status.bias_px * rng.standard_normal(), rng.standard_normal()
        self.times_ns = [round(i / RATE_HZ * NS_PER_S) for i in range(frames)]
        self.found = {t_ns: self._measure(t_ns) for t_ns in self.times_ns}
        self.readings = {t_ns: self._reading(t_ns) for t_ns in self.times_ns}

    def at(self, t_ns: int) -> Array:
        """The ball's centre (3,)."""
        return np.asarray(self._last - self._velocity * (self.times_ns[-1] - t_ns) / NS_PER_S)

    def box(self, t_ns: int) -> tuple[float, float, float, float]:
        box = box_of(self.true, BALL, self.at(t_ns))
        assert box is not None
        return box

    def _measure(self, t_ns: int) -> list[Measurement]:
        x = self.at(t_ns)
        return [one for one in (self._stereo(t_ns, x), self._size(t_ns, x), self._spot(t_ns, x)) if one is not None]

    def _stereo(self, t_ns: int, x: Array) -> Measurement | None:
        planned = expected_points(self.believed, BALL, CONFIG.stereo, CONDITIONS, x)
        if planned is None:
            return None
        left_px = self.believed.project_one(planned.p_m, "left")
        origins, directions = self.true.rays(left_px, "left")
        lengths = BALL.beam_length(x, origins, directions)[0]
        at_px = self.true.project_one(origins + lengths[:, None] * directions, "right")
        farther_px = self.true.project_one(origins + 1.001 * lengths[:, None] * directions, "right")
        along = (at_px - farther_px) / np.linalg.norm(farther_px - at_px, axis=1)[:, None]
        good = np.asarray(np.isfinite(at_px).all(axis=1))
        p_m, _ = self.believed.triangulate(left_px[good], (at_px + self._bias_px * along)[good])
        seen = planned.pick(good)
        length = np.einsum("ni,ni->n", p_m - seen.origins_m, seen.directions)
        held = fit(BALL, dataclasses.replace(seen, length_m=length), x, 0.0)
        if held is None:
            return None
        noise = np.linalg.cholesky(held.cov) @ self._rng.standard_normal(3)  # as stated, for all that patches share
        return _place(Kind.STEREO, t_ns, held.x + noise, held.cov)

    def _size(self, t_ns: int, x: Array) -> Measurement | None:
        ranger, edges = OutlineRanger(BALL, CONFIG.outline), []
        for i, side in enumerate(SIDES):
            contour, normal, m_per_px = ranger._contour(self.true, x, side)
            off_px = CONFIG.outline.bias_sigma_px * self._outline
            off = off_px + CONFIG.outline.edge_sigma_px * self._rng.standard_normal(len(contour))
            q_px = contour + off[:, None] * normal
            size = np.array([self.true.left.width, self.true.left.height])
            inside = ((q_px > 8) & (q_px < size - 8)).all(axis=1)
            rays = self.believed.rays(q_px[inside], side)
            edges.append(_Edges(*rays, m_per_px[inside], np.full(inside.sum(), i)))
        both = _Edges(*(np.concatenate([getattr(e, name) for e in edges]) for name in _Edges.__slots__))
        held = ranger._fit(both, x)
        if isinstance(held, str):
            return None
        return dataclasses.replace(
            _place(Kind.SIZE, t_ns, held.ball, held.cov), common=held.common, cameras=held.cameras
        )

    def _hit(self, x: Array) -> float:
        laser = self.true.laser
        assert laser is not None
        return float(BALL.beam_length(x, laser.origin_m[None], laser.direction[None])[0][0])

    def _spot(self, t_ns: int, x: Array) -> Measurement | None:
        laser, beam, length = self.true.laser, prototype()._laser, self._hit(x)
        assert laser is not None
        assert beam is not None
        if not np.isfinite(length):
            return None
        cov = CONDITIONS.spot_px**2 * np.eye(2)
        size = np.array([self.true.left.width, self.true.left.height])
        seen = {}
        for side in SIDES:
            q_px = self.true.project_one((laser.origin_m + length * laser.direction)[None], side)[0]
            if ((q_px > 8) & (q_px < size - 8)).all():
                seen[side] = q_px + CONDITIONS.spot_px * self._rng.standard_normal(2), cov
        found = beam._beam.spot(t_ns, seen) if seen else None
        return found if isinstance(found, Measurement) else None

    def _reading(self, t_ns: int) -> LaserRange | None:
        laser, length = self.true.laser, self._hit(self.at(t_ns))
        assert laser is not None
        noise_m = laser.range_sigma_m * float(self._rng.standard_normal())
        return LaserRange(t_ns, laser.raw_m(length) + noise_m) if np.isfinite(length) else None

    def localizer(self, *, exact: bool = False) -> Localizer:
        """A fresh one that sees what was drawn."""
        fresh = copy.deepcopy(prototype(exact=exact))
        fresh._sight = DrawnSight(fresh._sight, self)
        fresh._finder = Boxed(self)
        return fresh

    def frame(self, t_ns: int) -> StereoFrame:
        return StereoFrame(t_ns, NO_IMAGE, NO_IMAGE)


def _place(kind: Kind, t_ns: int, z: Array, cov: Array) -> Measurement:
    eye = np.eye(len(z))
    return Measurement(kind, t_ns, z, cov, lambda x: (x, eye))


class Boxed:
    def __init__(self, approach: Approach) -> None:
        self._approach = approach

    def find(self, frame: StereoFrame) -> list[Detection]:
        return [Detection(self._approach.box(frame.t_ns), 1.0)]

    def __deepcopy__(self, memo: dict[int, object]) -> Boxed:
        return self


class DrawnSight(Sight):
    """In the place of the localizer's eyes."""

    def __init__(self, sight: Sight, approach: Approach) -> None:
        vars(self).update(vars(sight))
        self._approach = approach
        self.allowed: set[Kind] = set(Kind)

    def __deepcopy__(self, memo: dict[int, object]) -> DrawnSight:
        fresh = DrawnSight(self, self._approach)  # what it keeps never changes
        fresh.allowed = set(self.allowed)
        return fresh

    def measure(self, frame: StereoFrame, box: object, before: object, skew: object) -> Found:
        found = [one for one in self._approach.found[frame.t_ns] if one.kind in self.allowed]
        return [one if one.kind is Kind.SPOT else self._honest(one, skew) for one in found]  # type: ignore[arg-type]
