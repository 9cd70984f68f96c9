"""`evaluate detector`: figures against another tool, tables, the index of the water, the page, and bad input."""

from __future__ import annotations

import contextlib
import io
import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from leadline import cli
from leadline.errors import InputError
from leadline.evaluation.detection import evaluate_detections
from leadline.evaluation.detection_tables import Outcome, Picture
from leadline.evaluation.detection_water import local_contrast, thirds
from leadline.evaluation.detector_report import DetectorReport, write_detector_report
from leadline.samples import Detection
from leadline.training.dataset import Example
from tiny_onnx import constant_model

NAMES = ["ball", "fish"]
COLOURS = {"ball": (30, 40, 230), "fish": (220, 60, 30)}


def some_pictures(count: int = 60) -> list[Picture]:
    """True boxes of two classes with shifted, missing, doubled, mistaken and false detections."""
    rng = np.random.default_rng(5)
    out = []
    for k in range(count):
        boxes = np.column_stack([rng.uniform(0, 400, (4, 2)), rng.uniform(10, 150, (4, 2))])[: rng.integers(0, 5)]
        labels = [NAMES[n] for n in rng.integers(0, 2, len(boxes))]
        found = []
        for box, label in zip(boxes, labels, strict=True):
            for _ in range(rng.integers(0, 3)):
                seen = np.maximum(box + rng.normal(0, 5, 4) * rng.uniform(0, 2), 1)
                claimed = label if rng.random() < 0.8 else NAMES[label == "ball"]
                found.append(Detection(tuple(seen), float(rng.random()), claimed))
        if rng.random() < 0.5:
            found.append(Detection((*rng.uniform(0, 400, 2), *rng.uniform(10, 150, 2)), float(rng.random()), "ball"))
        truths = tuple((tuple(box), label) for box, label in zip(boxes.tolist(), labels, strict=True))
        out.append(Picture(f"{k:03d}.png", f"clip{k % 3}", 0.1 + 0.001 * k, truths, (), tuple(found)))
    return out


def test_average_precision_of_two_classes_equals_the_reference() -> None:
    reference = pytest.importorskip("faster_coco_eval")
    pictures = some_pictures()
    notes = [
        {"image_id": i, "category_id": NAMES.index(n), "bbox": list(b), "area": b[2] * b[3], "iscrowd": 0}
        for i, p in enumerate(pictures)
        for b, n in p.truths
    ]
    results = [
        {"image_id": i, "category_id": NAMES.index(d.label), "bbox": list(d.box_px), "score": d.score}
        for i, p in enumerate(pictures)
        for d in p.found
    ]
    images = [{"id": i, "width": 640, "height": 640} for i in range(len(pictures))]
    categories = [{"id": i, "name": n} for i, n in enumerate(NAMES)]
    numbered = [{"id": k, **note} for k, note in enumerate(notes, 1)]
    with contextlib.redirect_stdout(io.StringIO()):
        coco = reference.COCO({"images": images, "annotations": numbered, "categories": categories})
        evaluator = reference.COCOeval_faster(coco, coco.loadRes(results), "bbox")
        evaluator.run()
    ours = Outcome(pictures, NAMES, 0.3).ap()
    assert 0.1 < ours[2] < ours[0] < 0.9  # a case with something to get wrong
    assert ours == pytest.approx((evaluator.stats[1], evaluator.stats[2], evaluator.stats[0]), abs=1e-12)


def test_a_box_that_may_be_a_target_counts_neither_way() -> None:
    box, maybe = (0.0, 0.0, 10.0, 10.0), (50.0, 50.0, 30.0, 30.0)
    found = {"a": [Detection((52, 52, 10, 10), 0.9), Detection((60, 60, 15, 15), 0.8), Detection(box, 0.7)]}
    assert evaluate_detections(found, {"a": [box]}).ap50 == pytest.approx(1 / 3, abs=1e-6)
    quality = evaluate_detections(found, {"a": [box]}, {"a": [maybe]})
    assert quality.ap50 == pytest.approx(1)
    assert [pair.truth for pair in quality.pairs] == [0]


def test_the_tables_add_up() -> None:
    outcome = Outcome(some_pictures(), NAMES, 0.3)
    whole, sizes, clips = outcome.row("all"), outcome.by_size(), outcome.by_clip()
    boxes = sum(len(p.truths) for p in outcome.pictures)
    assert whole.truths == boxes
    for rows in (sizes, clips):
        assert sum(r.truths for r in rows) == boxes
        assert sum(r.found for r in rows) == whole.found
        assert sum(r.false for r in rows) == whole.false
    assert [row.name for row in clips] == ["clip0", "clip1", "clip2"]
    names, counts = outcome.confusion()
    assert names == NAMES
    assert sum(counts[0]) + sum(counts[1]) == boxes
    assert counts[0][1] > 0 < counts[1][0]  # mistaken classes are in it, and told apart from missed ones
    score, precision, recall = outcome.by_score()[5]
    assert (score, whole.precision, whole.recall) == (0.3, pytest.approx(precision), pytest.approx(recall))


def test_centre_errors_are_those_of_the_found_boxes() -> None:
    truths = (((0.0, 0.0, 20.0, 20.0), "ball"), ((100.0, 0.0, 20.0, 20.0), "ball"))
    found = (Detection((3, 4, 20, 20), 0.9, "ball"), Detection((100, 0, 20, 20), 0.1, "ball"))
    row = Outcome([Picture("a", "", 0.1, truths, (), found)], ["ball"], 0.3).row("all")
    assert (row.truths, row.found, row.false) == (2, 1, 0)  # the second scores too little
    assert row.centres is not None
    assert (row.centres.mean_px, row.centres.rms_px, row.centres.p95_px) == pytest.approx((5, 5, 5))


def scene(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    small = rng.integers(20, 230, (18, 32, 3), np.uint8)
    return np.asarray(cv2.resize(small, (640, 360), interpolation=cv2.INTER_CUBIC), np.uint8)


def test_the_index_of_the_water_follows_haze_and_blur_and_not_the_light() -> None:
    image = scene()
    clear = local_contrast(image)
    veil = np.array(cv2.mean(image)[:3])
    for left in (0.7, 0.4, 0.1):
        hazy = np.clip(image * left + veil * (1 - left), 0, 255).astype(np.uint8)
        assert local_contrast(hazy) == pytest.approx(left * clear, rel=0.08)
    assert local_contrast(np.asarray(cv2.GaussianBlur(image, (0, 0), 12), np.uint8)) < 0.7 * clear
    assert local_contrast((image * 0.6).astype(np.uint8)) == pytest.approx(clear, rel=0.05)
    assert local_contrast(np.asarray(cv2.resize(image, (1280, 720)), np.uint8)) == pytest.approx(clear, rel=0.02)
    assert local_contrast(np.full((48, 64), 90, np.uint8)) < 1e-6


def test_images_fall_into_thirds_and_a_handful_stays_together() -> None:
    names, group = thirds(np.array([0.3, 0.1, 0.2, 0.6, 0.5, 0.4]))
    assert [name.split()[0] for name in names] == ["murky", "middle", "clear"]
    assert group.tolist() == [1, 0, 0, 2, 2, 1]
    assert thirds(np.array([0.1, 0.2]))[0] == ["all"]
    assert thirds(np.full(9, 0.1))[0] == ["all"]


def labelled_set(folder: Path, count: int = 8, names: tuple[str, ...] = ("ball",)) -> Path:
    """A YOLO set of coloured blocks; the last image is empty."""
    (folder / "images").mkdir(parents=True)
    (folder / "labels").mkdir()
    (folder / "data.yaml").write_text(f"names: {list(names)}\n")
    for k in range(count):
        image = np.full((96, 128, 3), (120 - 5 * k, 110, 40 + 6 * k), np.uint8)
        row = ""
        if k < count - 1:
            cv2.rectangle(image, (10 * k, 20), (10 * k + 29, 59), COLOURS["ball"], -1)
            row = f"0 {(10 * k + 15) / 128} {40 / 96} {30 / 128} {40 / 96}\n"
        cv2.imwrite(str(folder / "images" / f"dive_{k:03d}.png"), image)
        (folder / "labels" / f"dive_{k:03d}.txt").write_text(row)
    return folder


def blocks(image: np.ndarray) -> list[Detection]:
    """A stand-in detector: the red block, sure; and always the top left corner, hardly."""
    rows, columns = np.nonzero(image[..., 2] > 200)
    corner = [Detection((-0.5, -0.5, 12, 12), 0.4, "ball")]
    if not len(rows):
        return corner
    x, y = float(columns.min()), float(rows.min())
    size = (float(columns.max() + 1 - x), float(rows.max() + 1 - y))
    return [Detection((x - 0.5, y - 0.5, *size), 0.9, "ball"), *corner, Detection((50, 50, 9, 9), 0.8, "crab")]


def examples_of(folder: Path) -> list[Example]:
    out = []
    for image in sorted((folder / "images").glob("*")):
        rows = np.array((folder / "labels" / f"{image.stem}.txt").read_text().split(), float).reshape(-1, 5)
        (x, y), (w, h) = rows[:, 1:3].T * [[128], [96]], rows[:, 3:5].T * [[128], [96]]
        boxes = np.stack([x - w / 2, y - h / 2, x + w / 2, y + h / 2], 1).astype(np.float32)
        out.append(Example(image, boxes, rows[:, 0].astype(np.int64), clip="dive"))
    return out


def report_of(tmp_path: Path) -> DetectorReport:
    examples = examples_of(labelled_set(tmp_path / "set"))
    return write_detector_report(examples, blocks, tmp_path / "out", ["ball"], title="blocks on <blocks>")


def test_the_report_of_a_detector_that_is_all_but_perfect(tmp_path: Path) -> None:
    report = report_of(tmp_path)
    assert (report.images, report.boxes) == (8, 7)
    assert report.ap50 == report.ap75 == report.ap50_95 == pytest.approx(1)
    assert (report.all.found, report.all.false) == (7, 8)
    assert report.all.centres is not None
    assert report.all.centres.rms_px < 1e-3
    assert report.best_score[1:] == (1, 1)
    assert [row.name for row in report.recall_by_size] == ["under 16 px", "32 to 64 px"]
    assert sum(row.images for row in report.by_water) == 8
    assert "crab" in report.notices[0]
    assert {file.name for file in report.files} == {path.name for path in (tmp_path / "out").iterdir()}


def test_the_page_stands_alone_and_escapes(tmp_path: Path) -> None:
    report_of(tmp_path)
    page = (tmp_path / "out" / "detector.html").read_text()
    assert "blocks on &lt;blocks&gt;" in page
    assert not re.search(r'(src|href)="(?!data:)', page)
    assert "data:image/jpeg;base64," in page
    assert "<svg" in page
    text = (tmp_path / "out" / "summary.json").read_text()
    assert "NaN" not in text
    summary = json.loads(text)
    assert summary["ap50"] == pytest.approx(1)
    assert summary["confusion"]["counts"] == [[7, 0], [8, 0]]


def test_the_sheets_show_the_box_that_is_wrong(tmp_path: Path) -> None:
    examples = examples_of(labelled_set(tmp_path / "set"))
    report = write_detector_report(examples, lambda image: [], tmp_path / "out", ["ball"])
    assert (report.ap50, report.all.found, report.all.recall) == (0, 0, 0)
    assert not (tmp_path / "out" / "false_boxes.jpg").exists()
    sheet = cv2.imread(str(tmp_path / "out" / "misses.jpg"))
    assert sheet is not None
    assert sheet.shape[1] > 900
    green = (sheet[..., 1] > 150) & (sheet[..., 0] < 130) & (sheet[..., 2] < 130)
    assert 500 < green.sum() < 20000


def test_an_image_that_breaks_later_is_left_out_and_told(tmp_path: Path) -> None:
    examples = examples_of(labelled_set(tmp_path / "set"))
    examples[3].image.write_bytes(examples[3].image.read_bytes()[:60])
    report = write_detector_report(examples, blocks, tmp_path / "out", ["ball"])
    assert report.images == 7
    assert any("dive_003.png" in line for line in report.notices)
    with pytest.raises(InputError, match="none has a labelled box"):
        write_detector_report(examples[-1:], blocks, tmp_path / "out", ["ball"])


def test_one_image_is_enough(tmp_path: Path) -> None:
    report = write_detector_report(examples_of(labelled_set(tmp_path / "s"))[:1], blocks, tmp_path / "o", ["ball"])
    assert report.ap50 == pytest.approx(1)
    assert [row.name for row in report.by_water] == ["all"]


def block_model(path: Path, names: str | None = "{0: 'ball'}") -> Path:
    """Always claims the box 10..40, 20..60 px of a 128x96 image, sure, in YOLOv8's layout."""
    answer = np.full((1, 5, 12), 0.001, np.float32)
    answer[0, :, 0] = (25, 40, 30, 40, 0.9)
    meta = {"imgsz": "[96, 128]"} | ({"names": names} if names else {})
    return constant_model(path, answer, (1, 3, 96, 128), meta)


def test_the_command_on_a_yolo_set(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, model = labelled_set(tmp_path / "set"), block_model(tmp_path / "m.onnx")
    assert cli.main(["evaluate", "detector", str(data), "--model", str(model), "--out", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr().out
    assert "AP50" in shown
    assert "found (recall" in shown
    assert str(tmp_path / "out" / "detector.html") in shown
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary["images"], summary["boxes"], summary["all"]["found"]) == (8, 7, 3)  # blocks at 0, 10 and 20 px


def complaint(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    model = [] if "--model" in arguments else ["--model", str(block_model(Path(arguments[-1]).parent / "plain.onnx"))]
    assert cli.main(["evaluate", "detector", *arguments, *model]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    return told


def test_bad_input_gets_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    buoys = labelled_set(tmp_path / "set", names=("buoy",))
    model, out = str(block_model(tmp_path / "m.onnx")), str(tmp_path / "out")
    told = complaint([str(buoys), "--model", model, "--out", out], capsys)
    assert "buoy are none of the model's (ball" in told
    assert "--classes 'ball=buoy'" in told
    assert "no class 'crab'" in complaint([str(buoys), "--classes", "ball=crab", "--out", out], capsys)
    assert "no such" in complaint([str(tmp_path / "none"), "--out", out], capsys)
    told = complaint([str(buoys), "--classes", "ball=buoy", "--part", "test", "--out", out], capsys)
    assert "no image of the part 'test'" in told
    for label in (tmp_path / "set" / "labels").glob("*.txt"):
        label.write_text("")
    assert "not one box in 8 images" in complaint([str(buoys), "--classes", "ball=buoy", "--out", out], capsys)
    odd = constant_model(tmp_path / "odd.onnx", np.zeros((1, 7), np.float32))
    assert "odd.onnx" in complaint([str(buoys), "--model", str(odd), "--out", out], capsys)
    assert not Path(out).exists()


def test_a_model_without_names_and_a_folder_that_is_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, model = str(labelled_set(tmp_path / "set")), str(block_model(tmp_path / "m.onnx", names=None))
    assert cli.main(["evaluate", "detector", data, "--model", model, "--out", str(tmp_path / "out")]) == 0
    assert "does not name its classes" in capsys.readouterr().out
    (tmp_path / "file").write_text("")
    assert "file" in complaint([data, "--model", model, "--out", str(tmp_path / "file")], capsys)
