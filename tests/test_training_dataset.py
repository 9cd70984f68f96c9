"""Labelled sets as labelling tools write them, good and bad."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tests.training_sets import coco, picture, voc, yolo

from leadline.errors import InputError
from leadline.training.clips import clip_names
from leadline.training.dataset import Dataset, read_dataset

IMAGES = {
    "a8.png": [("buoy_red", 4, 6, 20, 30)],
    "a9.png": [("channel", 1, 2, 11, 22), ("buoy_green", 30, 8, 60, 40)],
    "a10.png": [],
}


def as_text(data: Dataset) -> list[str]:
    lines = []
    for e in data.examples:
        labels = (f"{data.names[k]}{box.round(3).tolist()}" for k, box in zip(e.classes, e.boxes, strict=True))
        lines.append(f"{e.image.name}: {' '.join(labels)}")
    return lines


EXPECTED = [
    "a8.png: buoy_red[4.0, 6.0, 20.0, 30.0]",
    "a9.png: channel[1.0, 2.0, 11.0, 22.0] buoy_green[30.0, 8.0, 60.0, 40.0]",
    "a10.png: ",
]


@pytest.mark.parametrize("kind", ["voc", "voc without sizes", "coco", "coco file", "yolo", "yolo file"])
def test_the_same_set_in_every_format(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "set"
    path.mkdir()
    if kind.startswith("voc"):
        voc(path, IMAGES, stated_size=kind == "voc")
    elif kind.startswith("coco"):
        coco(path, IMAGES)
    else:
        yolo(path, IMAGES, ["channel", "buoy_red", "buoy_green"])
    path = {"coco file": path / "annotations.json", "yolo file": path / "data.yaml"}.get(kind, path)
    data = read_dataset(path)
    assert as_text(data) == EXPECTED
    assert set(data.names) == {"channel", "buoy_red", "buoy_green"}
    assert data.format == {"v": "Pascal VOC", "c": "COCO", "y": "YOLO"}[kind[0]]
    assert not data.troubles
    if kind.startswith("yolo"):
        assert data.names == ("channel", "buoy_red", "buoy_green")


def test_classes_kept_and_merged(tmp_path: Path) -> None:
    root = voc(tmp_path, IMAGES)
    merged = read_dataset(root, "ball=buoy_*")
    assert merged.names == ("ball",)
    assert [len(e.boxes) for e in merged.examples] == [1, 1, 0]
    kept = read_dataset(root, "channel, buoy_*")
    assert kept.names == ("channel", "buoy_green", "buoy_red")
    two = read_dataset(root, "ball=buoy_*,gate=channel")
    assert as_text(two)[1] == "a9.png: gate[1.0, 2.0, 11.0, 22.0] ball[30.0, 8.0, 60.0, 40.0]"
    with pytest.raises(InputError, match="no class 'boat'; its classes: buoy_green, buoy_red, channel"):
        read_dataset(root, "boat")


def test_what_cannot_be_used_is_left_out_and_told(tmp_path: Path) -> None:
    root = voc(tmp_path, {f"{k}.png": [("ball", 4, 6, 20, 30)] for k in range(9)})
    (root / "Images" / "1.png").write_bytes(b"")
    (root / "Images" / "2.png").write_bytes((root / "Images" / "3.png").read_bytes()[:60])
    (root / "Images" / "4.png").unlink()
    (root / "Annotations" / "5.xml").write_text("<annotation><object>")
    note = root / "Annotations" / "6.xml"
    note.write_text(note.read_text().replace("<xmin>4", "<xmin>four"))
    note = root / "Annotations" / "7.xml"
    note.write_text(note.read_text().replace("<width>64", "<width>48"))
    picture(root / "Images" / "new.png")
    data = read_dataset(root)
    assert [e.image.stem for e in data.examples] == ["0", "3", "8"]
    assert [Path(file).stem for file, _ in data.troubles] == ["4", "1", "2", "5", "6", "7"]
    reasons = [why for _, why in data.troubles]
    assert reasons[1:3] == ["not a readable image"] * 2
    assert "7.xml: says 48x48 pixels, but the image has 64x48" in reasons[5]
    told = "\n".join(data.notices)
    assert "1 images have no annotation: left out, the first new.png" in told
    assert "1 labels without an image left out" in told
    assert "5 images left out, the first: " in told


def test_boxes_outside_the_image(tmp_path: Path) -> None:
    boxes = [("ball", -20, 10, 30, 200), ("ball", 100, 10, 140, 30), ("ball", 5, 5, 5, 20), ("ball", 0, 0, 64.9, 48)]
    data = read_dataset(voc(tmp_path, {"1.png": boxes}))
    assert data.examples[0].boxes.tolist() == [[0, 10, 30, 48], [0, 0, 64, 48]]
    assert "1 boxes reach out of their image and are cut to it, the first in 1.png" in data.notices
    assert "2 boxes are empty or outside their image and are left out, the first in 1.png" in data.notices


def test_bad_yolo_rows_name_the_row(tmp_path: Path) -> None:
    root = yolo(tmp_path, {f"{k}.png": [("ball", 4, 6, 20, 30)] for k in range(5)}, ["ball"])
    labels = root / "labels"
    (labels / "1.txt").write_text("0 0.5 0.5 0.2 0.2\n3 0.5 0.5 0.2 0.2\n")
    (labels / "2.txt").write_text("0 0.5 0.5 0.2\n")
    (labels / "3.txt").write_text("0 0.25 0.25 0.5 0.25 0.5 0.75 0.25 0.75\n")  # an outline
    (labels / "4.txt").unlink()
    (labels / "gone.txt").write_text("0 0.5 0.5 0.2 0.2\n")
    data = read_dataset(root)
    assert [e.image.stem for e in data.examples] == ["0", "3", "4"]
    assert data.examples[1].boxes.tolist() == [[16, 12, 32, 36]]
    reasons = [why for _, why in data.troubles]
    assert "1.txt row 2: class 3, but the set names 1 classes" in reasons
    assert any(why.startswith("2.txt row 1: not `class x y width height`") for why in reasons)
    assert any(file.endswith("gone.txt") for file, _ in data.troubles)
    assert "1 images have no label file: taken as images without a target" in data.notices


def test_yolo_keeps_the_parts_of_its_data_yaml(tmp_path: Path) -> None:
    images = {f"{part}/{k}.png": [("ball", 4, 6, 20, 30)] for part in ("train", "val") for k in range(2)}
    yaml = "path: /home/someone/else\ntrain: ../images/train\nval: images/val\nnames: {0: ball}\n"
    data = read_dataset(yolo(tmp_path, images, ["ball"], yaml))
    assert [(e.image.parent.name, e.part) for e in data.examples] == [("train", "train")] * 2 + [("val", "val")] * 2


def test_yolo_with_one_folder_for_both_parts_has_no_split(tmp_path: Path) -> None:
    data = read_dataset(yolo(tmp_path, {"1.png": [("ball", 4, 6, 20, 30)]}, ["ball"]))
    assert [e.part for e in data.examples] == [None]
    assert "the set's own split is not kept" in data.notices[0]


def test_yolo_without_a_data_yaml(tmp_path: Path) -> None:
    root = yolo(tmp_path, {"1.png": [("ball", 4, 6, 20, 30)]}, ["ball"])
    (root / "data.yaml").unlink()
    assert read_dataset(root).names == ("0",)
    (root / "classes.txt").write_text("ball\n")
    assert read_dataset(root).names == ("ball",)


def test_coco_in_one_file_a_part(tmp_path: Path) -> None:
    for part in ("train", "valid", "test"):
        coco(tmp_path, {"same.png": [("ball", 4, 6, 20, 30)]} if (tmp_path / part).mkdir() is None else {},
             f"{part}/_annotations.coco.json")  # fmt: skip
    data = read_dataset(tmp_path)
    assert sorted((e.image.parent.name, e.part) for e in data.examples) == [
        ("test", "test"), ("train", "train"), ("valid", "val")
    ]  # fmt: skip


def test_coco_crowds_and_bad_entries(tmp_path: Path) -> None:
    file = coco(tmp_path, {**IMAGES, "b.png": [("buoy_green", 1, 2, 11, 22)]}) / "annotations.json"
    data = json.loads(file.read_text())
    data["annotations"][0]["iscrowd"] = 1
    data["annotations"][1]["bbox"] = [1, 2, 3]
    file.write_text(json.dumps(data))
    read = read_dataset(tmp_path)
    assert [e.classes.tolist() for e in read.examples] == [[-1], [], [2]]
    assert "annotation 1: bbox [1, 2, 3] is no x, y, width, height" in read.troubles[0][1]
    del data["categories"]
    file.write_text(json.dumps(data))
    with pytest.raises(InputError, match=r"annotations\.json: not a COCO annotation file \(KeyError\('categories'\)\)"):
        read_dataset(tmp_path)
    file.write_text("{")
    with pytest.raises(InputError, match=r"annotations\.json: is not JSON"):
        read_dataset(tmp_path)


def test_sets_without_a_label_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        read_dataset(tmp_path / "none")
    picture(tmp_path / "1.png")
    with pytest.raises(InputError, match="no labels found; give a YOLO"):
        read_dataset(tmp_path)
    root = voc(tmp_path / "set", {"1.png": []})
    with pytest.raises(InputError, match="not one box in 1 images"):
        read_dataset(root)
    (root / "Images" / "1.png").write_bytes(b"")
    with pytest.raises(InputError, match=r"no labelled image can be used; the first: .*1\.png: not a readable image"):
        read_dataset(root)


def test_clips_from_folders_names_and_gaps(tmp_path: Path) -> None:
    names = ["d1/left_0007.png", "d1/left_0008.png", "d1/left_0009.png", "d1/left_0090.png", "d1/right_0008.png",
             "d2/left_0007.png", "d2/left_0008_jpg.rf.0a1b.png", "d2/left_0008_jpg.rf.77.png", "shore.png"]  # fmt: skip
    clips = clip_names([tmp_path / name for name in names], tmp_path)
    assert clips == ["d1/left_7-9"] * 3 + ["d1/left_90-90", "d1/right_"] + ["d2/left_"] * 3 + ["shore"]


def test_every_tenth_frame_is_still_one_clip(tmp_path: Path) -> None:
    clips = clip_names([tmp_path / f"{k}.png" for k in [*range(0, 200, 10), *range(500, 600, 10)]], tmp_path)
    assert sorted(set(clips)) == ["0-190", "500-590"]


def test_clips_from_a_file(tmp_path: Path) -> None:
    root = voc(tmp_path / "set", IMAGES)
    file = tmp_path / "clips.csv"
    file.write_text("image,clip,part\na8.png,dive 1,test\na9.png,dive 2,\na10.png,dive 2,\n")
    assert [(e.clip, e.part) for e in read_dataset(root, clips=file).examples] == [
        ("dive 1", "test"), ("dive 2", None), ("dive 2", None)
    ]  # fmt: skip
    file.write_text("image,clip\na8.png,dive 1\n")
    with pytest.raises(InputError, match=r"clips\.csv: 2 images have no row, the first a9\.png"):
        read_dataset(root, clips=file)
    file.write_text("image,clip,part\na8.png,dive 1,exam\n")
    with pytest.raises(InputError, match=r"clips\.csv row 2: part 'exam'"):
        read_dataset(root, clips=file)


def test_digest_is_of_pixels_and_labels(tmp_path: Path) -> None:
    first = read_dataset(voc(tmp_path / "a", IMAGES)).digest()
    assert read_dataset(voc(tmp_path / "b", IMAGES)).digest() == first
    assert read_dataset(tmp_path / "b", "ball=buoy_*").digest() != first
    moved = {**IMAGES, "a8.png": [("buoy_red", 4, 6, 21, 30)]}
    assert read_dataset(voc(tmp_path / "c", moved)).digest() != first


@pytest.mark.data
def test_real_buoys(data_dir: Path) -> None:
    data = read_dataset(data_dir / "robosub_buoys", "ball=buoy_*")
    assert (len(data.examples), data.names) == (423, ("ball",))
    assert sum(len(e.boxes) for e in data.examples) == 642
    clips = {e.clip for e in data.examples}
    assert len(clips) == 21
    assert np.all([e.boxes.min() >= 0 for e in data.examples])
