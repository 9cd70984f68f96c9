"""Simulated pictures of one target, as a user's own dives would give them, labelled by the simulator."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

from leadline.samples import StereoFrame
from leadline.simulation.dive import SimulatedDive
from leadline.simulation.scenario import BackdropPart, CameraPart, LightPart, PathPart, Scenario, TargetPart


def dive(seed: int, frames: int, width: int = 480) -> SimulatedDive:
    """An approach to an orange ball from about 4 m to where it fills the view, through one of three waters, before one
    of three backdrops, in daylight or by lamps; the ball stands anywhere in the view."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(2.5, 4.0)
    return SimulatedDive(
        Scenario(
            target=TargetPart(contrast=float(rng.uniform(0.3, 1.2))),
            water=("clear", "green", "turbid")[int(rng.integers(3))],  # type: ignore[arg-type]
            backdrop=BackdropPart(
                kind=("pool", "floor", "open")[int(rng.integers(3))],  # type: ignore[arg-type]
                wall_m=float(rng.uniform(1, 4)),
                floor_m=float(rng.uniform(0.6, 2)),
                colour=tuple(float(v) for v in rng.uniform(0.15, 0.7, 3)),  # type: ignore[arg-type]
            ),
            light=LightPart(lamps=float(rng.uniform(0, 1)), caustics=float(rng.uniform(0, 0.5))),
            path=PathPart(
                start_m=start, end_m=0.3, speed_m_s=(start - 0.3) / (frames - 0.5), dwell_s=0,
                offset_m=(float(rng.uniform(-0.25, 0.25)), float(rng.uniform(-0.15, 0.15))),
                sway_m=(0.25, 0.12, 0.05), sway_s=4.0, attitude_deg=4.0,
            ),
            camera=CameraPart(image_width_px=width, rate_hz=1.0, exposure_s=float(rng.uniform(0, 0.02))),
        ),
        seed=seed,
    )  # fmt: skip


def write_dives(root: Path, seeds: range, frames: int) -> Path:
    """A COCO set of the left images of one dive for each seed, a folder each; what is not in view has no box."""
    images, notes = [], []
    for seed in seeds:
        simulated = dive(seed, frames)
        lefts = [sample.left for sample in simulated.samples() if isinstance(sample, StereoFrame)]
        (root / f"dive{seed}").mkdir(parents=True, exist_ok=True)
        for k, (image, truth) in enumerate(zip(lefts, simulated.details["frames"], strict=True)):
            name = f"dive{seed}/left_{k:03d}.jpg"
            cv2.imwrite(str(root / name), image, [cv2.IMWRITE_JPEG_QUALITY, 92])
            images.append({"id": len(images), "file_name": name, "width": image.shape[1], "height": image.shape[0]})
            x0, y0, x1, y1 = truth["box_left_px"] or (0, 0, 0, 0)
            if min(x1 - x0, y1 - y0) >= 4:
                box = [x0, y0, x1 - x0, y1 - y0]
                notes.append({"id": len(notes), "image_id": images[-1]["id"], "category_id": 1, "bbox": box})
    data = {"images": images, "annotations": notes, "categories": [{"id": 1, "name": "ball"}]}
    (root / "annotations.json").write_text(json.dumps(data))
    return root
