"""What moves between two exposures, and between the vehicle and its target.

The right camera may expose later than the left one (`skew`). The target moved meanwhile: by its velocity times the
difference, which a baseline of centimetres makes many times worse (16 ms at 0.1 m/s: 25 mm at a metre). The right
camera's rig is moved along, and what is not known of the velocity goes into the measurement's covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from leadline.estimation import Estimate
from leadline.rig import Rig
from leadline.samples import NS_PER_S, Array, Measurement, StereoFrame, VehicleMotion
from leadline.target import Cylinder, Sphere, Target

FRESH_S = 0.3  # a reading of the vehicle's motion says what it does so long


def taken_ns(frame: StereoFrame) -> int:
    """When the frame's measurements hold: at the left exposure."""
    return frame.t_ns if frame.left_t_ns is None else frame.left_t_ns


@dataclass(frozen=True, slots=True)
class Skew:
    """The right exposure is ``dt_s`` after the left one; what is seen moves with velocity_m_s (3,), velocity_cov."""

    dt_s: float
    velocity_m_s: Array
    velocity_cov: Array

    def rig(self, rig: Rig) -> Rig:
        return rig.with_target_motion(self.dt_s * self.velocity_m_s) if self.dt_s else rig

    def widened(self, measurement: Measurement, rig: Rig, isotropic: bool) -> Measurement:
        """The measurement of a place (3,) with what the velocity's uncertainty does to its triangulation."""
        if not self.dt_s:
            return measurement
        gain = self.dt_s * triangulation_gain(rig, measurement.z[:3])
        extra = gain @ self.velocity_cov @ gain.T
        cov = measurement.cov.copy()
        cov[:3, :3] += np.trace(extra) * np.eye(3) if isotropic else extra
        return replace(measurement, cov=cov)


def triangulation_gain(rig: Rig, p_m: Array) -> Array:
    """(3, 3): how far a triangulated point moves along the left ray when the right camera sees it moved."""
    jacobian = rig.project_with_jacobian(p_m[None], "right")[1][0]
    sight = p_m / np.linalg.norm(p_m)
    along = jacobian @ sight
    return np.outer(sight, along @ jacobian / (along @ along))


def skew_of(frame: StereoFrame, target: Target, before: Estimate | None, motion: VehicleMotion | None,
            usual_speed_m_s: float) -> Skew:  # fmt: skip
    """How the exposures of a frame differ, and how what they show moves, as far as that is known."""
    dt_s = 0.0
    if frame.left_t_ns is not None and frame.right_t_ns is not None:
        dt_s = (frame.right_t_ns - frame.left_t_ns) / NS_PER_S
    unknown = usual_speed_m_s**2 * np.eye(3)
    if before is None or not dt_s:
        return Skew(dt_s, np.zeros(3), unknown)
    if isinstance(target, Sphere):
        return Skew(dt_s, before.velocity_m_s, before.velocity_cov)
    told = _of_still_water(frame, before.x[:3], motion)
    if told is not None:
        return Skew(dt_s, *told)
    # The foot of a wall or of a pile does not tell how the texture slides by: only its way to or fro is known.
    normal = before.x[:3] / np.linalg.norm(before.x[:3])
    across = np.eye(3) - np.outer(normal, normal)
    along = np.outer(normal, normal)
    return Skew(dt_s, along @ before.velocity_m_s, along @ before.velocity_cov @ along + across @ unknown @ across)


def _of_still_water(frame: StereoFrame, p_m: Array, motion: VehicleMotion | None) -> tuple[Array, Array] | None:
    """How texture near p moves by the vehicle's own motion, (3,) and (3, 3); None without a fresh, whole reading."""
    if motion is None or motion.velocity_m_s is None or motion.rotation_rad_s is None:
        return None
    if abs(motion.t_ns - taken_ns(frame)) > FRESH_S * NS_PER_S:
        return None
    velocity = -np.array(motion.velocity_m_s) - np.cross(motion.rotation_rad_s, p_m)
    sigma = np.hypot(motion.velocity_sigma_m_s, motion.rotation_sigma_rad_s * float(np.linalg.norm(p_m)))
    return velocity, sigma**2 * np.eye(3)


def as_of_target(motion: VehicleMotion, target: Target, x: Array) -> VehicleMotion:
    """The motion with the part of the velocity that moves the target's position: along a wall or a pile it stays."""
    if motion.velocity_m_s is None or isinstance(target, Sphere):
        return motion
    velocity = np.array(motion.velocity_m_s)
    if isinstance(target, Cylinder):
        axis = target.axis(x)
        velocity = velocity - (velocity @ axis) * axis
    else:
        normal = x[:3] / np.linalg.norm(x[:3])
        velocity = (velocity @ normal) * normal
    vx, vy, vz = (float(v) for v in velocity)
    return replace(motion, velocity_m_s=(vx, vy, vz))
