"""Compare detectors on the clips of robosub_transdec_dataset that the shipped model's training keeps apart.

    python tools/compare_detectors.py --robosub DIR [--rendered DIR] [--work DIR] [--svg curves.svg] NAME=MODEL.onnx ...

One row a model and set: AP50, AP50-95, precision and recall at 0.3 and 0.5, on all those images and on those where a
look found every buoy labelled; on the approaches of the rendered dives; on 200 simulated pictures of another seed than
the training's, kept in ``--work``. ``--svg`` draws the precision-recall curves of the real images.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np
from train_shipped_model import simulated

from leadline.evaluation.detection import RECALLS, DetectionQuality, evaluate_detections
from leadline.evaluation.svg import INK, Curve, chart
from leadline.recognition.detector import Detector
from leadline.training.dataset import Example, read_dataset, split_by_numbers

CLIPS = json.loads(Path(__file__).with_name("robosub_clips.json").read_text())
LEAST_SCORE = 0.02
COLOURS = ("water", "air", "red", "green", "grey")


def quality(model: str, examples: list[Example]) -> DetectionQuality:
    detector = Detector(model, score=LEAST_SCORE, threads=1)
    found = {str(e.image): detector.detect(np.asarray(cv2.imread(str(e.image)), np.uint8)) for e in examples}
    truth = {str(e.image): [(a - 0.5, b - 0.5, c - a, d - b) for a, b, c, d in e.boxes.tolist()] for e in examples}
    return evaluate_detections(found, truth)


def rendered(root: Path) -> list[Example]:
    """Both cameras' images of both approaches, with the true boxes."""
    out = []
    for folder in (root / "approach_ball_clear", root / "approach_ball_turbid"):
        for frame in json.loads((folder / "truth.json").read_text())["frames"]:
            for side in ("left", "right"):
                box = np.array([frame[f"bbox_{side}_px"]], np.float32)
                out.append(Example(folder / frame[side], box, np.zeros(1, np.int64)))
    return out


def row(name: str, q: DetectionQuality) -> str:
    points = " | ".join(f"{p:.2f}, {r:.2f}" for p, r in (q.at_score(0.3), q.at_score(0.5)))
    return f"| {name} | {q.images} | {q.ap50:.3f} | {q.ap50_95:.3f} | {points} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robosub", type=Path, required=True)
    parser.add_argument("--rendered", type=Path, help="folder of the rendered dives")
    parser.add_argument("--work", type=Path, help="where the simulated pictures are kept")
    parser.add_argument("--svg", type=Path)
    parser.add_argument("models", nargs="+", metavar="NAME=MODEL")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    _, held = split_by_numbers(read_dataset(options.robosub, classes="ball=buoy_*").examples, CLIPS["held_out"])
    unlabelled = set(CLIPS["held_out_with_unlabelled_buoys"])
    complete = [e for e in held if int(e.image.stem) not in unlabelled]
    sets = {"all": held, "complete": complete}
    if options.rendered:
        sets["rendered"] = rendered(options.rendered)
    if options.work:
        sets["simulated"] = simulated(options.work / "simulated-test", 200, seed=77)
    curves = []
    for (name, model), colour in zip((m.split("=", 1) for m in options.models), COLOURS, strict=False):
        for part, examples in sets.items():
            q = quality(model, examples)
            print(row(f"{name}, {part}", q), flush=True)
            told = f"{name}, {part} ({q.ap50:.3f})"
            if part in ("all", "complete"):
                curves.append(Curve(told, RECALLS, q.curves[0], INK[colour], part == "complete"))
    if options.svg:
        options.svg.write_text(
            chart([], "recall", "precision, IoU 0.5", "Precision and recall", (760, 360), curves=curves)
        )


if __name__ == "__main__":
    main()
