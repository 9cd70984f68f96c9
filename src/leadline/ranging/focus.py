"""Where in a wide view the target is: by its texture before it is found, by its silhouette afterwards."""

from __future__ import annotations

import cv2
import numpy as np

from leadline.ranging.coarse import Box
from leadline.ranging.shape_fit import Points
from leadline.rig import Rig
from leadline.samples import Array, Image
from leadline.target import Cylinder, Target

SIDE_PX = 160  # the box is looked at in about this size
WINDOW_PX = 13
FAINT = 0.15  # of the strongest texture: water, and what lies far behind it
GRID = 24  # rays along the longer side of a box
LEAST_PX = 8.0
LOPSIDED = 0.3  # of half the silhouette's width


def textured(rig: Rig, left: Image, box: Box, points: Points) -> Points:
    """The points on what stands out from open water: those around which the left image has texture."""
    x, y = (max(int(v), 0) for v in box[:2])
    part = left[y : int(box[1] + box[3]), x : int(box[0] + box[2])]
    scale = SIDE_PX / max(part.shape[:2])
    small = cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    flat = (small if small.ndim == 2 else cv2.cvtColor(small, cv2.COLOR_BGR2GRAY)).astype(np.float32)
    across, down = (cv2.Sobel(flat, cv2.CV_32F, *axis, ksize=1) for axis in ((1, 0), (0, 1)))
    texture = cv2.boxFilter(across**2 + down**2, -1, (WINDOW_PX, WINDOW_PX))
    q_px = (rig.project_one(points.p_m, "left") - [x, y]) * scale
    column, row = np.clip(np.round(q_px), 0, np.array(texture.shape[::-1]) - 1).astype(int).T
    strength = texture[row, column]
    return points.pick(np.asarray(strength > FAINT * np.percentile(strength, 95)))


def narrowed(rig: Rig, target: Target, x: Array, box: Box) -> Box:
    """The part of a box in which the left camera sees a shape, to within a step of a grid; the box, if in none."""
    q_px, _, step = _silhouette(rig, target, x, box)
    if not len(q_px):
        return box
    low, high = np.array(box[:2]), np.array(box[:2]) + box[2:]
    first, last = np.maximum(q_px.min(axis=0) - step, low), np.minimum(q_px.max(axis=0) + step, high)
    width, height = np.maximum(last - first, LEAST_PX)
    return float(first[0]), float(first[1]), float(width), float(height)


def lopsided(rig: Rig, target: Cylinder, x: Array, box: Box, points: Points) -> bool:
    """Whether a pile's points all lie on one side of what both cameras should see of it.

    Too few of them, or too poor, fit a pile that stands beside its own texture as well, and as if it were certain.
    """
    _, p_m, _ = _silhouette(rig, target, x, box)
    right_px = rig.project_one(p_m, "right")
    p_m = p_m[((right_px > 0) & (right_px < [rig.right.width, rig.right.height])).all(axis=1)]
    if not len(p_m):
        return True
    across = np.cross(target.axis(x), x[:3] / np.linalg.norm(x[:3]))
    of_all, of_points = ((p @ across) / p[:, 2] for p in (p_m, points.p_m))
    return bool(abs(of_points.mean() - of_all.mean()) > LOPSIDED * np.ptp(of_all) / 2)


def _silhouette(rig: Rig, target: Target, x: Array, box: Box) -> tuple[Array, Array, float]:
    """Pixels (N, 2) of a grid over the box whose rays meet a shape, where they do (N, 3), and the grid's step."""
    size = np.array(box[2:])
    step = float(max(size)) / GRID
    lines = [box[i] + step * (np.arange(max(int(size[i] / step), 1)) + 0.5) for i in range(2)]
    q_px = np.stack(np.meshgrid(*lines), axis=-1).reshape(-1, 2)
    origins, directions = rig.rays(q_px, "left")
    length = target.beam_length(x, origins, directions)[0]
    met = np.isfinite(length)
    return q_px[met], origins[met] + length[met, None] * directions[met], step
