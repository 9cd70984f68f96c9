"""Where in the left image a ball must be by the filter's state, before the picture is looked at."""

from __future__ import annotations

from math import hypot, sqrt

import numpy as np

from leadline.estimation import Estimate
from leadline.geometry.arrays import across
from leadline.recognition.track import Expected
from leadline.rig import Rig
from leadline.samples import Array
from leadline.target import Sphere, Target

ANGLES = np.linspace(0, 2 * np.pi, 24, endpoint=False)
RINGS = np.array([1.0, 0.6, 0.3])  # of the limb's angle: of a ball at hand the limb is beyond the lens's field


def expected(rig: Rig, target: Target, estimate: Estimate) -> Expected | None:
    """A ball's outline through the port, cut to the image as a detection is; None for other shapes, which have none."""
    if not isinstance(target, Sphere):
        return None
    points_m = np.vstack([estimate.x[:3], _front(target, estimate.x)])
    pixels, jacobians = rig.project_with_jacobian(points_m)
    outline = pixels[1:][np.isfinite(pixels[1:]).all(axis=1)]
    if len(outline) == 0:
        return None
    last = np.array([rig.left.width, rig.left.height]) - 0.5
    low, high = np.clip([outline.min(axis=0), outline.max(axis=0)], -0.5, last)
    seen = jacobians[np.isfinite(jacobians).all(axis=(1, 2))][0]  # the middle's, where that is in the lens's field
    (uu, uv), (_, vv) = (seen @ estimate.cov[:3, :3] @ seen.T).tolist()
    spread = (uu + vv) / 2 + hypot((uu - vv) / 2, uv)  # the larger eigenvalue
    (x, y), (width, height) = low.tolist(), (high - low).tolist()
    return Expected((x, y, width, height), sqrt(max(spread, 0.0)))


def _front(target: Sphere, x: Array) -> Array:
    """Points (72, 3) of the ball's face, the first 24 where rays from the left pupil would touch it without a port."""
    distance = float(np.linalg.norm(x[:3]))
    sight, limb = x[:3] / distance, np.arccos(min(target.radius_m(x) / distance, 0.98))
    angle = (limb * RINGS)[:, None, None]
    around = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1) @ across(sight)
    outward = np.sin(angle) * around - np.cos(angle) * sight
    return np.asarray(x[:3] + target.radius_m(x) * outward.reshape(-1, 3))
