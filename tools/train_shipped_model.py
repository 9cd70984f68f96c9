"""Reproduce the detector that leadline ships: balls and buoys, from simulated and real pictures.

    python tools/train_shipped_model.py --robosub DIR --work DIR --out first.onnx --steps 1000
    python tools/train_shipped_model.py --robosub DIR --work DIR --out balls.onnx --steps 1500 --start DIR/first.pt

The simulated pictures are kept in --work. The second call looks for unlabelled buoys in the real training pictures with
the first model, so that nothing is taught there, and trains on.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import cv2
import numpy as np
import torch

from leadline.recognition.detector import Detector
from leadline.recognition.track import iou
from leadline.simulation.pictures import random_picture
from leadline.training.dataset import Example, read_voc, split_by_numbers
from leadline.training.export import export_onnx
from leadline.training.network import Network
from leadline.training.train import Pool, Settings, train

# Whole clips of robosub_transdec_dataset (file numbers, both ends in) that no training has seen; about a fifth.
HELD_OUT = ((64, 73), (234, 266), (312, 329), (632, 643), (745, 758), (971, 982), (1190, 1213), (1465, 1480))
DRAWN = ((1500, 1713),)  # drawn pictures among them, not photographs
NAMES = ("ball",)
SIZES = ((272, 480), (320, 480), (320, 400), (360, 480))  # height, width of simulated pictures
# In these clips some buoys have no label; in the others every buoy has one, and what else looks like one (reflections
# on the surface, ballast) shall be learnt as none.
INCOMPLETE = ((21, 103), (522, 1499))
UNSURE_SCORE = 0.4
CLOSE_UP_PX = 150  # the lesser side of a box in a simulated picture, which is 272 to 360 px high
LONG_SIDE = 512


def simulated(folder: Path, count: int, seed: int) -> list[Example]:
    """``count`` simulated pictures with their boxes, written once."""
    labels = folder / "boxes.json"
    if not labels.exists():
        folder.mkdir(parents=True, exist_ok=True)
        rng = np.random.default_rng(seed)
        boxes = {}
        for k in range(count):
            image, found, _ = random_picture(rng, SIZES[int(rng.integers(len(SIZES)))])
            name = f"{k:05d}.jpg"
            cv2.imwrite(str(folder / name), image, [cv2.IMWRITE_JPEG_QUALITY, 95])
            boxes[name] = [[x, y, x + w, y + h] for x, y, w, h in found]
        labels.write_text(json.dumps(boxes))
    notes = json.loads(labels.read_text())
    return [
        Example(folder / name, np.array(b, np.float32).reshape(-1, 4), np.zeros(len(b), np.int64))
        for name, b in notes.items()
    ]


def close_ups(examples: list[Example]) -> list[Example]:
    """Those with a ball as large as the last metre of an approach shows it."""
    return [e for e in examples if len(e.boxes) and (e.boxes[:, 2:] - e.boxes[:, :2]).min(1).max() > CLOSE_UP_PX]


def with_unsure(examples: list[Example], model: Path) -> list[Example]:
    """Some buoys of the real set have no label: where ``model`` sees one, nothing is to be taught."""
    detector = Detector(model, score=UNSURE_SCORE)
    out, count = [], 0
    for example in examples:
        image = np.asarray(cv2.imread(str(example.image)), np.uint8)
        labelled = [(x0, y0, x1 - x0, y1 - y0) for x0, y0, x1, y1 in example.boxes.tolist()]
        extra = [
            [d.box_px[0], d.box_px[1], d.box_px[0] + d.box_px[2], d.box_px[1] + d.box_px[3]]
            for d in detector.detect(image)
            if max((iou(d.box_px, box) for box in labelled), default=0.0) < 0.1
        ]
        count += len(extra)
        boxes = np.concatenate([example.boxes, np.array(extra, np.float32).reshape(-1, 4)])
        out.append(Example(example.image, boxes, np.concatenate([example.classes, np.full(len(extra), -1)])))
    print(f"{count} places where nothing is taught")
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robosub", type=Path, required=True, help="folder with Images/ and Annotations/")
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--pictures", type=int, default=3500, help="simulated pictures")
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--start", type=Path, help="weights (.pt, its .onnx beside it) to continue from")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    made = simulated(options.work / "simulated", options.pictures, seed=1)
    real, held = split_by_numbers(read_voc(options.robosub, NAMES, prefix="buoy_"), (*HELD_OUT, *DRAWN))
    print(f"{len(made)} simulated, {len(real)} real, {len(held)} held out")
    if options.start:
        complete, incomplete = split_by_numbers(real, INCOMPLETE)
        real = complete + with_unsure(incomplete, options.start.with_suffix(".onnx"))
    settings = Settings(steps=options.steps, threads=options.threads)
    began = time.perf_counter()
    losses: list[float] = []

    def progress(step: int, loss: float) -> None:
        losses.append(loss)
        if step % 25 == 24:
            print(f"step {step + 1} loss {np.mean(losses[-25:]):.3f} {time.perf_counter() - began:.0f} s", flush=True)

    start = None
    if options.start:
        start = Network(len(NAMES))
        start.load_state_dict(torch.load(options.start))
    pools = [Pool(made, 0.4), Pool(close_ups(made), 0.25), Pool(real, 0.35)]
    network = train(pools, len(NAMES), settings, progress, start)
    torch.save(network.state_dict(), options.work / f"{options.out.stem}.pt")
    about = {
        "author": "the leadline project",
        "license": "Apache-2.0",
        "description": "Balls and round buoys under water",
        "data": f"{len(made)} simulated pictures; {len(real)} of robosub_transdec_dataset (MIT)",
        "settings": repr(settings),
    }
    export_onnx(network, options.out, NAMES, LONG_SIDE, about)


if __name__ == "__main__":
    main()
