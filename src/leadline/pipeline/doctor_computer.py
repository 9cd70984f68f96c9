"""What the doctor asks of the computer itself: disk, clock, speed, what is installed, what is plugged in."""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib.util
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

EXTRAS = {
    "live": ("serial", "starlette", "uvicorn", "websockets"),
    "mavlink": ("pymavlink",),
    "train": ("torch", "onnx", "onnxscript"),
    "ros2": ("rclpy",),
}
NEEDED_FOR = {
    "live": "a laser on a serial line and the live page",
    "mavlink": "an autopilot",
    "train": "training a detector",
    "ros2": "ROS 2 topics",
}
BLOCK_BYTES, BLOCKS = 2**20, 24
_TIME_ERROR = 5  # adjtimex(2): the clock is not synchronised
_STEPS = 8


@dataclass(frozen=True, slots=True)
class Disk:
    free_bytes: int
    write_bytes_s: float  # with the sync that makes it safe
    sync_s: float  # of a small change


def measure_disk(folder: Path) -> Disk:
    """Writes and removes 24 MiB in the folder, or where it is going to be. Raises OSError."""
    while not folder.is_dir():
        folder = folder.parent
    data = os.urandom(BLOCK_BYTES)
    with tempfile.TemporaryFile(dir=folder) as file:
        start_s = time.perf_counter()
        for _ in range(BLOCKS):
            file.write(data)
        file.flush()
        os.fsync(file.fileno())
        took_s = time.perf_counter() - start_s
        syncs = []
        for _ in range(5):
            start_s = time.perf_counter()
            file.write(b"x" * 4096)
            file.flush()
            os.fsync(file.fileno())
            syncs.append(time.perf_counter() - start_s)
    return Disk(shutil.disk_usage(folder).free, BLOCKS * BLOCK_BYTES / took_s, median(syncs))


class ClockWatch:
    """Made at the beginning; afterwards it says by how much somebody has set the clock meanwhile."""

    def __init__(self) -> None:
        self._apart_s = time.time() - time.monotonic()

    def jump_s(self) -> float:
        return time.time() - time.monotonic() - self._apart_s


def clock_is_synchronised() -> bool | None:
    """As the kernel says; None where it cannot be asked."""
    libc = ctypes.CDLL(ctypes.util.find_library("c") or None)
    if not hasattr(libc, "adjtimex"):
        return None
    answer = int(libc.adjtimex(ctypes.create_string_buffer(1024)))  # all zero: only asks
    return None if answer < 0 else answer != _TIME_ERROR


def typical_s(work: Callable[[], object], times: int) -> float:
    """Median duration, after one call to warm up."""
    work()
    took = []
    for _ in range(times):
        start_s = time.perf_counter()
        work()
        took.append(time.perf_counter() - start_s)
    return median(took)


def step_s() -> float:
    """What a step of the localizer takes with the shipped detector, median, in a simulated dive."""
    from leadline.pipeline.build import build_job  # noqa: PLC0415  slow to import
    from leadline.samples import StereoFrame  # noqa: PLC0415

    job = build_job("sim:demo")
    localizer = job.methods["fused"]
    took: list[float] = []
    for sample in job.source:
        start_s = time.perf_counter()
        localizer.step(sample)
        if isinstance(sample, StereoFrame):
            took.append(time.perf_counter() - start_s)
        if len(took) > _STEPS:
            break
    return median(took[1:])


def missing(modules: Sequence[str]) -> list[str]:
    return [name for name in modules if importlib.util.find_spec(name) is None]


def devices() -> tuple[list[str], list[str]]:
    """Cameras and serial lines that the system shows (Linux)."""
    cameras = sorted(str(path) for path in Path("/dev").glob("video*"))
    ports = [path for kind in ("ttyUSB*", "ttyACM*") for path in sorted(map(str, Path("/dev").glob(kind)))]
    return cameras, ports
