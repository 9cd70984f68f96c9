"""Is everything ready for a dive? One finding for each part: good, doubtful or bad, in plain words, and what to do."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from leadline.config import Config
from leadline.errors import InputError
from leadline.pipeline import doctor_computer as computer
from leadline.pipeline.doctor_devices import Heard, listen
from leadline.rig import Rig

FPS = 15.0  # wanted where nobody says otherwise
OLD_RIG_DAYS = 180
REPROJECTION_PX = 0.5
LEAST_MINUTES = 30.0
ASSUMED_FRAME_BYTES = 3_000_000  # a pair of 1280x720 as PNG
SLOW_SYNC_S = 0.5
JUMP_S = 0.05


class Level(StrEnum):
    OK = "ok"
    WARN = "warn"
    FAIL = "fail"


@dataclass(frozen=True, slots=True)
class Finding:
    part: str
    level: Level
    said: str
    advice: str = ""


def ok(part: str, said: str) -> Finding:
    return Finding(part, Level.OK, said)


def warn(part: str, said: str, advice: str) -> Finding:
    return Finding(part, Level.WARN, said, advice)


def fail(part: str, said: str, advice: str) -> Finding:
    return Finding(part, Level.FAIL, said, advice)


def examine(
    source: str | None,
    rig_file: str | None,
    out: Path,
    *,
    model: Path | None = None,
    fps: float | None = None,
    config: Config | None = None,
    seconds: float = 4.0,
) -> Iterator[Finding]:
    """The findings as they come; a check that breaks is a finding too. source None: nothing is connected."""
    clock = computer.ClockWatch()
    heard: Heard | None = None
    if source is None:
        yield from _around()
    else:
        try:
            heard = listen(source, seconds)
        except InputError as error:
            yield fail("source", str(error), "see `leadline run --help` for what a source can be")
        else:
            yield from _cameras(heard, fps)
            yield from _laser(heard)
    rig, findings = _rig(rig_file, heard)
    yield from findings
    wanted_hz = fps or (heard.frame_rate_hz if heard and heard.frame_rate_hz else FPS)
    yield from _guarded("disk", lambda: _disk(out, heard, wanted_hz))
    yield from _guarded("model", lambda: _model(model, config or Config(), rig, wanted_hz))
    yield from _guarded("speed", lambda: _speed(wanted_hz))
    yield from _guarded("clock", lambda: _clock(clock))
    yield from _extras(source)


def _guarded(part: str, check: Callable[[], Iterator[Finding]]) -> list[Finding]:
    try:
        return list(check())
    except InputError as error:
        return [fail(part, str(error), error.fix or "mend that first")]
    except OSError as error:
        return [fail(part, f"{error}", "mend that first")]


def _around() -> Iterator[Finding]:
    """What seems to be connected, when nobody says what to look at."""
    cameras, ports = computer.devices()
    advice = "connect it, or say which: leadline doctor uvc:0+serial:/dev/ttyUSB0"
    if cameras:
        yield ok("cameras", f"{', '.join(cameras)} found; to test them: leadline doctor uvc:0")
    else:
        yield warn("cameras", "no camera found", advice)
    if ports:
        yield ok("laser", f"{', '.join(ports)} found; to test it: leadline doctor serial:{ports[0]}")
    else:
        yield warn("laser", "no serial line found", advice)


def _cameras(heard: Heard, fps: float | None) -> Iterator[Finding]:
    if not heard.has_cameras and not heard.frames:
        yield warn("cameras", "none in this source", "add one: uvc:0+serial:/dev/ttyUSB0")
        return
    if not heard.frames:
        why = heard.troubles[0] if heard.troubles else f"no image in {heard.seconds:.0f} s"
        yield fail("cameras", why, "check cable, power and number of the camera (uvc:0, uvc:1, ...)")
        return
    width, height = heard.size
    said = f"{heard.frames} frames of {width}x{height}"
    if heard.frame_rate_hz is not None:
        said += f", {heard.frame_rate_hz:.1f} a second"
    if fps is not None and heard.frame_rate_hz is not None and heard.frame_rate_hz < 0.8 * fps:
        yield warn("cameras", f"{said}; {fps:g} are wanted", "fix the exposure, or lower the resolution")
    else:
        yield ok("cameras", said)
    for side, picture in (("left", heard.left), ("right", heard.right)):
        yield _picture(side, picture.mean, picture.saturated, picture.frozen and heard.live)


def _picture(side: str, mean: float, saturated: float, frozen: bool) -> Finding:
    part, said = f"{side} image", f"mean brightness {mean:.0f} of 255, {100 * saturated:.0f} % saturated"
    if frozen:
        return fail(part, "every image is the same", "unplug the camera and plug it in again")
    if mean < 8:
        return fail(part, f"black: {said}", "take the lens cap off, switch the lights on, lengthen the exposure")
    if mean < 25:
        return warn(part, f"dark: {said}", "more light, or a longer exposure (exposure=10)")
    if saturated > 0.2 or mean > 230:
        return warn(part, f"too bright: {said}", "a shorter exposure (exposure=2), or less light")
    return ok(part, said)


def _laser(heard: Heard) -> Iterator[Finding]:
    if not heard.has_laser and not heard.readings:
        yield warn("laser", "none in this source", "add one: uvc:0+serial:/dev/ttyUSB0")
    elif not heard.readings:
        why = heard.troubles[-1] if heard.troubles else f"no reading in {heard.seconds:.0f} s"
        yield fail(
            "laser", why, "check power, port, baud rate and protocol; is it switched on, and does it see a target?"
        )
    else:
        low, high = heard.range_m
        by = f", protocol {heard.protocol}" if heard.protocol else ""
        rate = "" if heard.reading_rate_hz is None else f", {heard.reading_rate_hz:.1f} a second"
        yield ok("laser", f"{heard.readings} readings{rate}, {low:.3f} to {high:.3f} m{by}")


def _rig(rig_file: str | None, heard: Heard | None) -> tuple[Rig | None, list[Finding]]:
    if rig_file is None and (heard is None or heard.rig is None):
        return None, [warn("rig", "none given", "give --rig rig.yaml; `leadline calibrate` makes one")]
    try:
        rig = Rig.load(rig_file) if rig_file is not None else heard.rig if heard else None
    except InputError as error:
        return None, [fail("rig", str(error), "give a rig that `leadline calibrate` wrote")]
    assert rig is not None
    return rig, [*_rig_age(rig), *_rig_fit(rig), *_rig_size(rig, heard)]


def _rig_age(rig: Rig) -> Iterator[Finding]:
    date = rig.provenance.get("date")
    try:
        made = datetime.datetime.fromisoformat(str(date))
    except ValueError:
        yield warn(
            "rig age", "it does not say when it was calibrated", "calibrate, or check it: leadline calibrate check"
        )
        return
    now = datetime.datetime.now(made.tzinfo)
    days = (now - made).total_seconds() / 86400
    if days < -1:
        yield warn("rig age", f"calibrated on {made:%Y-%m-%d}, which is to come", "set the computer's clock")
    elif days > OLD_RIG_DAYS:
        yield warn("rig age", f"{days:.0f} days old", "check it before the dive: leadline calibrate check")
    else:
        yield ok("rig age", f"calibrated on {made:%Y-%m-%d}, {max(days, 0):.0f} days ago")


def _rig_fit(rig: Rig) -> Iterator[Finding]:
    rms = dict(_residuals(rig.provenance))
    if not rms:
        yield warn("rig fit", "it does not say how well it fits", "check it: leadline calibrate check")
        return
    said = ", ".join(f"{name} {value:.2f} px" for name, value in rms.items())
    if max(rms.values()) > REPROJECTION_PX:
        yield warn("rig fit", said, "calibrate again with sharper images, or check it: leadline calibrate check")
    else:
        yield ok("rig fit", said)


def _residuals(provenance: object, name: str = "") -> Iterator[tuple[str, float]]:
    """All numbers of pixels whose name says rms."""
    if not hasattr(provenance, "items"):
        return
    for key, value in provenance.items():
        if isinstance(value, int | float) and "rms" in str(key) and "px" in str(key):
            yield f"{name}{key}".replace("_", " ").replace(" px", ""), float(value)
        else:
            yield from _residuals(value, f"{key} ")


def _rig_size(rig: Rig, heard: Heard | None) -> Iterator[Finding]:
    size = rig.left.width, rig.left.height
    if heard is not None and heard.frames and heard.size != size:
        said = f"it is for {size[0]}x{size[1]}, the camera gives {heard.size[0]}x{heard.size[1]}"
        yield fail("rig size", said, "set the camera's size (uvc:0?size=...), or give the rig calibrated at this size")
    else:
        yield ok("rig size", f"{size[0]}x{size[1]}, baseline {1000 * rig.baseline_m:.1f} mm")


def _disk(out: Path, heard: Heard | None, wanted_hz: float) -> Iterator[Finding]:
    disk = computer.measure_disk(out)
    known = heard.frame_bytes if heard is not None else 0
    rate = (known or ASSUMED_FRAME_BYTES) * wanted_hz
    minutes = disk.free_bytes / rate / 60
    said = f"room for {minutes:.0f} minutes at {rate / 1e6:.0f} MB/s ({disk.free_bytes / 1e9:.0f} GB free)"
    advice = "make room, or record to another disk (--out)"
    yield ok("disk room", said) if minutes >= LEAST_MINUTES else warn("disk room", said, advice)
    speed = f"writes {disk.write_bytes_s / 1e6:.0f} MB/s, a sync takes {1000 * disk.sync_s:.0f} ms"
    if disk.write_bytes_s < 1.5 * rate:
        level = Level.FAIL if known and disk.write_bytes_s < rate else Level.WARN
        needs = f"recording needs {rate / 1e6:.0f} MB/s" + ("" if known else " if a pair of images is 3 MB")
        yield Finding("disk speed", level, f"{speed}; {needs}", "a faster disk, or fewer frames")
    elif disk.sync_s > SLOW_SYNC_S:
        yield warn("disk speed", speed, "a faster disk: a power cut would cost more than a second")
    else:
        yield ok("disk speed", speed)


def _model(path: Path | None, config: Config, rig: Rig | None, wanted_hz: float) -> Iterator[Finding]:
    from leadline.recognition.detector import Detector  # noqa: PLC0415  slow to import

    detector = Detector(path, **config.detector.model_dump())
    width, height = (1280, 720) if rig is None else (rig.left.width, rig.left.height)
    image = np.full((height, width, 3), 90, np.uint8)
    took_s = computer.typical_s(lambda: detector.detect(image), times=5)
    said = f"{path or 'the shipped one'} runs, {1000 * took_s:.0f} ms a frame"
    if took_s > 1 / wanted_hz:
        yield warn(
            "model", f"{said}; {wanted_hz:.0f} frames a second leave {1000 / wanted_hz:.0f} ms", "a smaller model"
        )
    else:
        yield ok("model", said)


def _speed(wanted_hz: float) -> Iterator[Finding]:
    took_s = computer.step_s()
    said = f"a step takes {1000 * took_s:.0f} ms: {1 / took_s:.0f} frames a second"
    if took_s * wanted_hz > 1:
        yield warn("speed", f"{said}; {wanted_hz:.0f} are wanted", "close other programs, or lower the frame rate")
    else:
        yield ok("speed", said)


def _clock(clock: computer.ClockWatch) -> Iterator[Finding]:
    jump_s, synchronised = clock.jump_s(), computer.clock_is_synchronised()
    if abs(jump_s) > JUMP_S:
        yield warn("clock", f"it was set by {jump_s:+.2f} s meanwhile", "let it settle before the dive")
    elif synchronised is False:
        advice = "synchronise it (chrony) if recordings are to be compared with other devices'"
        yield warn("clock", "not synchronised", advice)
    else:
        yield ok("clock", "synchronised" if synchronised else "steady; whether it is synchronised is not known here")


def _extras(source: str | None) -> Iterator[Finding]:
    for extra, modules in computer.EXTRAS.items():
        missing = computer.missing(modules)
        install = f"pip install 'leadline[{extra}]'" if extra != "ros2" else "source the robot's ROS 2 setup"
        if not missing:
            yield ok(f"extra {extra}", "installed")
        elif extra == "live" and source is not None and "serial:" in source:
            yield fail(f"extra {extra}", f"{', '.join(missing)} missing", install)
        else:
            yield ok(f"extra {extra}", f"not installed (needed for {computer.NEEDED_FOR[extra]}: {install})")


def worst(findings: Sequence[Finding]) -> Level:
    levels = {finding.level for finding in findings}
    return Level.FAIL if Level.FAIL in levels else Level.WARN if Level.WARN in levels else Level.OK
