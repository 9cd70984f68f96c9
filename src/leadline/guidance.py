"""What a pilot or a controller does with a solution: where to turn, how fast it comes nearer, when to stop.

The vehicle's frame is REP-103's: x forward, y to port, z up. Every yes is given on the safe side by two sigmas.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from leadline.config import GuidanceConfig
from leadline.geometry.pose import Pose
from leadline.rig import Rig
from leadline.samples import Array, Solution, Status

FORWARD_LOOKING = Pose([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [0, 0, 0])  # body from optical frame: z is ahead, y is down
SIGMAS = 2.0
LEAST_CLOSING_M_S = 0.005  # slower is standing still


@dataclass(frozen=True, slots=True)
class Guidance:
    """Of one solution that is not lost.

    p_body_m (3,), cov_body_m2 (3, 3): the target in the vehicle's frame. bearing_rad: turn by this to face it, to port
    positive; elevation_rad: upwards positive. range_m: camera to the nearest surface. closing_m_s: how fast that
    shrinks, None where nobody knows. standoff_s: until the stand-off at this speed; 0 inside it, None if it is never
    reached so. alarm: nearer than the safety distance, or perhaps so. in_reach: certainly within the manipulator's
    reach. accurate: as well known as is needed.
    """

    t_ns: int
    status: Status
    p_body_m: Array
    cov_body_m2: Array
    bearing_rad: float
    elevation_rad: float
    range_m: float
    range_sigma_m: float
    closing_m_s: float | None
    standoff_s: float | None
    alarm: bool
    in_reach: bool
    accurate: bool


def camera_on_body(rig: Rig) -> Pose:
    """``T_body_left`` of the rig; where that is unknown (identity), the camera is taken to look ahead."""
    return FORWARD_LOOKING if _is_identity(rig.T_body_left) else rig.T_body_left


class Guide:
    """Turns solutions into guidance for the vehicle that carries the rig."""

    def __init__(self, rig: Rig, config: GuidanceConfig | None = None) -> None:
        self.config = config or GuidanceConfig()
        self.T_body_left = camera_on_body(rig)

    def of(self, solution: Solution) -> Guidance | None:
        """None while the target is lost."""
        if solution.position_m is None or solution.cov_m2 is None or solution.range_m is None:
            return None
        config, R = self.config, self.T_body_left.R
        sigma_m = solution.range_sigma_m or 0.0
        p_body_m, cov_body_m2 = self.T_body_left.apply(solution.position_m), R @ solution.cov_m2 @ R.T
        x, y, z = p_body_m
        closing_m_s = _closing(solution)
        spread_m = SIGMAS * float(np.sqrt(np.linalg.eigvalsh(cov_body_m2)[-1]))
        return Guidance(
            t_ns=solution.t_ns,
            status=solution.status,
            p_body_m=p_body_m,
            cov_body_m2=cov_body_m2,
            bearing_rad=float(np.arctan2(y, x)),
            elevation_rad=float(np.arctan2(z, np.hypot(x, y))),
            range_m=solution.range_m,
            range_sigma_m=sigma_m,
            closing_m_s=closing_m_s,
            standoff_s=_until(solution.range_m - config.standoff_m, closing_m_s),
            alarm=solution.range_m - SIGMAS * sigma_m < config.safety_m,
            in_reach=solution.status is Status.VALID and solution.range_m + SIGMAS * sigma_m < config.reach_m,
            accurate=solution.status is Status.VALID and spread_m <= config.accuracy_m,
        )


def _closing(solution: Solution) -> float | None:
    """Minus the range's rate: for every shape the nearest point lies on the line to the position."""
    if solution.velocity_m_s is None or solution.position_m is None:
        return None
    distance_m = float(np.linalg.norm(solution.position_m))
    return -float(solution.position_m @ solution.velocity_m_s) / distance_m if distance_m > 0 else 0.0


def _until(left_m: float, closing_m_s: float | None) -> float | None:
    if left_m <= 0:
        return 0.0
    return None if closing_m_s is None or closing_m_s <= LEAST_CLOSING_M_S else left_m / closing_m_s


def _is_identity(pose: Pose) -> bool:
    return bool(np.array_equal(pose.R, np.eye(3)) and not pose.t_m.any())
