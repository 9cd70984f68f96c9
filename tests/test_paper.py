"""The paper's method: its formulas to the digit, its weaknesses provable, its errors on rendered dives sane."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from leadline.config import Config, PaperConfig
from leadline.evaluation.accuracy import by_stage, compare
from leadline.geometry import Beam, Camera, Pose
from leadline.paper import PaperLocalizer
from leadline.paper.localizer import fuse
from leadline.paper.matching import match_block
from leadline.paper.pinhole_pair import PinholePair
from leadline.paper.spot import find_spots
from leadline.rig import Rig
from leadline.samples import NS_PER_S, Array, Detection, Image, Kind, LaserRange, Solution, Stage, Status, StereoFrame
from leadline.sources import open_source
from leadline.target import Plane, Sphere

FOCAL, BASELINE, WIDTH, HEIGHT = 400.0, 0.063, 640, 360
CAMERA = Camera(FOCAL, FOCAL, 320.0, 180.0, WIDTH, HEIGHT)
AIR = Rig(CAMERA, CAMERA, Pose(np.eye(3), [-BASELINE, 0, 0]), laser=Beam([-0.03, 0.05, 0], [0, 0, 1]))


class Found:
    """The same box in every frame; None: nothing."""

    def __init__(self, box_px: tuple[float, float, float, float] | None = (270.0, 130.0, 100.0, 100.0)) -> None:
        self.box_px = box_px

    def find(self, frame: StereoFrame) -> list[Detection]:
        return [] if self.box_px is None else [Detection(self.box_px, 0.9)]


def texture(seed: int = 0) -> Image:
    noise = np.random.default_rng(seed).uniform(60, 150, (HEIGHT, WIDTH)).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(noise, (0, 0), 1.5) * 3 - 210, dtype=np.uint8)


def pair(disparity_px: float, spot_px: tuple[int, int] | None = None) -> tuple[Image, Image]:
    """A fronto-parallel wall; the right image is the left one shifted, by a fraction too. The spot is 9 px wide."""
    left = texture()
    if spot_px is not None:
        left = np.asarray(cv2.circle(left.copy(), spot_px, 4, 250, -1))
    shift = np.array([[1.0, 0, -disparity_px], [0, 1.0, 0]])
    return left, np.asarray(cv2.warpAffine(left, shift, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC))


def frame(disparity_px: float = 20.0, spot_px: tuple[int, int] | None = None, t_s: float = 1.0) -> StereoFrame:
    return StereoFrame(round(t_s * NS_PER_S), *pair(disparity_px, spot_px))


def reading(range_m: float, t_s: float = 1.0) -> LaserRange:
    return LaserRange(round(t_s * NS_PER_S), range_m)


def solve(localizer: PaperLocalizer, *samples: LaserRange | StereoFrame) -> Solution:
    solutions = [localizer.step(sample) for sample in samples]
    assert solutions[-1] is not None
    return solutions[-1]


def depth(solution: Solution) -> float:
    assert solution.position_m is not None
    return float(solution.position_m[2])


# Equations


def test_gain_and_fused_sigma() -> None:
    """Eq. 24 and 23; the fused sigma is that of two independent measurements."""
    k, sigma = fuse(0.02, 0.01)
    assert k == pytest.approx(0.8)
    assert sigma == pytest.approx((1 / 0.02**2 + 1 / 0.01**2) ** -0.5)


def test_stage_1_is_eq_10_19_20_on_a_whole_disparity() -> None:
    solution = solve(PaperLocalizer(AIR, Sphere(0.34), Found((300.0, 130.0, 100.0, 100.0))), frame(20.0))
    assert (solution.stage, solution.used) == (Stage.BINOCULAR, (Kind.STEREO,))
    z = FOCAL * BASELINE / 20
    assert solution.position_m == pytest.approx([z * 30 / FOCAL, 0, z], abs=z / FOCAL * 1.01)  # a neighbour may win
    assert solution.range_m == pytest.approx(np.linalg.norm(solution.position_m))
    assert solution.range_sigma_m == pytest.approx(z / 20 * 0.29, rel=0.02)


@pytest.mark.parametrize("disparity_px", [12.0, 12.3, 12.45, 12.7, 13.0])
def test_disparities_are_whole(disparity_px: float) -> None:
    """Between two whole disparities the answer stays where it is: no sub-pixel step hides anywhere."""
    solution = solve(PaperLocalizer(AIR, Sphere(0.34), Found()), frame(disparity_px))
    assert FOCAL * BASELINE / depth(solution) == pytest.approx(round(disparity_px), abs=1e-9)


def test_stage_2_is_eq_25_on_the_spots_whole_pixels() -> None:
    spot, disparity = (330, 170), 24
    solution = solve(PaperLocalizer(AIR, Sphere(0.34), Found()), reading(1.0), frame(disparity, spot))
    assert (solution.stage, solution.used) == (Stage.BOTH, (Kind.SPOT, Kind.LASER))
    z = FOCAL * BASELINE / disparity
    d21 = float(np.linalg.norm([z * 10 / FOCAL, -z * 10 / FOCAL, z]))
    d22 = float(np.linalg.norm([-0.03, 0.05, 1.0]))
    sigma_1 = d21 / disparity * np.sqrt(2) * 0.29
    k = sigma_1**2 / (sigma_1**2 + 0.003**2)
    assert solution.range_m == pytest.approx(d21 + k * (d22 - d21), abs=1e-9)
    assert solution.range_sigma_m == pytest.approx(fuse(sigma_1, 0.003)[1], abs=1e-9)


def test_stage_3_is_eq_26_when_the_target_fills_the_view() -> None:
    close = Found((50.0, -0.5, 500.0, 360.0))
    solution = solve(PaperLocalizer(AIR, Sphere(0.34), close), reading(0.4), frame(20.0))
    assert (solution.stage, solution.used) == (Stage.LASER, (Kind.LASER,))
    assert solution.position_m == pytest.approx([-0.03, 0.05, 0.4])
    assert solution.range_sigma_m == 0.003


def test_the_reading_is_corrected_until_it_ranges_right() -> None:
    rig = replace(AIR, laser=Beam([0, 0, 0], [0, 0, 1], 1.004, 0.012, 1.35))
    close = Found((50.0, -0.5, 500.0, 360.0))
    assert depth(solve(PaperLocalizer(rig, Sphere(), close), reading(1.004 * 1.35 * 0.5 + 0.012), frame())) == (
        pytest.approx(0.5)
    )


# Switching


def test_stage_3_when_the_stereo_range_fails_and_lost_without_laser() -> None:
    flat = np.full((HEIGHT, WIDTH), 90, np.uint8)
    blank = StereoFrame(NS_PER_S, flat, flat)
    assert solve(PaperLocalizer(AIR, Sphere(), Found()), reading(0.8), blank).stage is Stage.LASER
    lost = solve(PaperLocalizer(AIR, Sphere(), Found()), blank)
    assert (lost.status, lost.position_m) == (Status.LOST, None)
    assert lost.rejected[0].kind is Kind.STEREO


def test_without_a_target_there_is_nothing_until_it_was_seen_once() -> None:
    finder = Found(None)
    localizer = PaperLocalizer(AIR, Sphere(), finder)
    assert solve(localizer, reading(1.0), frame(20.0, (330, 170))).stage is Stage.SEARCHING
    finder.box_px = (270.0, 130.0, 100.0, 100.0)
    assert solve(localizer, frame(20.0)).stage is Stage.BINOCULAR
    finder.box_px = None  # the detector fails close to the target: the laser goes on
    assert solve(localizer, reading(1.0), frame(20.0)).stage is Stage.LASER


@pytest.mark.parametrize(("age_s", "stage"), [(0.34, Stage.BOTH), (0.4, Stage.BINOCULAR)])
def test_a_reading_is_held_for_a_little_more_than_one_period(age_s: float, stage: Stage) -> None:
    samples = reading(1.0, 1.0 - age_s), frame(24, (330, 170))
    assert solve(PaperLocalizer(AIR, Sphere(), Found()), *samples).stage is stage


@pytest.mark.parametrize("range_m", [float("nan"), 0.0, -1.0])
def test_a_reading_that_is_none_is_not_used(range_m: float) -> None:
    samples = reading(range_m), frame(24, (330, 170))
    assert solve(PaperLocalizer(AIR, Sphere(), Found()), *samples).stage is Stage.BINOCULAR


def test_a_spot_outside_the_targets_box_is_not_the_lasers() -> None:
    assert solve(PaperLocalizer(AIR, Sphere(), Found()), reading(1.0), frame(24, (500, 60))).stage is Stage.BINOCULAR


def test_a_hull_needs_no_detector() -> None:
    assert solve(PaperLocalizer(AIR, Plane()), frame(20.0)).stage is Stage.BINOCULAR
    assert solve(PaperLocalizer(AIR, Plane()), reading(1.26), frame(20.0, (330, 170))).stage is Stage.BOTH


# Parts


def test_a_block_at_the_border_or_without_texture_does_not_match() -> None:
    left, right = pair(20.0)
    options = {"block_px": 21, "span_px": (1, 100), "least_score": 0.5}
    assert match_block(left, right, (320, 180), **options) == 20  # type: ignore[arg-type]
    assert match_block(left, right, (5, 180), **options) is None  # type: ignore[arg-type]
    assert match_block(np.full_like(left, 7), right, (320, 180), **options) is None  # type: ignore[arg-type]
    assert match_block(left, texture(1), (320, 180), **options) is None  # type: ignore[arg-type]


def test_spots_are_bright_round_and_of_a_fitting_size() -> None:
    image = np.full((HEIGHT, WIDTH), 60, np.uint8)
    cv2.circle(image, (100, 90), 5, 230, -1)
    cv2.circle(image, (200, 90), 5, 210, -1)  # less bright
    cv2.line(image, (300, 50), (300, 80), 255, 3)  # not round
    cv2.circle(image, (400, 90), 1, 255, -1)  # too small
    cv2.circle(image, (500, 200), 60, 255, -1)  # too large
    cv2.circle(image, (600, 90), 5, 150, -1)  # too dark
    assert find_spots(image, 180, 0.7, (9, 4000)) == [(100, 90), (200, 90)]


def test_virtual_focal_length_corrects_what_the_pinhole_has_wrong() -> None:
    """Eq. 12 at the laser's own points gives their distance back on average; refraction is not traced anywhere else."""
    rig = Rig.load("rendered")
    assert rig.laser is not None
    f_px = PinholePair(rig).fx_px
    assert 1.33 * 1400 < f_px < 1.35 * 1400
    lengths = np.arange(1.0, 2.21, 0.1)
    points: Array = rig.laser.origin_m + lengths[:, None] * rig.laser.direction
    rows = []
    for lens, seen_px in zip(rig.fit_pinhole_water(), rig.project(points), strict=True):
        rows.append(
            cv2.undistortPoints(seen_px, lens.matrix, np.array(lens.distortion), P=lens.matrix)[:, 0, 0] - lens.cx
        )
    disparity = rows[0] - rows[1]
    errors = f_px * rig.baseline_m / disparity - points[:, 2]
    assert abs(errors.mean()) < 0.01
    assert np.abs(errors).max() > 5e-4  # one number cannot be right everywhere


def test_the_rig_files_own_virtual_focal_length_is_used() -> None:
    rig = replace(AIR, virtual_focal_px=(500.0, 510.0))
    assert depth(solve(PaperLocalizer(rig, Sphere(), Found()), frame(20.0))) == pytest.approx(500 * BASELINE / 20)


def test_a_turned_pair_is_rectified_and_the_point_is_in_the_left_frame() -> None:
    angle = np.radians(1.5)
    R = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    T = Pose(R, [-BASELINE, 0.001, 0.0])
    turned = PinholePair(replace(AIR, T_right_left=T))
    point = np.array([0.2, -0.1, 1.5])
    left, right = turned.R_rectified_left @ point, turned.R_rectified_left @ (point - T.inverse().t_m)
    u, v = turned.rectified_px(CAMERA.project(point[None])[0])
    disparity = turned.fx_px * (left[0] / left[2] - right[0] / right[2])
    assert turned.point_m(u, v, disparity) == pytest.approx(point, abs=1e-6)


def test_settings_reach_the_method() -> None:
    config = Config(paper=PaperConfig(least_score=1.0))
    assert solve(PaperLocalizer(AIR, Sphere(), Found(), config), frame(20.3)).status is Status.LOST


# On pictures from another renderer, through true glass and water


class TruthBoxes:
    def __init__(self, folder: Path) -> None:
        frames = json.loads((folder / "truth.json").read_text())["frames"]
        self._boxes = {f["left"]: f["bbox_left_px"] for f in frames}

    def find(self, frame: StereoFrame) -> list[Detection]:
        x0, y0, x1, y1 = self._boxes[frame.name]
        return [Detection((x0 - 0.5, y0 - 0.5, x1 - x0, y1 - y0), 1.0)]


@pytest.mark.data
@pytest.mark.parametrize("water", ["clear", "turbid"])
def test_centimetres_on_the_rendered_dives(data_dir: Path, water: str) -> None:
    folder = data_dir / "rendered_dives" / f"approach_ball_{water}"
    source = open_source(folder)
    localizer = PaperLocalizer(Rig.load("rendered"), Sphere(0.34), TruthBoxes(folder))
    by_stamp = {s.t_ns: s for sample in source if (s := localizer.step(sample)) is not None}
    solutions = list(by_stamp.values())  # of a stamp the last: the one with its reading
    errors = compare(solutions, source.truth, Sphere(0.34))
    own, nearest = by_stage(errors, own_point=True), by_stage(errors)
    assert {row.name for row in own} == {"1 binocular", "2 both", "3 laser", "all"}
    assert own[-1].count == 21
    assert 0.002 < own[-1].mean_m < 0.060
    assert 0.010 < nearest[-1].mean_m < 0.060  # off the axis of a ball its point is not the nearest one
    binocular = next(row for row in own if row.name == "1 binocular")
    assert binocular.mean_m > 0.010
