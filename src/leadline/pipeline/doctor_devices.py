"""What a source gives while the doctor listens: images, readings, rates, and what went wrong."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from leadline.rig import Rig
from leadline.samples import NS_PER_S, Image, LaserRange, StereoFrame
from leadline.sources import Source, open_source
from leadline.sources.laser_serial import SerialLaser
from leadline.sources.live import LiveSource
from leadline.wire.images import encode_png

AT_MOST = 100  # frames of a recorded dive


@dataclass(slots=True)
class Picture:
    """Of one camera: brightness of its last image, share of saturated pixels, whether all images were the same."""

    mean: float = 0.0
    saturated: float = 0.0
    frozen: bool = False
    last: Image | None = None
    seen: int = 0

    def look(self, image: Image) -> None:
        grey = image if image.ndim == 2 else image[..., 1]
        few = grey[::4, ::4]
        same = self.last is not None and np.array_equal(self.last, few)
        self.frozen = same and (self.frozen or self.seen == 1)
        self.mean, self.saturated = float(few.mean()), float((few >= 250).mean())
        self.last, self.seen = few.copy(), self.seen + 1


@dataclass(slots=True)
class Heard:
    live: bool
    seconds: float
    rig: Rig | None
    has_cameras: bool
    has_laser: bool
    size: tuple[int, int] = (0, 0)
    left: Picture = field(default_factory=Picture)
    right: Picture = field(default_factory=Picture)
    frames_ns: list[int] = field(default_factory=list)
    readings_ns: list[int] = field(default_factory=list)
    range_m: tuple[float, float] = (float("inf"), 0.0)
    frame_bytes: int = 0  # both images, as they are recorded
    protocol: str = ""
    troubles: list[str] = field(default_factory=list)

    @property
    def frames(self) -> int:
        return len(self.frames_ns)

    @property
    def readings(self) -> int:
        return len(self.readings_ns)

    @property
    def frame_rate_hz(self) -> float | None:
        return _rate(self.frames_ns)

    @property
    def reading_rate_hz(self) -> float | None:
        return _rate(self.readings_ns)


def listen(spec: str, seconds: float) -> Heard:
    """Take what the source gives, for so long, or the first frames of a recorded dive. InputError where it is none."""
    source = open_source(spec)
    recorded = not source.live or spec.startswith("live:")
    heard = Heard(
        live=not recorded,
        seconds=seconds,
        rig=source.rig,
        has_cameras=recorded or any(kind in spec for kind in ("uvc:", "rtsp:", "ros2:")),
        has_laser=recorded or any(kind in spec for kind in ("serial:", "ros2:")),
    )
    deadline_s = time.monotonic() + seconds
    source.idle = lambda: _stop_when_due(source, deadline_s)
    try:
        for sample in source:
            if isinstance(sample, StereoFrame):
                _look(heard, sample)
            elif isinstance(sample, LaserRange):
                heard.readings_ns.append(sample.t_ns)
                heard.range_m = min(heard.range_m[0], sample.range_m), max(heard.range_m[1], sample.range_m)
            if time.monotonic() > deadline_s or (not source.live and heard.frames >= AT_MOST):
                break
    finally:
        devices = source.devices if isinstance(source, LiveSource) else []
        heard.protocol = next((one.protocol for one in devices if isinstance(one, SerialLaser)), "")
        source.close()
    heard.troubles = [str(notice.why) for notice in source.notices]
    return heard


def _stop_when_due(source: Source, deadline_s: float) -> None:
    if time.monotonic() > deadline_s:
        source.close()


def _look(heard: Heard, frame: StereoFrame) -> None:
    heard.size = frame.left.shape[1], frame.left.shape[0]
    if not heard.frame_bytes:
        images = frame.encoded or (encode_png(frame.left), encode_png(frame.right))
        heard.frame_bytes = sum(map(len, images))
    heard.frames_ns.append(frame.t_ns)
    heard.left.look(frame.left)
    heard.right.look(frame.right)


def _rate(stamps_ns: list[int]) -> float | None:
    """The usual rate, Hz: of the median interval."""
    if len(stamps_ns) < 3:
        return None
    interval_ns = float(np.median(np.diff(stamps_ns)))
    return NS_PER_S / interval_ns if interval_ns > 0 else None
