"""Samples, detections and solutions as ROS 2 messages (dictionaries of the fields in ``ros2_definitions``).

``header.stamp`` is the time of acquisition. Frames: REP-103 optical frames for the cameras; "laser" has x forward.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from leadline.samples import NS_PER_S, Array, Detection, LaserRange, Solution, Status, StereoFrame, VehicleMotion
from leadline.wire.images import image_format
from leadline.wire.solutions import HEADER, solution_row
from leadline.wire.stamps import format_stamp

if TYPE_CHECKING:
    from leadline.geometry import Camera
    from leadline.rig import Rig

Message = dict[str, Any]

LEFT_FRAME, RIGHT_FRAME, LASER_FRAME = "left_camera_optical", "right_camera_optical", "laser"
FRAME_NAME, LASER_NAME, SOLUTION_NAME = "leadline/frame", "leadline/laser", "leadline/localizer"
MOTION_NAME = "leadline/motion"
_INFRARED = 1  # the message knows ultrasound and infrared; light is the nearer of the two
_BEAM_RAD = 0.001
_MAX_RANGE_M = 100.0
_NO_KNOWLEDGE_RAD2 = 1e6  # variance of the target's orientation: a position is all that we measure
_LEVEL = {Status.VALID: 0, Status.COASTING: 1, Status.LOST: 2}  # OK, WARN, ERROR


def header(t_ns: int, frame_id: str) -> Message:
    return {"stamp": {"sec": t_ns // NS_PER_S, "nanosec": t_ns % NS_PER_S}, "frame_id": frame_id}


def stamp_ns(message: Any) -> int:
    """``header.stamp`` of a decoded message, ns."""
    return int(message.header.stamp.sec) * NS_PER_S + int(message.header.stamp.nanosec)


def compressed_image(t_ns: int, frame_id: str, data: bytes) -> Message:
    return {"header": header(t_ns, frame_id), "format": image_format(data) or "unknown", "data": data}


def range_message(reading: LaserRange) -> Message:
    """The raw reading; a float32, as the message wants it (the exact one is in ``laser_info``)."""
    return {
        "header": header(reading.t_ns, LASER_FRAME),
        "radiation_type": _INFRARED,
        "field_of_view": _BEAM_RAD,
        "min_range": 0.0,
        "max_range": _MAX_RANGE_M,
        "range": min(reading.range_m, 1e30),
        "variance": 0.0,  # 0: not known
    }


def motion_message(motion: VehicleMotion) -> Message:
    """The vehicle's twist in the left camera's frame; a variance of -1 where a part is not measured (as in ROS)."""
    parts = (motion.velocity_m_s, motion.velocity_sigma_m_s), (motion.rotation_rad_s, motion.rotation_sigma_rad_s)
    variances = [-1.0 if vector is None else sigma**2 for vector, sigma in parts for _ in range(3)]
    linear, angular = (dict(zip("xyz", map(float, vector or (0.0, 0.0, 0.0)), strict=True)) for vector, _ in parts)
    covariance = [float(number) for number in np.diag(variances).ravel()]
    twist = {"twist": {"linear": linear, "angular": angular}, "covariance": covariance}
    return {"header": header(motion.t_ns, LEFT_FRAME), "twist": twist}


def motion_info(motion: VehicleMotion) -> Message:
    """What the message has no field for: when it arrived, and the sigmas to the last digit."""
    values = {
        "velocity_sigma_m_s": repr(float(motion.velocity_sigma_m_s)),
        "rotation_sigma_rad_s": repr(float(motion.rotation_sigma_rad_s)),
        "arrival_s": _stamp(motion.arrival_ns),
    }
    return diagnostic(motion.t_ns, MOTION_NAME, values)


def frame_info(frame: StereoFrame) -> Message:
    """All that is exact about a frame, beside its two images."""
    values = {
        "name": frame.name,
        "arrival_s": _stamp(frame.arrival_ns),
        "left_t_s": _stamp(frame.left_t_ns),
        "right_t_s": _stamp(frame.right_t_ns),
        "laser_on": "" if frame.laser_on is None else str(int(frame.laser_on)),
    }
    return diagnostic(frame.t_ns, FRAME_NAME, values)


def laser_info(reading: LaserRange) -> Message:
    """All that is exact about a reading."""
    values = {
        "range_m": repr(float(reading.range_m)),
        "quality": "" if reading.quality is None else repr(float(reading.quality)),
        "arrival_s": _stamp(reading.arrival_ns),
    }
    return diagnostic(reading.t_ns, LASER_NAME, values)


def solution_diagnostic(solution: Solution) -> Message:
    """The whole row of ``solutions.csv`` as key and value."""
    text = f"{solution.status}, {solution.stage.name.lower()}"
    return diagnostic(
        solution.t_ns,
        SOLUTION_NAME,
        dict(zip(HEADER, solution_row(solution), strict=True)),
        level=_LEVEL[solution.status],
        text=text,
    )


def diagnostic(t_ns: int, name: str, values: dict[str, str], *, level: int = 0, text: str = "") -> Message:
    pairs = [{"key": key, "value": value} for key, value in values.items() if value]
    status = {"level": level, "name": name, "message": text, "hardware_id": "", "values": pairs}
    return {"header": header(t_ns, ""), "status": [status]}


def target_message(solution: Solution) -> Message:
    """Position and covariance in the left camera's frame; only for a solution that has them."""
    if solution.position_m is None or solution.cov_m2 is None:
        raise ValueError("a lost target has no position")
    covariance = np.diag([0.0] * 3 + [_NO_KNOWLEDGE_RAD2] * 3)
    covariance[:3, :3] = solution.cov_m2
    return {
        "header": header(solution.t_ns, LEFT_FRAME),
        "pose": _pose(solution.position_m, covariance),
    }


def detections_message(t_ns: int, detections: Sequence[Detection]) -> Message:
    """Boxes in the left image; the centre is that of the box, px."""
    stamp = header(t_ns, LEFT_FRAME)
    return {"header": stamp, "detections": [_detection(stamp, i, one) for i, one in enumerate(detections)]}


def _detection(stamp: Message, index: int, detection: Detection) -> Message:
    x, y, width, height = (float(number) for number in detection.box_px)
    hypothesis = {"class_id": detection.label, "score": float(detection.score)}
    centre = {"position": {"x": x + width / 2, "y": y + height / 2}, "theta": 0.0}
    return {
        "header": stamp,
        "results": [{"hypothesis": hypothesis, "pose": _pose(np.zeros(3), np.zeros((6, 6)))}],
        "bbox": {"center": centre, "size_x": width, "size_y": height},
        "id": str(index),
    }


def _pose(position: Array, covariance: Array) -> Message:
    x, y, z = (float(number) for number in position)
    orientation = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    return {
        "pose": {"position": {"x": x, "y": y, "z": z}, "orientation": orientation},
        "covariance": [float(number) for number in covariance.ravel()],
    }


def camera_infos(rig: Rig) -> tuple[Message, Message]:
    """CameraInfo of left and right, not stamped yet: the in-water pinholes if the rig has them, else the air's.

    ``k``, ``d`` are of the camera as it is, ``r``, ``p`` rectify the pair, so that P[0, 3] of the right is -fx b.
    Pinholes are for viewing and for other tools; our own geometry is in the attached rig.
    """
    left, right = rig.pinhole_water or (rig.left, rig.right)
    t_m = np.asarray(rig.T_right_left.t_m, float).reshape(3, 1)
    lenses = [(camera.matrix, np.array(camera.distortion or (0.0,) * 5)) for camera in (left, right)]
    (left_K, left_d), (right_K, right_d) = lenses
    size = (left.width, left.height)
    left_R, right_R, left_P, right_P = cv2.stereoRectify(
        left_K, left_d, right_K, right_d, size, np.asarray(rig.T_right_left.R, float), t_m, flags=0
    )[:4]
    return (
        _camera_info(left, LEFT_FRAME, np.asarray(left_R, float), np.asarray(left_P, float)),
        _camera_info(right, RIGHT_FRAME, np.asarray(right_R, float), np.asarray(right_P, float)),
    )


def _camera_info(camera: Camera, frame_id: str, R: Array, P: Array) -> Message:
    coefficients = list(camera.distortion)
    count = 5 if len(coefficients) <= 5 else max(8, len(coefficients))
    region = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    return {
        "header": header(0, frame_id),
        "height": camera.height,
        "width": camera.width,
        "distortion_model": "plumb_bob" if count == 5 else "rational_polynomial",
        "d": coefficients + [0.0] * (count - len(coefficients)),
        "k": [float(number) for number in camera.matrix.ravel()],
        "r": [float(number) for number in R.ravel()],
        "p": [float(number) for number in P.ravel()],
        "binning_x": 0,
        "binning_y": 0,
        "roi": region,
    }


def at(info: Message, t_ns: int) -> Message:
    """A camera's info stamped like its image."""
    return {**info, "header": header(t_ns, info["header"]["frame_id"])}


def _stamp(t_ns: int | None) -> str:
    return "" if t_ns is None else format_stamp(t_ns)
