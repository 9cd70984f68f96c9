"""Projection through a flat port against ``cv2.projectPoints`` (which does no refraction), rays, triangulation."""

from __future__ import annotations

import cv2
import numpy as np

from benchmarks.side_by_side import seconds
from leadline.geometry import Camera
from leadline.rig import Rig

POINTS = 100_000
PROMISED = 1.5  # times cv2.projectPoints' points a second
STILL = np.zeros(3)


def scene(rig: Rig, count: int) -> np.ndarray:
    """Points (count, 3) all over the left image, 0.2 to 2.2 m away along their rays."""
    rng = np.random.default_rng(0)
    pixels = rng.uniform((0, 0), (rig.left.width - 1, rig.left.height - 1), (count, 2))
    origins, directions = rig.rays(pixels)
    return np.asarray(origins + directions * rng.uniform(0.2, 2.2, (count, 1)))


def compare(rig: Rig, label: str) -> bool:
    port, lens = rig.port, rig.left
    assert port is not None
    points = scene(rig, POINTS)
    pixels = port.project(lens, points)
    distortion = np.array(lens.distortion or (0.0,) * 4)
    output = cv2.projectPoints(points, STILL, STILL, lens.matrix, distortion)  # given back to it: it need not allocate
    took = seconds(
        {
            "cv2.projectPoints": lambda: cv2.projectPoints(points, STILL, STILL, lens.matrix, distortion, *output),
            "port.project": lambda: port.project(lens, points),
            "port.project_with_jacobian": lambda: port.project_with_jacobian(lens, points),
            "port.rays": lambda: port.rays(lens, pixels),
        }
    )
    reference = took["cv2.projectPoints"]
    print(f"\n{label}: {POINTS} points, one thread, median of interleaved rounds")
    for name, s in took.items():
        print(f"  {name:28s} {POINTS / s / 1e6:6.2f} Mpoint/s   {reference / s:5.2f} x cv2.projectPoints")
    return reference / took["port.project"] >= PROMISED


def triangulation(rig: Rig) -> None:
    count = 10_000
    left, right = rig.project(scene(rig, count))
    took = seconds({"triangulate": lambda: rig.triangulate(left, right)}, rounds=5)["triangulate"]
    one = seconds({"one": lambda: rig.triangulate(left[:1], right[:1])}, rounds=50)["one"]
    print(f"\nrig.triangulate with covariance: {count / took / 1e6:.3f} Mpoint/s; a single point {one * 1e3:.2f} ms")


def main() -> bool:
    """True where the promised ratio is kept with and without lens distortion."""
    cv2.setNumThreads(1)
    straight = Rig.load("rendered")
    five = Camera(1400.0, 1400.0, 940.0, 535.0, 1920, 1080, (-0.1656, 0.0012, 2e-4, -1e-4, 0.001))
    bent = Rig(five, five, straight.T_right_left, straight.port, straight.water)
    kept = [compare(straight, "no lens distortion"), compare(bent, "five distortion coefficients")]
    triangulation(straight)
    print(f"\npromised: port.project at least {PROMISED} x cv2.projectPoints: {'kept' if all(kept) else 'MISSED'}")
    return all(kept)
