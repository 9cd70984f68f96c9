"""MAVLink 2: guidance out, the vehicle's attitude and velocity in. The only file that knows pymavlink (LGPL-3).

Out: HEARTBEAT (as a companion computer), LANDING_TARGET (body FRD), DISTANCE_SENSOR (whole centimetres), and as
NAMED_VALUE_FLOAT what those have no field for. In: ATTITUDE and LOCAL_POSITION_NED of the autopilot.
"""

from __future__ import annotations

import re
import socket
from collections.abc import Iterable
from typing import Any

import numpy as np

from leadline.errors import InputError
from leadline.geometry.pose import Pose
from leadline.guidance import Guidance
from leadline.samples import Array, Status, VehicleMotion
from leadline.wire.mavlink_frames import BootClock, camera_motion, frd, ned_to_frd, orientation

SYSTEM, COMPONENT = 1, 191  # of the vehicle; MAV_COMP_ID_ONBOARD_COMPUTER
AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1: others on the link do not speak for the vehicle
BODY_FRD, VISION_OTHER, LASER = 12, 3, 0  # MAV_FRAME, LANDING_TARGET_TYPE, MAV_DISTANCE_SENSOR
ONBOARD_CONTROLLER, NO_AUTOPILOT, ACTIVE = 18, 8, 4  # MAV_TYPE, MAV_AUTOPILOT, MAV_STATE
ALERT, NOTICE = 1, 5  # MAV_SEVERITY
NEAREST_CM, FARTHEST_CM = 10, 600
UNKNOWN_VARIANCE = 255
STALE_NS = 500_000_000  # an older velocity is no velocity
LAST_PORT = 65535
ADDRESS = re.compile(
    r"(?P<name>(?P<way>udpout|udpin|tcp|tcpin):(?P<host>[^:?]+):(?P<port>\d{1,5})|(/dev/|COM)[^?]+)(\?baud=(?P<baud>\d+))?"
)


def _dialect() -> Any:
    try:
        from pymavlink.dialects.v20 import common  # noqa: PLC0415  an extra
    except ImportError:
        raise InputError("MAVLink needs pymavlink", fix="pip install 'leadline[mavlink]'") from None
    return common


def _parser() -> Any:
    parser = _dialect().MAVLink(None)
    parser.robust_parsing = True
    return parser


class MavlinkLink:
    """url: as pymavlink has it: udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT, or a serial port (?baud=).

    InputError for what is none.
    """

    def __init__(self, url: str) -> None:
        found = ADDRESS.fullmatch(url)
        if found is None:
            raise InputError("not a MAVLink address", url, "give udpout:HOST:PORT or /dev/ttyACM0?baud=115200")
        if found["port"] is not None and int(found["port"]) > LAST_PORT:
            raise InputError(f"there is no port {found['port']}", url, f"give one up to {LAST_PORT}")
        self.url, self._name, self._baud = url, found["name"], int(found["baud"] or 115200)
        self._place = None if found["host"] is None else (found["way"], found["host"], found["port"])
        self._codec = _dialect().MAVLink(None, srcSystem=SYSTEM, srcComponent=COMPONENT)
        self._parser = _parser()
        self._port: Any = None

    def open(self) -> None:
        """OSError where it cannot be opened, or its host is not known."""
        from pymavlink import mavutil  # noqa: PLC0415

        self._port = mavutil.mavlink_connection(self._resolved(), baud=self._baud, source_system=SYSTEM, retries=1)

    def _resolved(self) -> str:
        """The host is looked up here and once: pymavlink does it at each message while that fails, for seconds each."""
        if self._place is None:
            return self._name
        way, host, port = self._place
        try:
            return f"{way}:{socket.gethostbyname(host)}:{port}"
        except (OSError, UnicodeError) as error:
            raise OSError(f"no host of the name {host} is known") from error

    def send(self, messages: Iterable[Any]) -> None:
        for message in messages:
            self._port.write(message.pack(self._codec))

    def receive(self) -> list[Any]:
        """What has come, damaged bytes left out; does not wait."""
        data = self._port.recv(4096)
        if not data:
            return []
        if self.url.startswith("udp"):
            self._parser = _parser()  # a datagram holds whole messages: what is damaged in the last one ends with it
        return list(self._parser.parse_buffer(bytes(data)) or [])

    def wait(self, seconds: float) -> None:
        self._port.select(seconds)

    def close(self) -> None:
        if self._port is not None:
            self._port.close()


def heartbeat() -> list[Any]:
    return [_dialect().MAVLink_heartbeat_message(ONBOARD_CONTROLLER, NO_AUTOPILOT, 0, 0, ACTIVE, 3)]


def say(text: str, *, alert: bool) -> list[Any]:
    """A line for the operator's screen (50 characters)."""
    return [_dialect().MAVLink_statustext_message(ALERT if alert else NOTICE, text.encode("ascii", "replace")[:50])]


def guidance_messages(guidance: Guidance, T_body_left: Pose, boot_ms: int) -> list[Any]:
    """What an autopilot and a ground station are told of one solution."""
    m = _dialect()
    x, y, z = (float(v) for v in frd(guidance.p_body_m))
    valid = guidance.status is Status.VALID
    ahead = T_body_left.inverse().apply(guidance.p_body_m)  # the camera's own axes: right, down, ahead
    angle_x, angle_y = float(np.arctan2(ahead[0], ahead[2])), float(np.arctan2(ahead[1], ahead[2]))
    target = m.MAVLink_landing_target_message(
        guidance.t_ns // 1000, 0, BODY_FRD, angle_x, angle_y, guidance.range_m, 0.0, 0.0,
        x, y, z, (1.0, 0.0, 0.0, 0.0), VISION_OTHER, int(valid),
    )  # fmt: skip
    variance_cm2 = min(round((guidance.range_sigma_m * 100) ** 2), UNKNOWN_VARIANCE - 1)
    distance = m.MAVLink_distance_sensor_message(
        boot_ms, NEAREST_CM, FARTHEST_CM, min(max(round(guidance.range_m * 100), 0), 65535), LASER, 0,
        orientation(T_body_left), variance_cm2 if valid else UNKNOWN_VARIANCE,
    )  # fmt: skip
    return [target, *([distance] if valid else []), *_values(guidance, boot_ms)]


def _values(guidance: Guidance, boot_ms: int) -> list[Any]:
    """Names of at most ten letters; NaN: not known."""
    values = {
        "LL_RANGE": guidance.range_m,
        "LL_SIGMA": guidance.range_sigma_m,
        "LL_BEARING": -guidance.bearing_rad,  # to starboard positive, as MAVLink's yaw
        "LL_CLOSING": guidance.closing_m_s,
        "LL_T_STOP": guidance.standoff_s,
        "LL_ALARM": float(guidance.alarm),
        "LL_REACH": float(guidance.in_reach),
        "LL_ACCUR": float(guidance.accurate),
    }
    m = _dialect()
    return [
        m.MAVLink_named_value_float_message(boot_ms, name.encode(), np.nan if value is None else float(value))
        for name, value in values.items()
    ]


class MotionReader:
    """ATTITUDE and LOCAL_POSITION_NED messages in, the camera's motion out, stamped when it was measured."""

    def __init__(self, T_body_left: Pose, velocity_sigma_m_s: float = 0.05, rotation_sigma_rad_s: float = 0.01) -> None:
        self._pose = T_body_left
        self._sigmas = velocity_sigma_m_s, rotation_sigma_rad_s
        self._clock = BootClock()
        self._velocity_ned: tuple[int, Array] | None = None

    def read(self, message: Any, arrival_ns: int) -> VehicleMotion | None:
        """None for messages of others, of other kinds, or with numbers that are none."""
        if message.get_srcComponent() != AUTOPILOT:
            return None
        kind = message.get_type()
        if kind == "LOCAL_POSITION_NED":
            velocity = np.array([message.vx, message.vy, message.vz])
            if np.isfinite(velocity).all():
                self._velocity_ned = self._clock.stamp_ns(message.time_boot_ms, arrival_ns), velocity
            return None
        if kind != "ATTITUDE":
            return None
        t_ns = self._clock.stamp_ns(message.time_boot_ms, arrival_ns)
        rates = np.array([message.rollspeed, message.pitchspeed, message.yawspeed])
        angles = message.roll, message.pitch, message.yaw
        if not np.isfinite([*rates, *angles]).all():
            return None
        return self._motion(t_ns, rates, angles, arrival_ns)

    def _motion(
        self, t_ns: int, rates_frd: Array, angles: tuple[float, float, float], arrival_ns: int
    ) -> VehicleMotion:
        velocity_frd, last, self._velocity_ned = None, self._velocity_ned, None  # told once: twice is no second witness
        if last is not None and abs(t_ns - last[0]) < STALE_NS:
            velocity_frd = ned_to_frd(last[1], *angles)
        rotation, velocity = camera_motion(self._pose, rates_frd, velocity_frd)
        return VehicleMotion(
            t_ns,
            None if velocity is None else (float(velocity[0]), float(velocity[1]), float(velocity[2])),
            (float(rotation[0]), float(rotation[1]), float(rotation[2])),
            velocity_sigma_m_s=self._sigmas[0],
            rotation_sigma_rad_s=self._sigmas[1],
            arrival_ns=arrival_ns,
        )
