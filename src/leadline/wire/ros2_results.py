"""What a run finds, as ROS 2 messages (dictionaries of their fields): position, guidance, health, frames."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np

from leadline.geometry.pose import Pose
from leadline.guidance import Guidance
from leadline.health import Condition, State
from leadline.rig import Rig
from leadline.samples import NS_PER_S, Array, Solution
from leadline.wire.ros2_messages import LASER_FRAME, LEFT_FRAME, RIGHT_FRAME, Message, header

BODY_FRAME, TARGET_FRAME = "base_link", "leadline_target"
HARDWARE = "leadline"
_OK, _WARN, _ERROR = 0, 1, 2
_GONE = (State.OFF, State.STUCK, State.GARBAGE)


def point_message(solution: Solution) -> Message:
    """Where the target is, in the left camera's frame; only for a solution that has it."""
    return {"header": header(solution.t_ns, LEFT_FRAME), "point": _xyz(_position(solution))}


def guidance_text(solution: Solution, guidance: Guidance | None) -> Message:
    """One JSON object: the solution's state, and what follows from it where it is not lost."""
    said: dict[str, object] = {
        "stamp": {"sec": solution.t_ns // NS_PER_S, "nanosec": solution.t_ns % NS_PER_S},
        "status": str(solution.status),
        "stage": int(solution.stage),
    }
    if guidance is not None:
        said |= {
            "frame_id": BODY_FRAME,
            "position_m": [float(number) for number in guidance.p_body_m],
            "range_m": guidance.range_m,
            "range_sigma_m": guidance.range_sigma_m,
            "bearing_rad": guidance.bearing_rad,
            "elevation_rad": guidance.elevation_rad,
            "closing_m_s": guidance.closing_m_s,
            "standoff_s": guidance.standoff_s,
            "alarm": guidance.alarm,
            "in_reach": guidance.in_reach,
            "accurate": guidance.accurate,
        }
    return {"data": json.dumps(said)}


def health_message(conditions: Sequence[Condition], now_ns: int) -> Message:
    """One status for each part: a part that gives nothing of use is an error, any other fault a warning."""
    return {"header": header(now_ns, ""), "status": [_status(condition) for condition in conditions]}


def _status(condition: Condition) -> Message:
    level = _OK if condition.ok else _ERROR if condition.state in _GONE else _WARN
    said = {
        "state": str(condition.state),
        "since_s": f"{condition.since_ns / NS_PER_S:.3f}",
        "advice": condition.advice,
    }
    return {
        "level": level,
        "name": f"leadline: {condition.part}",
        "message": condition.why or "ok",
        "hardware_id": HARDWARE,
        "values": [{"key": key, "value": value} for key, value in said.items() if value],
    }


def target_transform(solution: Solution) -> Message:
    """The target's frame, parallel to the left camera's."""
    return {"transforms": [transform(solution.t_ns, LEFT_FRAME, TARGET_FRAME, Pose(np.eye(3), _position(solution)))]}


def rig_transforms(rig: Rig, T_body_left: Pose, t_ns: int) -> Message:
    """The frames that stand still: the left camera on the vehicle; the right one and the laser at the left."""
    T_left_right = rig.T_right_left.inverse()
    still = [
        transform(t_ns, BODY_FRAME, LEFT_FRAME, T_body_left),
        transform(t_ns, LEFT_FRAME, RIGHT_FRAME, T_left_right),
    ]
    if rig.laser is not None:
        pose = Pose(_forward(np.asarray(rig.laser.direction)), np.asarray(rig.laser.origin_m))
        still.append(transform(t_ns, LEFT_FRAME, LASER_FRAME, pose))
    return {"transforms": still}


def transform(t_ns: int, parent: str, child: str, T_parent_child: Pose) -> Message:
    x, y, z, w = quaternion(T_parent_child.R)
    return {
        "header": header(t_ns, parent),
        "child_frame_id": child,
        "transform": {"translation": _xyz(T_parent_child.t_m), "rotation": {"x": x, "y": y, "z": z, "w": w}},
    }


def quaternion(R: Array) -> tuple[float, float, float, float]:
    """x, y, z, w with w >= 0, of a rotation: from the largest of the four, so that nothing is divided by little."""
    four = np.array(
        [
            [1 + R[0, 0] - R[1, 1] - R[2, 2], R[0, 1] + R[1, 0], R[0, 2] + R[2, 0], R[2, 1] - R[1, 2]],
            [R[0, 1] + R[1, 0], 1 - R[0, 0] + R[1, 1] - R[2, 2], R[1, 2] + R[2, 1], R[0, 2] - R[2, 0]],
            [R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], 1 - R[0, 0] - R[1, 1] + R[2, 2], R[1, 0] - R[0, 1]],
            [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], 1 + R[0, 0] + R[1, 1] + R[2, 2]],
        ]
    )
    row = four[int(np.argmax(np.diag(four)))]
    x, y, z, w = (float(number) for number in row / np.linalg.norm(row) * (-1.0 if row[3] < 0 else 1.0))
    return x, y, z, w


def _forward(direction: Array) -> Array:
    """A right-handed frame whose x runs along the beam; the other two stand as they like."""
    x = direction / np.linalg.norm(direction)
    other = np.array([0.0, 1.0, 0.0]) if abs(x[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    y = np.cross(other, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _position(solution: Solution) -> Array:
    if solution.position_m is None:
        raise ValueError("a lost target has no position")
    return solution.position_m


def _xyz(vector: Array) -> Message:
    return dict(zip("xyz", (float(number) for number in vector), strict=True))
