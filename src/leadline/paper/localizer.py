"""The three stages of the paper and their switching (its Fig. 10). Every choice it leaves open is in PaperConfig."""

from __future__ import annotations

import numpy as np

from leadline.config import Config
from leadline.paper.matching import NEIGHBOURS, match_block, smooth
from leadline.paper.pinhole_pair import PinholePair
from leadline.paper.spot import find_spots
from leadline.recognition.finder import Finder
from leadline.rig import Rig
from leadline.samples import (
    NS_PER_S,
    Array,
    Detection,
    Image,
    Kind,
    LaserRange,
    Rejected,
    Sample,
    Solution,
    Stage,
    Status,
    StereoFrame,
)
from leadline.target import Target


class PaperLocalizer:
    """``step(sample)`` gives one solution for every stereo frame, and another when a reading of the same instant comes
    after it. No refraction, no sub-pixel step, no memory but the last frame and reading: ``position_m`` is the paper's
    point (left camera's frame), ``range_m`` its distance D.

    Built like ``Localizer``; the target's shape is of no use to it. Without a detector the image itself is the box.
    """

    def __init__(
        self, rig: Rig, target: Target | None = None, detector: Finder | None = None, config: Config | None = None
    ) -> None:
        self._rig, self._config = rig, (config or Config()).paper
        self._finder = detector
        self._pair = PinholePair(rig)
        self._reading: LaserRange | None = None
        self._frame: StereoFrame | None = None
        self._seen = detector is None
        self.detections: list[Detection] = []  # of the last frame, for those who draw
        self.notices: list[str] = []  # it compares nothing, and so has nothing to say

    def step(self, sample: Sample) -> Solution | None:
        if isinstance(sample, LaserRange):
            if np.isfinite(sample.range_m) and sample.range_m > 0:
                self._reading = sample
                if self._seen and self._frame is not None and self._frame.t_ns == sample.t_ns:
                    return self._locate(self._frame)
            return None
        if not isinstance(sample, StereoFrame):
            return None
        self._frame = sample
        self.detections = [] if self._finder is None else self._finder.find(sample)
        self._seen = self._seen or bool(self.detections)
        if not self._seen:
            return Solution(sample.t_ns, Stage.SEARCHING, Status.LOST)
        return self._locate(sample)

    def _locate(self, frame: StereoFrame) -> Solution:
        left, right = self._pair.rectify(frame.left, frame.right)
        laser_m = self._laser_point_m(frame)
        spot_m = None if laser_m is None else self._spot_point_m(left, right)
        fills = self._fills(frame)
        if laser_m is not None and spot_m is not None and not fills:
            return self._both(frame, spot_m, laser_m)
        if laser_m is not None and (fills or not self.detections):
            return self._laser_alone(frame, laser_m)
        centre_m = self._centre_point_m(frame, left, right)
        if centre_m is not None:
            return self._binocular(frame, centre_m)
        if laser_m is not None:
            return self._laser_alone(frame, laser_m)
        turned_away = (Rejected(Kind.STEREO, frame.t_ns, "no match"),)
        return Solution(frame.t_ns, Stage.SEARCHING, Status.LOST, rejected=turned_away)

    # The stages

    def _binocular(self, frame: StereoFrame, centre_m: Array) -> Solution:
        """Eq. 20: D1 = |P|."""
        sigma = self._stereo_sigma_m(centre_m, self._config.disparity_sigma_px)
        return self._solution(frame, Stage.BINOCULAR, centre_m, sigma, (Kind.STEREO,))

    def _both(self, frame: StereoFrame, spot_m: Array, laser_m: Array) -> Solution:
        """Eq. 21-25: D2 = D21 + k (D22 - D21), put on the line of sight of the fused point."""
        # Two spot centres are rounded to whole pixels, a block match is rounded once.
        sigma_1 = self._stereo_sigma_m(spot_m, np.sqrt(2) * self._config.disparity_sigma_px)
        k, sigma = fuse(sigma_1, self._config.laser_sigma_m)
        stereo_m, beam_m = float(np.linalg.norm(spot_m)), float(np.linalg.norm(laser_m))
        between = spot_m + k * (laser_m - spot_m)
        point = between / np.linalg.norm(between) * (stereo_m + k * (beam_m - stereo_m))
        return self._solution(frame, Stage.BOTH, point, sigma, (Kind.SPOT, Kind.LASER))

    def _laser_alone(self, frame: StereoFrame, laser_m: Array) -> Solution:
        """Eq. 26: D3 = |L d + t|."""
        return self._solution(frame, Stage.LASER, laser_m, self._config.laser_sigma_m, (Kind.LASER,))

    # What they are made of

    def _centre_point_m(self, frame: StereoFrame, left: Image, right: Image) -> Array | None:
        """The point of median distance among the box centre and its four neighbours (section 3.3.2, first stage)."""
        u, v = (round(float(value)) for value in self._pair.rectified_px(self._centre_px(frame)))
        left, right = (smooth(image, self._config.smooth_px) for image in (left, right))
        points = [self._matched_m(left, right, (u + du, v + dv)) for du, dv in NEIGHBOURS]
        known = sorted((point for point in points if point is not None), key=lambda p: float(np.linalg.norm(p)))
        return known[len(known) // 2] if len(known) > len(points) // 2 else None

    def _matched_m(self, left: Image, right: Image, pixel: tuple[int, int]) -> Array | None:
        c = self._config
        span = int(self._pair.disparity_px(c.farthest_m)), int(np.ceil(self._pair.disparity_px(c.nearest_m)))
        span = max(span[0], 1), span[1]
        disparity = match_block(left, right, pixel, block_px=c.block_px, span_px=span, least_score=c.least_score)
        return None if disparity is None else self._pair.point_m(*pixel, disparity)

    def _spot_point_m(self, left: Image, right: Image) -> Array | None:
        """Stereo at the spot: its whole-pixel centres, the brightest in the target's box and its like in the right."""
        c = self._config
        spots = [find_spots(image, c.spot_grey, c.spot_circularity, c.spot_area_px) for image in (left, right)]
        spot = next((q_px for q_px in spots[0] if self._in_box(q_px)), None)
        if spot is None:
            return None
        near, far = self._pair.disparity_px(c.nearest_m), self._pair.disparity_px(c.farthest_m)
        for u_right, v_right in spots[1]:
            if abs(spot[1] - v_right) <= c.spot_rows_px and far <= spot[0] - u_right <= near:
                return self._pair.point_m(*spot, spot[0] - u_right)
        return None

    def _in_box(self, q_px: tuple[int, int]) -> bool:
        """Whether a rectified left pixel lies in the target's box (rectified by its corners); true without a box."""
        if not self.detections:
            return True
        x, y, width, height = self.detections[0].box_px
        low, high = (self._pair.rectified_px(np.array(p)) for p in ((x, y), (x + width, y + height)))
        return bool((low <= q_px).all() and (q_px <= high).all())

    def _laser_point_m(self, frame: StereoFrame) -> Array | None:
        """Eq. 14 with the corrected length; None where the laser does not work (no reading is near the frame)."""
        hold_ns = self._config.laser_hold_s * NS_PER_S
        if self._rig.laser is None or self._reading is None or abs(frame.t_ns - self._reading.t_ns) > hold_ns:
            return None
        return self._rig.laser.point_m(self._reading.range_m)

    def _centre_px(self, frame: StereoFrame) -> Array:
        height, width = frame.left.shape[:2]
        x, y, w, h = self.detections[0].box_px if self.detections else (-0.5, -0.5, width, height)
        return np.array([x + w / 2, y + h / 2])

    def _fills(self, frame: StereoFrame) -> bool:
        """Whether the target fills the view, so that there is nothing left to match: the third stage."""
        if not self.detections:
            return False
        height, width = frame.left.shape[:2]
        _, _, box_width, box_height = self.detections[0].box_px
        return bool(max(box_width / width, box_height / height) >= self._config.fills_view)

    def _stereo_sigma_m(self, point_m: Array, sigma_px: float) -> float:
        """Our sigma_1: eq. 10 differentiated, Z^2 / (f' b) of a metre for a pixel, along the line of sight."""
        depth = float((self._pair.R_rectified_left @ point_m)[2])
        return depth / self._pair.disparity_px(depth) * sigma_px * float(np.linalg.norm(point_m)) / depth

    def _solution(
        self, frame: StereoFrame, stage: Stage, point_m: Array, sigma_m: float, used: tuple[Kind, ...]
    ) -> Solution:
        """sigma: along the line of sight; across it stands a pixel's rounding."""
        distance = float(np.linalg.norm(point_m))
        sight = point_m / distance
        across = distance / self._pair.fx_px * self._config.disparity_sigma_px
        along = np.outer(sight, sight)
        cov = sigma_m**2 * along + across**2 * (np.eye(3) - along)
        return Solution(frame.t_ns, stage, Status.VALID, point_m, cov, distance, sigma_m, used=used)


def fuse(sigma_1: float, sigma_2: float) -> tuple[float, float]:
    """Eq. 24 and 23: the gain k of the laser's distance and the fused standard deviation."""
    k = sigma_1**2 / (sigma_1**2 + sigma_2**2)
    return k, float(np.sqrt((1 - k) ** 2 * sigma_1**2 + k**2 * sigma_2**2))
