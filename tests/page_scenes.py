"""A page with a dive whose solutions are made up: cheap, at any pace, and without a localizer."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from leadline.guidance import Guide
from leadline.health import Condition, Part, State
from leadline.rig import Rig
from leadline.samples import Detection, Image, Kind, LaserRange, Solution, Stage, Status, StereoFrame, Truth
from leadline.sinks.control import Control
from leadline.sinks.web import WebSink
from leadline.sinks.web_access import Place
from leadline.sinks.web_server import PageServer
from leadline.target import Sphere

RADIUS_M = 0.17
ANYWHERE = Place(port=0)
RATE_HZ, LENGTH_S = 15.0, 12.0


def small_rig() -> Rig:
    rig = Rig.load("rendered")
    return rig.scaled(320 / rig.left.width)


def range_at(t_s: float) -> float:
    """From 2 m to 0.15 m."""
    return 0.15 + 1.85 * max(1 - t_s / LENGTH_S, 0.0)


def truth() -> list[Truth]:
    stamps = np.arange(0, LENGTH_S, 1 / RATE_HZ)
    return [Truth(round(t * 1e9), (0.0, 0.0, range_at(t) + RADIUS_M), range_at(t)) for t in stamps]


def solution_at(t_s: float) -> Solution:
    t_ns, range_m = round(t_s * 1e9), range_at(t_s)
    if t_s < 1:
        return Solution(t_ns, Stage.SEARCHING, Status.LOST)
    stage = Stage.BINOCULAR if range_m > 1.2 else Stage.BOTH if range_m > 0.5 else Stage.LASER
    position_m = np.array([0.05, -0.03, 1.0]) * (range_m + RADIUS_M)
    sigma_m = 0.002 + 0.01 * range_m**2
    cov_m2 = np.diag([0.2, 0.2, 1.0]) * sigma_m**2
    velocity = np.array([0.0, 0.0, -1.85 / LENGTH_S])
    return Solution(t_ns, stage, Status.VALID, position_m, cov_m2, range_m, sigma_m, velocity, (Kind.STEREO, Kind.SPOT))


def frame_at(rig: Rig, t_s: float, ground: Image) -> tuple[StereoFrame, Detection]:
    distance_m = range_at(t_s) + RADIUS_M
    centres = rig.project(np.array([[0.05, -0.03, 1.0]]) * distance_m)
    radius_px = rig.focal_outside_px * RADIUS_M / distance_m
    images = []
    for centre in centres:
        image = ground.copy()
        cv2.circle(image, tuple(int(v) for v in centre[0]), int(radius_px), (40, 130, 200), -1)
        images.append(image)
    x, y = centres[0][0]
    box = (float(x - radius_px), float(y - radius_px), 2 * radius_px, 2 * radius_px)
    return StereoFrame(round(t_s * 1e9), images[0], images[1]), Detection(box, 0.93, "ball")


class Scene:
    """Feeds a sink at its own pace from a thread until its end."""

    def __init__(self, *, length_s: float = LENGTH_S, rate_hz: float = RATE_HZ, rig: Rig | None = None) -> None:
        self.rig = rig or small_rig()
        self.control = Control()
        self.sink = WebSink("made-up", self.rig, Sphere(2 * RADIUS_M), Guide(self.rig), self.control, truth())
        self._stamps = np.arange(0, length_s, 1 / rate_hz)
        height, width = self.rig.left.height, self.rig.left.width
        self._ground = np.random.default_rng(0).integers(60, 120, (height, width, 3), dtype=np.uint8)
        self._stopped = threading.Event()
        self.slowest_s = 0.0  # that the sink held up its caller
        self.thread = threading.Thread(target=self._run, daemon=True)

    def stop(self) -> None:
        self._stopped.set()
        self.thread.join()

    def _run(self) -> None:
        start_s = time.monotonic()
        for t_s in self._stamps:
            if self._stopped.wait(max(start_s + t_s - time.monotonic(), 0)):
                return
            self.step(float(t_s))
        self.sink.ended(["All is said."])

    def step(self, t_s: float) -> None:
        frame, box = frame_at(self.rig, t_s, self._ground)
        assert self.rig.laser is not None
        lit_m = self.rig.laser.raw_m(range_at(t_s))
        begin_s = time.perf_counter()
        self.sink.sample(LaserRange(frame.t_ns - 1000, lit_m))
        self.sink.sample(frame)
        self.sink.detections(frame, [box] if t_s >= 1 else [])
        self.sink.solution(solution_at(t_s))
        self.sink.health(conditions(t_s), frame.t_ns)
        self.slowest_s = max(self.slowest_s, time.perf_counter() - begin_s)


def conditions(t_s: float) -> list[Condition]:
    bad = 4 < t_s < 7
    laser = Condition(
        Part.LASER, State.OFF, 4 * 10**9, "nothing for 0.5 s", "check its power, cable, port and baud rate"
    )
    fine = [Condition(part, State.OK, 0) for part in Part if part is not Part.LASER or not bad]
    return [*fine, laser] if bad else fine


@contextmanager
def served(
    scene: Scene, *, place: Place = ANYWHERE, token: str | None = None, files: tuple[Path, ...] = ()
) -> Iterator[PageServer]:
    server = PageServer(scene.sink, place, token, lambda: files)
    server.start()
    scene.thread.start()
    try:
        yield server
    finally:
        server.close()
        scene.stop()
