"""The paper's camera model: an ordinary stereo pair calibrated in water, then one effective focal length f' an axis.

No refraction is traced here: that is the point of the comparison. The rig's port is used only to play the pool in which
the paper measures its laser points (eq. 12), and in ``Rig.fit_pinhole_water`` to play its checkerboards.
"""

from __future__ import annotations

import cv2
import numpy as np

from leadline.geometry import Camera
from leadline.rig import Rig
from leadline.samples import Array, Image

FOCAL_DISTANCES_M = tuple(np.arange(10, 23) / 10)  # every 0.1 m over 1.0-2.2 m (section 4.1)
LEAST_OFFSET_M = 0.01  # eq. 12 divides by X and by Y: a spot on the axis says nothing about its focal length


class PinholePair:
    """Rectified in-water pinholes. ``fx_px, fy_px`` are the paper's f' in pixels of the rectified image."""

    def __init__(self, rig: Rig) -> None:
        left, right = rig.pinhole_water or rig.fit_pinhole_water()
        self._left, self.baseline_m = left, rig.baseline_m
        rotations = cv2.stereoRectify(
            left.matrix, _distortion(left), right.matrix, _distortion(right), (left.width, left.height),
            rig.T_right_left.R, rig.T_right_left.t_m.reshape(3, 1),
        )[:2]  # fmt: skip
        self.R_rectified_left = np.asarray(rotations[0], dtype=np.float64)
        # Both rectified images get the left in-water pinhole's matrix, so that f' of the left image holds in them.
        self._maps = [_maps(camera, R, left.matrix) for camera, R in zip((left, right), rotations, strict=True)]
        self.cx_px, self.cy_px = left.cx, left.cy
        self.fx_px, self.fy_px = rig.virtual_focal_px or self._virtual_focal_px(rig)

    def rectify(self, left: Image, right: Image) -> tuple[Image, Image]:
        """Raw images (H, W[, 3]) -> rectified grey ones (H, W), in which a point lies on the same row."""
        images = (_grey(left), _grey(right))
        grey = [cv2.remap(image, *maps, cv2.INTER_LINEAR) for image, maps in zip(images, self._maps, strict=True)]
        return grey[0], grey[1]  # type: ignore[return-value]  # OpenCV's stubs do not carry the dtype through

    def rectified_px(self, raw_px: Array) -> Array:
        """A raw left pixel (2,) -> its place in the rectified left image (2,)."""
        left = self._left
        there = cv2.undistortPoints(
            np.asarray(raw_px, dtype=np.float64).reshape(1, 1, 2), left.matrix, _distortion(left),
            R=self.R_rectified_left, P=left.matrix,
        )  # fmt: skip
        return np.asarray(there, dtype=np.float64).reshape(2)

    def disparity_px(self, depth_m: float) -> float:
        """Eq. 10 turned round."""
        return self.fx_px * self.baseline_m / depth_m

    def point_m(self, u_px: float, v_px: float, disparity_px: float) -> Array:
        """Eq. 10 and 19: rectified left pixel and disparity -> the point (3,), left camera's frame."""
        depth = self.fx_px * self.baseline_m / disparity_px
        x, y = depth * (u_px - self.cx_px) / self.fx_px, depth * (v_px - self.cy_px) / self.fy_px
        point: Array = self.R_rectified_left.T @ np.array([x, y, depth])
        return point

    def _virtual_focal_px(self, rig: Rig) -> tuple[float, float]:
        """Eq. 11-12: the mean over the stations of (Z / X)(u - cx) and (Z / Y)(v - cy) of the laser point in water.

        The in-water pinhole's own focal length where there is no laser, or no refraction to correct.
        """
        focal = (self._left.fx, self._left.fy)
        if rig.laser is None or rig.port is None:
            return focal
        origin, direction = rig.laser.origin_m, rig.laser.direction
        lengths = (np.array(FOCAL_DISTANCES_M) - origin[2]) / direction[2]
        points = origin + lengths[:, None] * direction  # eq. 14
        pixels = np.array([self.rectified_px(q_px) for q_px in rig.project(points)[0]])
        offsets = pixels - [self.cx_px, self.cy_px]
        points = points @ self.R_rectified_left.T
        means = [_mean_focal(points[:, 2], points[:, axis], offsets[:, axis]) for axis in (0, 1)]
        return means[0] or focal[0], means[1] or focal[1]


def _mean_focal(depth_m: Array, across_m: Array, offset_px: Array) -> float | None:
    known = np.isfinite(offset_px) & (np.abs(across_m) > LEAST_OFFSET_M)
    return float(np.mean(depth_m[known] / across_m[known] * offset_px[known])) if known.any() else None


def _distortion(camera: Camera) -> Array:
    return np.array(camera.distortion or (0.0,) * 4)


def _maps(camera: Camera, R: cv2.typing.MatLike, K: Array) -> tuple[cv2.typing.MatLike, cv2.typing.MatLike]:
    size = (camera.width, camera.height)
    return cv2.initUndistortRectifyMap(camera.matrix, _distortion(camera), R, K, size, cv2.CV_16SC2)


def _grey(image: Image) -> cv2.typing.MatLike:
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
