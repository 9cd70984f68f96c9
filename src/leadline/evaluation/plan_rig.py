"""A rig that is not there yet: drawn from a few numbers, with the calibration that it may expect."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from leadline.calibration.board import Board
from leadline.calibration.cameras import WIDE_INDEX
from leadline.calibration.problem import Prior, Problem, Sight
from leadline.calibration.views import PORT_NAMES, POSE_NAMES, SIDES, lens_names
from leadline.geometry import Beam, Camera, LayeredPort, Pose
from leadline.rig import Rig
from leadline.rig_covariance import RigCovariance
from leadline.rig_derivatives import Medium
from leadline.rig_parameters import turn
from leadline.samples import Array
from leadline.water import Water, WaterState

BOARD = Board(11, 8, 0.030)
CORNER_SIGMA_PX = 0.05
BOARDS_M = (0.45, 2.0)
TRIES = 60
LASER_SIGMA = {  # of a laser calibrated with a dozen spots at 0.2 to 2.2 m: see docs/calibration-laser.md
    **{f"laser.origin_m[{i}]": 4e-5 for i in (0, 1)},
    **{f"laser.direction[{i}]": 3e-5 for i in (0, 1)},
    "laser.range_offset_m": 7.5e-4,
}


@dataclass(frozen=True, slots=True)
class Drawing:
    """Two parallel cameras behind one flat port square to them. glass_m 0: none, a thin window; port_m None: in air.

    laser: origin x, y, z, m, and direction; None: no laser. Index None: fresh water at 20 C.
    """

    baseline_m: float
    focal_px: float
    size: tuple[int, int]
    port_m: float | None = 0.01
    glass_m: float = 0.002
    index: float | None = None
    laser_origin_m: tuple[float, float, float] | None = None
    laser_direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    laser_sigma_m: float = 0.003

    def rig(self) -> Rig:
        """ValueError where there is no such rig."""
        width, height = self.size
        camera = Camera(self.focal_px, self.focal_px, (width - 1) / 2, (height - 1) / 2, width, height)
        water = Water.from_state(WaterState(20.0))
        if self.index is not None:
            shift = self.index - water.index
            water = Water(water.blue + shift, water.green + shift, water.red + shift, water.group_index + shift)
        layers = ((self.glass_m, 1.52),) if self.glass_m > 0 else ()
        port = None if self.port_m is None else LayeredPort((0, 0, 1), self.port_m, layers, water.index)
        laser = None
        if self.laser_origin_m is not None:
            length = float(np.linalg.norm(self.laser_direction))
            if not length > 0:
                raise ValueError("a laser of no direction")
            group = 1.0 if port is None else water.group_index
            direction = np.array(self.laser_direction) / length
            laser = Beam(np.array(self.laser_origin_m), direction, 1.0, 0.0, group, range_sigma_m=self.laser_sigma_m)
        pose = Pose(np.eye(3), np.array([-self.baseline_m, 0.0, 0.0]))
        return Rig(camera, camera, pose, port, None if port is None else water, laser)


def with_expected_calibration(rig: Rig, boards: int) -> Rig:
    """The rig with the covariance that so many boards in air and as many in water would leave; 0: it is exact.

    The boards (11x8 corners of 30 mm, 0.05 px) lie anywhere in the view, at 0.45 to 2 m, tilted; without a port they
    are all in air. The laser's part is that of a usual laser calibration.
    """
    if not boards:
        return dataclasses.replace(rig, covariance=RigCovariance())
    media = (Medium.AIR,) if rig.port is None else (Medium.AIR, Medium.WATER)
    names = (*lens_names("left"), *lens_names("right"), *POSE_NAMES)
    priors: dict[str, Prior] = {}
    if rig.port is not None:
        names += (*PORT_NAMES, "water.index")
        priors["water.index"] = Prior(rig.port.outside_index, WIDE_INDEX.sigma)
    sights, poses = list[Sight](), list[Pose]()
    rng = np.random.default_rng(3)
    for medium in media:
        for z_m in np.geomspace(*BOARDS_M, boards):
            found = _seen_board(rig, medium, float(z_m), rng, len(poses))
            if found is not None:
                sights += found[1]
                poses.append(found[0])
    if len(poses) < 4:
        raise ValueError("no board of 0.3 m fits the common view at 0.45 to 2 m: plan it with --boards 0")
    cov = _inverse(Problem(sights, names, priors).information(rig, poses, CORNER_SIGMA_PX))
    if rig.laser is not None:
        laser = np.diag(np.square(list(LASER_SIGMA.values())))
        names += tuple(LASER_SIGMA)
        cov = np.block([[cov, np.zeros((len(cov), len(laser)))], [np.zeros((len(laser), len(cov))), laser]])
    return dataclasses.replace(rig, covariance=RigCovariance(names, cov))


def _seen_board(
    rig: Rig, medium: Medium, z_m: float, rng: np.random.Generator, view: int
) -> tuple[Pose, list[Sight]] | None:
    """A board that both cameras see whole: the first of TRIES that does."""
    half = np.array([rig.left.width / rig.left.fx, rig.left.height / rig.left.fy]) / 2
    seen_by = dataclasses.replace(rig, port=None, water=None) if medium is Medium.AIR else rig
    turns = rng.uniform(-1, 1, (TRIES, 3)) * [0.6, 0.6, 0.3]
    places = np.column_stack([rng.uniform(-half, half, (TRIES, 2)), np.ones(TRIES)]) * z_m
    middle = BOARD.points_m.mean(axis=0)
    poses = [Pose(R, place - R @ middle) for place, R in zip(places, map(turn, turns), strict=True)]
    ends = BOARD.points_m[[0, BOARD.columns - 1, -BOARD.columns, -1]]
    q_px = np.stack(seen_by.project(np.concatenate([pose.apply(ends) for pose in poses])))
    with np.errstate(invalid="ignore"):
        inside = (q_px > 5) & (q_px < np.array([rig.left.width, rig.left.height]) - 6)  # not so where NaN
    whole = inside.reshape(2, TRIES, -1).all(axis=(0, 2))
    if not whole.any():
        return None
    pose = poses[int(np.argmax(whole))]
    pixels = seen_by.project(pose.apply(BOARD.points_m))
    return pose, [
        Sight(view, side, medium, BOARD.points_m, q, BOARD.bow) for side, q in zip(SIDES, pixels, strict=True)
    ]


def _inverse(information: Array) -> Array:
    """Scaled to a unit diagonal first: the parameters' units differ by 1e6."""
    scale = 1 / np.sqrt(np.diag(information))
    return np.asarray(np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale))
