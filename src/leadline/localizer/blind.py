"""When nothing is seen: where a target may be beside the line of sight, and what a beam's length then says of it.

**Held.** A filter alone would let an unseen target drift sideways for ever, ever faster. A vehicle at work holds its
station and its heading: what was last seen stays within `wander_m`, a little more with every second (`drift_m_s`), and
a ball that the beam still hits within its own radius. This bound enters the filter as a measurement of the sideways
place, just strong enough that its sigma does not grow beyond the bound, however often it is applied.

**Aside.** The beam's length depends on how far beside the target's middle the beam hits. Readings alone cannot tell
that from a change of the distance: so they move the distance only, and what the sideways place may make of it is added
to the stated variance as an error that all of them have in common (S. F. Schmidt 1966: a "considered" state).
"""

from __future__ import annotations

import numpy as np

from leadline.config import StatusConfig
from leadline.estimation import Estimate
from leadline.geometry import Beam
from leadline.geometry.arrays import across
from leadline.samples import NS_PER_S, Array, Kind, Measurement
from leadline.target import Cylinder, Sphere, Target

NODES = np.stack(np.meshgrid(*[np.linspace(-2.5, 2.5, 7)] * 2), axis=-1).reshape(-1, 2)  # in sigmas
WEIGHTS = np.exp(-0.5 * (NODES**2).sum(axis=1))
LEAST_HIT = 0.02  # of the uncertain places: where fewer are hit, the reading is of something else
STEEPEST = 1.5  # nearer to the limb a gradient says nothing of the ball as a whole


def held(before: Estimate, last_seen: Estimate, target: Target, config: StatusConfig) -> Measurement | None:
    """The bound on the sideways place, by what was last seen; None while the filter is more certain than that."""
    blind_s = (before.t_ns - last_seen.t_ns) / NS_PER_S
    bound_m = config.wander_m + config.drift_m_s * max(blind_s, 0.0)
    if isinstance(target, Sphere):
        bound_m = min(bound_m, target.radius_m(before.x) / 2)  # the middle of a disc, evenly lit by chance
    place, expected = before.x[:3], last_seen.x[:3]
    if not isinstance(target, Sphere | Cylinder):  # of a wall the direction stays, not the place
        expected = expected * (np.linalg.norm(place) / np.linalg.norm(expected))
    sides = across(place)
    values, vectors = np.linalg.eigh(sides @ before.cov[:3, :3] @ sides.T)
    loose = values > bound_m**2
    if not loose.any():
        return None
    axes = vectors.T[loose] @ sides
    H = np.hstack([axes, np.zeros((len(axes), len(before.x) - 3))])
    cov = np.diag(1 / (1 / bound_m**2 - 1 / values[loose]))
    return Measurement(Kind.HELD, before.t_ns, axes @ expected, cov, lambda x: (H @ x, H))


class Aside:
    """A beam that meets a target which is not seen: its length in the middle of where the target may be hit."""

    def __init__(self, target: Target, beam: Beam, believed: Estimate) -> None:
        self._target, self._beam = target, beam
        sides = across(beam.direction)
        values, vectors = np.linalg.eigh(sides @ believed.cov[:3, :3] @ sides.T)
        u = np.concatenate([beam.direction, np.zeros(len(believed.x) - 3)])
        fixed = np.linalg.solve(believed.cov + 1e-12 * np.eye(len(u)), u)
        self._along = fixed / (u @ fixed)  # P times this is parallel to u
        offsets = NODES @ ((vectors * np.sqrt(np.maximum(values, 0.0))).T @ sides)
        lengths = self._lengths(believed.x, offsets)
        hit = np.isfinite(lengths)
        self.variance_m2 = 0.0
        self.is_hit = bool(WEIGHTS[hit].sum() > LEAST_HIT * WEIGHTS.sum())
        if self.is_hit:
            middle = int(np.argmax(np.where(hit, WEIGHTS, 0.0)))
            self._offset = offsets[middle]
            self.variance_m2 = float(np.average((lengths[hit] - lengths[middle]) ** 2, weights=WEIGHTS[hit]))

    def length(self, x: Array) -> tuple[float, Array]:
        """Length (NaN: missed all the same) and the gradient (3 + k,) by which a filter moves x along the beam."""
        length, gradient = self._at(x, np.zeros(3))
        if not np.isfinite(length):  # it was hit all the same; later, when the place is better known, it is hit anyway
            length, gradient = self._at(x, self._offset)
        if np.linalg.norm(gradient[:3]) > STEEPEST:  # it says more about the limb than about the distance
            return np.nan, gradient
        return length, float(gradient[:3] @ self._beam.direction) * self._along

    def _lengths(self, x: Array, offsets_m: Array) -> Array:
        """To the target (N,), were it moved by each of the offsets (N, 3)."""
        if not isinstance(self._target, Sphere):
            return np.array([self._at(x, offset_m)[0] for offset_m in offsets_m])
        origins = self._beam.origin_m - offsets_m  # a ball does not turn: as well the beam may move, and all at once
        return self._target.beam_length(x, origins, np.broadcast_to(self._beam.direction, origins.shape))[0]

    def _at(self, x: Array, offset_m: Array) -> tuple[float, Array]:
        moved = x.copy()
        moved[:3] += offset_m
        length, gradient = self._target.beam_length(moved, self._beam.origin_m[None], self._beam.direction[None])
        return float(length[0]), gradient[0]
