"""Detection beside Ultralytics' own predict: the same images, the same size, pre- and post-processing included.

python -m benchmarks.detector IMAGES... [--peer PYTHON --weights yolov8n.pt] [--model M.onnx] [--threads 2]

PYTHON has ultralytics; it answers image by image, so that both take turns. Times are of the processor, of all threads
(a machine that others use too slows both alike), and of the clock.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import perf_counter, process_time

import cv2
import numpy as np

from leadline.recognition.detector import Detector
from leadline.samples import Image

ROUNDS = 50
PEER = """
import os, sys
os.environ.update(YOLO_OFFLINE="true", YOLO_AUTOINSTALL="false")
import torch
if not hasattr(torch.ops.torchvision, "nms"):  # no torchvision for this torch: predict suppresses without it
    library = torch.library.Library("torchvision", "DEF")
    library.define("nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
    own = torch.library.register_fake
    def register_fake(name, *rest, **more):
        return (lambda f: f) if str(name).startswith("torchvision") else own(name, *rest, **more)
    torch.library.register_fake = register_fake
import cv2
from time import perf_counter, process_time
from ultralytics import YOLO
weights, threads, size = sys.argv[1], int(sys.argv[2]), eval(sys.argv[3])
model, images = YOLO(weights), [cv2.imread(name) for name in sys.argv[4:]]
images = [cv2.resize(image, (size[1], size[0])) for image in images]
def predict(image):
    torch.set_num_threads(threads)
    cv2.setNumThreads(threads)
    return model.predict(image, imgsz=size, conf=0.3, iou=0.5, verbose=False)
predict(images[0])
torch.set_num_threads(threads)
print("ready", flush=True)
for line in sys.stdin:
    image = images[int(line) % len(images)]
    wall, used = perf_counter(), process_time()
    predict(image)
    print(process_time() - used, perf_counter() - wall, flush=True)
"""

Timer = Callable[[int], tuple[float, float]]  # number of the round -> processor's seconds, the clock's


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", nargs="+", type=Path)
    parser.add_argument("--peer")
    parser.add_argument("--weights", default="yolov8n.yaml")
    parser.add_argument("--model", type=Path, help="also this one, beside the shipped one")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--size", default="640x480")
    told = parser.parse_args()
    width, height = (int(n) for n in told.size.split("x"))
    cv2.setNumThreads(told.threads)
    images = [np.asarray(cv2.resize(_read(name), (width, height)), np.uint8) for name in told.images]
    timers = {
        "shipped": ours(Detector(threads=told.threads), images),
        f"shipped at {max(width, height)} px": ours(
            Detector(threads=told.threads, long_side_px=max(width, height)), images
        ),
    }
    if told.model:
        timers[told.model.name] = ours(
            Detector(told.model, threads=told.threads, long_side_px=max(width, height)), images
        )
    if told.peer:
        timers["predict"] = theirs(told.peer, told.weights, told.threads, (height, width), told.images)
    report(timers)


def _read(name: Path) -> Image:
    image = cv2.imread(str(name))
    if image is None:
        sys.exit(f"{name}: not a readable image")
    return np.asarray(image, np.uint8)


def ours(detector: Detector, images: list[Image]) -> Timer:
    def once(k: int) -> tuple[float, float]:
        wall, used = perf_counter(), process_time()
        detector.detect(images[k % len(images)])
        return process_time() - used, perf_counter() - wall

    return once


def theirs(python: str, weights: str, threads: int, size: tuple[int, int], files: list[Path]) -> Timer:
    command = [python, "-c", PEER, weights, str(threads), str(size), *map(str, files)]
    environment = {**os.environ, "OMP_NUM_THREADS": str(threads)}
    peer = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment)
    assert peer.stdin is not None
    assert peer.stdout is not None
    while (line := peer.stdout.readline()) != "ready\n":
        if not line:
            sys.exit(f"{python} ended: has it ultralytics?")

    def once(k: int) -> tuple[float, float]:
        assert peer.stdin is not None
        assert peer.stdout is not None
        peer.stdin.write(f"{k}\n")
        peer.stdin.flush()
        used, wall = (float(part) for part in peer.stdout.readline().split())
        return used, wall

    return once


def report(timers: dict[str, Timer]) -> None:
    """Medians over rounds taken in turn, after three that are not counted."""
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in timers}
    for k in range(-3, ROUNDS):
        for name, timer in timers.items():
            one = timer(k % 1000)
            if k >= 0:
                taken[name].append(one)
    last = list(taken)[-1]
    base = median(used for used, _ in taken[last])
    for name, times in taken.items():
        used, wall = (1e3 * median(column) for column in zip(*times, strict=True))
        ratio = used / 1e3 / base
        print(f"{name:24s} processor {used:7.1f} ms, clock {wall:7.1f} ms, {ratio:.2f} of {last}", flush=True)


if __name__ == "__main__":
    main()
