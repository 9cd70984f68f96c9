"""Time order across sensors.

Samples are given in order of arrival. Equal arrivals: the vehicle's motion, the frame, the reading, then by stamp, then
as they stand in the file; so the order is a property of the data and a replay is the same run. A sample that is older
than one already given is given all the same and told as late (latency makes that ordinary); the same sensor and stamp
twice is one sample.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from leadline.samples import LaserRange, Sample, StereoFrame, VehicleMotion
from leadline.wire.notice import NoticeKind
from leadline.wire.stamps import format_stamp

Tell = Callable[[NoticeKind, str, str], None]
NAMES: dict[type, str] = {VehicleMotion: "motion", StereoFrame: "frame", LaserRange: "laser"}  # in order of turn
REMEMBERED = 20_000  # stamps of each sensor: a live dive has no end
_TURN = {kind: turn for turn, kind in enumerate(NAMES)}


def arrival_ns(sample: Sample) -> int:
    """When the sample reached us; its stamp where that is not known."""
    return sample.t_ns if sample.arrival_ns is None else sample.arrival_ns


def arrival_key(sample: Sample) -> tuple[int, int, int]:
    """Sort key for samples of several sensors (use a stable sort)."""
    return order_key(arrival_ns(sample), type(sample), sample.t_ns)


def order_key(arrival: int, kind: type, t_ns: int) -> tuple[int, int, int]:
    return arrival, _TURN[kind], t_ns


def watch_order(samples: Iterator[Sample], tell: Tell) -> Iterator[Sample]:
    """Pass samples on as they come; drop and tell repeated ones, tell late ones."""
    given: dict[type, dict[int, None]] = {kind: {} for kind in NAMES}
    newest_ns: int | None = None
    for sample in samples:
        where = f"{NAMES[type(sample)]} at {format_stamp(sample.t_ns)} s"
        stamps = given[type(sample)]
        if sample.t_ns in stamps:
            tell(NoticeKind.REPEATED, where, "this sensor gave this stamp before")
            continue
        stamps[sample.t_ns] = None
        if len(stamps) > REMEMBERED:
            del stamps[next(iter(stamps))]
        if newest_ns is not None and sample.t_ns < newest_ns:
            tell(NoticeKind.LATE, where, f"came after a sample of {format_stamp(newest_ns)} s")
        newest_ns = sample.t_ns if newest_ns is None else max(newest_ns, sample.t_ns)
        yield sample
