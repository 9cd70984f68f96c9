"""Compare detectors on the clips of robosub_transdec_dataset that the shipped model's training keeps apart.

    python tools/compare_detectors.py --robosub DIR [--svg curves.svg] NAME=MODEL.onnx ...

One row a model: AP50, AP50-95, precision and recall at 0.3 and 0.5, on all those images and on those where a look found
every buoy labelled; ``--svg`` draws the precision-recall curves.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np

from leadline.evaluation.detection import RECALLS, DetectionQuality, evaluate_detections
from leadline.evaluation.svg import INK, Curve, chart
from leadline.recognition.detector import Detector
from leadline.training.dataset import Example, read_dataset, split_by_numbers

CLIPS = json.loads(Path(__file__).with_name("robosub_clips.json").read_text())
LEAST_SCORE = 0.02
COLOURS = ("water", "air", "red", "green", "grey")


def quality(model: str, examples: list[Example]) -> DetectionQuality:
    detector = Detector(model, score=LEAST_SCORE, threads=1)
    found = {e.image.name: detector.detect(np.asarray(cv2.imread(str(e.image)), np.uint8)) for e in examples}
    truth = {e.image.name: [(a - 0.5, b - 0.5, c - a, d - b) for a, b, c, d in e.boxes.tolist()] for e in examples}
    return evaluate_detections(found, truth)


def row(name: str, q: DetectionQuality) -> str:
    points = " | ".join(f"{p:.2f}, {r:.2f}" for p, r in (q.at_score(0.3), q.at_score(0.5)))
    return f"| {name} | {q.images} | {q.ap50:.3f} | {q.ap50_95:.3f} | {points} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robosub", type=Path, required=True)
    parser.add_argument("--svg", type=Path)
    parser.add_argument("models", nargs="+", metavar="NAME=MODEL")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    _, held = split_by_numbers(read_dataset(options.robosub, classes="ball=buoy_*").examples, CLIPS["held_out"])
    unlabelled = set(CLIPS["held_out_with_unlabelled_buoys"])
    complete = [e for e in held if int(e.image.stem) not in unlabelled]
    curves = []
    for (name, model), colour in zip((m.split("=", 1) for m in options.models), COLOURS, strict=False):
        for part, examples in (("all", held), ("complete", complete)):
            q = quality(model, examples)
            print(row(f"{name}, {part}", q), flush=True)
            curves.append(
                Curve(f"{name}, {part} ({q.ap50:.3f})", RECALLS, q.curves[0], INK[colour], part == "complete")
            )
    if options.svg:
        options.svg.write_text(
            chart([], "recall", "precision, IoU 0.5", "Precision and recall", (760, 360), curves=curves)
        )


if __name__ == "__main__":
    main()
