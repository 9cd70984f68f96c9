"""A program that records until it is killed, as often as it is asked: one path a line in, one process id a line out.

Forked from here, a recorder costs no imports. Beside PATH stands PATH.stamp: the stamp of the last sample handed over.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

import numpy as np

from leadline.samples import Detection, LaserRange, Solution, Stage, Status, StereoFrame
from leadline.sinks import McapSink, SolutionsCsv
from leadline.wire.images import encode_png

FPS = 15


def record(path: Path) -> None:
    rng = np.random.default_rng(0)
    pictures = [rng.integers(0, 256, (24, 32), dtype=np.uint8) for _ in range(4)]
    images = [(picture, encode_png(picture)) for picture in pictures]
    stamp = os.open(f"{path}.stamp", os.O_WRONLY | os.O_CREAT)
    sink, table = McapSink(path), SolutionsCsv(path.with_suffix(".csv"))
    start_ns = time.time_ns()
    for number in range(10_000):
        due_ns = start_ns + number * 1_000_000_000 // FPS
        time.sleep(max(0.0, (due_ns - time.time_ns()) / 1e9))
        now_ns = time.time_ns()
        os.pwrite(stamp, now_ns.to_bytes(8, "little"), 0)
        if number % 5 == 0:
            sink.sample(LaserRange(now_ns, 2.0 + number))
        (left, left_bytes), (right, right_bytes) = images[number % 4], images[(number + 1) % 4]
        frame = StereoFrame(now_ns, left, right, encoded=(left_bytes, right_bytes))
        sink.sample(frame)
        sink.detections(frame, [Detection((1.0, 2.0, 3.0, 4.0), 0.5)])
        solution = Solution(now_ns, Stage.SEARCHING, Status.LOST)
        for each in (sink, table):
            each.solution(solution)


def main() -> None:
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for the dead
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            try:
                record(Path(line.strip()))
            finally:
                os._exit(1)
        sys.stdout.write(f"{child}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
