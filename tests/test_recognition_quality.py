"""AP against the field's own tool, drawing, and `detect` over images, folders, videos and dives."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from leadline.errors import InputError
from leadline.evaluation.detect import detect_images
from leadline.evaluation.detection import evaluate_detections
from leadline.evaluation.drawing import draw_detections
from leadline.recognition.boxes import Boxes
from leadline.samples import Detection, StereoFrame


def some_detections(seed: int) -> tuple[dict[str, list[Detection]], dict[str, list[tuple[float, ...]]]]:
    """True boxes with shifted, missing, doubled and false detections."""
    rng = np.random.default_rng(seed)
    found: dict[str, list[Detection]] = {}
    truth: dict[str, list[tuple[float, ...]]] = {}
    for k in range(60):
        boxes = np.column_stack([rng.uniform(0, 400, (3, 2)), rng.uniform(20, 150, (3, 2))])[: rng.integers(0, 4)]
        truth[str(k)] = [tuple(b) for b in boxes]
        seen = [b + rng.normal(0, 6, 4) * rng.uniform(0, 2) for b in boxes for _ in range(rng.integers(0, 3))]
        seen += [np.r_[rng.uniform(0, 400, 2), rng.uniform(20, 150, 2)] for _ in range(rng.integers(0, 2))]
        found[str(k)] = [Detection(tuple(np.maximum(b, 1)), float(rng.random())) for b in seen]
    return found, truth


@pytest.mark.parametrize("seed", range(3))
def test_ap_equals_the_reference_to_all_digits(seed: int) -> None:
    reference = pytest.importorskip("faster_coco_eval")
    found, truth = some_detections(seed)
    quality = evaluate_detections(found, truth)
    notes = [
        {"id": 0, "image_id": int(n), "category_id": 1, "bbox": list(b), "area": b[2] * b[3], "iscrowd": 0}
        for n, boxes in truth.items()
        for b in boxes
    ]
    for number, note in enumerate(notes, 1):
        note["id"] = number
    images = [{"id": int(n), "width": 640, "height": 640} for n in truth]
    results = [
        {"image_id": int(n), "category_id": 1, "bbox": list(d.box_px), "score": d.score}
        for n, every in found.items()
        for d in every
    ]
    with contextlib.redirect_stdout(io.StringIO()):
        coco = reference.COCO({"images": images, "annotations": notes, "categories": [{"id": 1, "name": "ball"}]})
        evaluator = reference.COCOeval_faster(coco, coco.loadRes(results), "bbox")
        evaluator.run()
    assert 0.2 < quality.ap50 < 0.95  # a case with something to get wrong
    assert quality.ap50 == pytest.approx(evaluator.stats[1], abs=1e-12)
    assert quality.ap50_95 == pytest.approx(evaluator.stats[0], abs=1e-12)


def test_curve_and_recall() -> None:
    box = (0.0, 0.0, 10.0, 10.0)
    found = {"a": [Detection(box, 0.9), Detection((50, 50, 5, 5), 0.6)], "b": [Detection((0, 0, 10, 8), 0.4)]}
    quality = evaluate_detections(found, {"a": [box], "b": [box], "c": [box]})
    assert quality.precision == pytest.approx([1, 0.5, 2 / 3])
    assert quality.recall == pytest.approx([1 / 3, 1 / 3, 2 / 3])
    assert quality.at_score(0.5) == pytest.approx((0.5, 1 / 3))
    assert quality.found_iou == pytest.approx([1, 0.8, 0])


def test_a_perfect_and_an_empty_detector() -> None:
    truth = {"a": [(0.0, 0.0, 10.0, 10.0)]}
    assert evaluate_detections({"a": [Detection(truth["a"][0], 0.5)]}, truth).ap50_95 == pytest.approx(1)
    assert evaluate_detections({}, truth).ap50 == 0


def test_drawing_leaves_the_image_alone_and_takes_grey() -> None:
    image = np.zeros((100, 120), np.uint8)
    drawn = draw_detections(image, [Detection((-0.5, -0.5, 120, 100), 0.9, "ball")])
    assert drawn.shape == (100, 120, 3)
    assert drawn[99, 60].any()
    assert not drawn[70, 60].any()
    assert not image.any()


class Brightest:
    """A stand-in detector: the box of what is brighter than half."""

    def detect(self, image: np.ndarray) -> list[Detection]:
        rows, columns = np.nonzero((image if image.ndim == 2 else image.max(-1)) > 127)
        if not len(rows):
            return []
        x, y = float(columns.min()), float(rows.min())
        return [Detection((x - 0.5, y - 0.5, columns.max() + 1 - x, rows.max() + 1 - y), 0.75, "ball")]


def picture(x: int = 10) -> np.ndarray:
    image = np.zeros((48, 64, 3), np.uint8)
    image[20:30, x : x + 20] = 255
    return image


def test_detect_in_a_folder_counts_what_cannot_be_read(tmp_path: Path) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    source.mkdir()
    cv2.imwrite(str(source / "a.png"), picture())
    cv2.imwrite(str(source / "b.png"), np.zeros((48, 64), np.uint8))
    (source / "c.jpg").write_bytes(b"no image")
    steps: list[tuple[int, int | None]] = []
    report = detect_images(source, out, Brightest(), lambda done, total: steps.append((done, total)))
    assert (report.images, report.with_target, report.detections) == (2, 1, 1)
    assert [name for name, _ in report.skipped] == ["c.jpg"]
    assert steps == [(1, 3), (2, 3), (3, 3)]
    (entry,) = json.loads(report.results.read_text())
    assert entry["image_id"] == "a.png"
    assert entry["bbox"] == [10, 20, 20, 10]  # COCO: from the first pixel's corner
    assert sorted(p.name for p in out.glob("*.jpg")) == ["a_detected.jpg", "b_detected.jpg"]


def test_what_detect_writes_boxes_reads(tmp_path: Path) -> None:
    file = tmp_path / "frame.png"
    cv2.imwrite(str(file), picture())
    report = detect_images(file, tmp_path / "out", Brightest())
    frame = StereoFrame(0, picture(), picture(), name="frame.png")
    assert Boxes(report.results).find(frame) == Brightest().detect(picture())


def test_detect_in_a_video(tmp_path: Path) -> None:
    file = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    for x in (5, 15, 25):
        writer.write(picture(x))
    writer.release()
    report = detect_images(file, tmp_path / "out", Brightest())
    assert (report.images, report.with_target) == (3, 3)
    names = [entry["image_id"] for entry in json.loads(report.results.read_text())]
    assert names == ["clip_000000.jpg", "clip_000001.jpg", "clip_000002.jpg"]


@pytest.mark.parametrize("stereo", [False, True])
def test_detect_in_a_dive_takes_the_left_images(tmp_path: Path, stereo: bool) -> None:
    dive = tmp_path / "dive"
    dive.mkdir()
    if stereo:
        cv2.imwrite(str(dive / "l0.png"), np.hstack([picture(5), picture(30)]))
        (dive / "frames.csv").write_text("t_s,stereo\n0.0,l0.png\n")
    else:
        cv2.imwrite(str(dive / "l0.png"), picture(5))
        cv2.imwrite(str(dive / "r0.png"), picture(30))
        (dive / "frames.csv").write_text("t_s,left,right\n0.0,l0.png,r0.png\n1.0,l1.png,r1.png\n")
    report = detect_images(dive, tmp_path / "out", Brightest())
    (entry,) = json.loads(report.results.read_text())
    assert entry["image_id"] == "l0.png"
    assert entry["bbox"] == [5, 20, 20, 10]
    assert len(report.skipped) == (0 if stereo else 1)


def test_detect_tells_what_is_no_input(tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(InputError, match="no images in this folder"):
        detect_images(empty, tmp_path / "out", Brightest())
    with pytest.raises(InputError, match="no such file or folder"):
        detect_images(tmp_path / "absent", tmp_path / "out", Brightest())
    text = tmp_path / "notes.txt"
    text.write_text("no image")
    with pytest.raises(InputError, match="unknown kind of file"):
        detect_images(text, tmp_path / "out", Brightest())
    broken = tmp_path / "broken.jpg"
    broken.write_bytes(b"no image")
    with pytest.raises(InputError, match="no image can be read"):
        detect_images(broken, tmp_path / "out", Brightest())
    video = tmp_path / "broken.mp4"
    video.write_bytes(b"no video")
    with pytest.raises(InputError, match="not a readable video"):
        detect_images(video, tmp_path / "out", Brightest())
