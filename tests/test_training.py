"""Data sets and augmentation for training: numpy and OpenCV only."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from leadline.errors import InputError
from leadline.training.augment import Picture, clipped, framed, mosaic, other_water
from leadline.training.dataset import Example, read_voc, split_by_numbers

VOC = (
    "<annotation><object><name>{}</name><bndbox><xmin>1</xmin><ymin>2</ymin><xmax>11</xmax><ymax>22</ymax></bndbox>"
    "</object></annotation>"
)


def voc_folder(folder: Path, *names: str) -> Path:
    (folder / "Images").mkdir(parents=True)
    (folder / "Annotations").mkdir()
    for k, name in enumerate(names):
        (folder / "Images" / f"{k + 8}.jpg").write_bytes(b"")
        (folder / "Annotations" / f"{k + 8}.xml").write_text(VOC.format(name))
    return folder


def test_voc_in_the_order_of_numbers_with_a_prefix(tmp_path: Path) -> None:
    examples = read_voc(voc_folder(tmp_path, "buoy_red", "channel", "buoy_green"), ["ball"], prefix="buoy_")
    assert [e.image.name for e in examples] == ["8.jpg", "9.jpg", "10.jpg"]
    assert [len(e.boxes) for e in examples] == [1, 0, 1]
    assert examples[0].boxes[0].tolist() == [1, 2, 11, 22]
    assert examples[0].classes.tolist() == [0]


def test_bad_voc_is_told_with_the_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no labelled images"):
        read_voc(tmp_path, ["ball"])
    folder = voc_folder(tmp_path, "ball")
    (folder / "Annotations" / "8.xml").write_text(VOC.format("ball").replace("11", "eleven"))
    with pytest.raises(InputError, match=r"8\.xml: not a Pascal VOC annotation"):
        read_voc(folder, ["ball"])


def test_split_keeps_whole_ranges_apart() -> None:
    none = np.zeros((0, 4), np.float32), np.zeros(0, np.int64)
    examples = [Example(Path(f"frame{n}.jpg"), *none) for n in range(10)]
    train, held = split_by_numbers(examples, [(2, 3), (7, 7)])
    assert [e.image.stem for e in held] == ["frame2", "frame3", "frame7"]
    assert len(train) == 7


def white_box(width: int = 160, height: int = 120) -> Picture:
    image = np.zeros((height, width, 3), np.uint8)
    image[40:80, 50:110] = 255
    return Picture(image, np.array([[50, 40, 110, 80]], np.float32), np.zeros(1, np.int64))


@pytest.mark.parametrize("seed", range(25))
def test_boxes_follow_the_pixels(seed: int) -> None:
    result = framed(np.random.default_rng(seed), white_box(), (200, 140))
    rows, columns = np.nonzero(result.image.min(-1) > 180)
    if not len(result.boxes):
        return
    seen = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
    assert result.boxes[0] == pytest.approx(seen, abs=1.6)


def test_mosaic_boxes_hold_what_they_say(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("leadline.training.augment.other_water", lambda rng, image: image)
    rng = np.random.default_rng(3)
    count = 0
    for _ in range(10):
        result = mosaic(rng, white_box, (320, 240))
        for x0, y0, x1, y1 in result.boxes:
            middle = result.image[int((y0 + y1) / 2), int((x0 + x1) / 2)].astype(int)
            assert middle.mean() > 200
            count += 1
    assert count > 15


def test_little_that_is_left_of_a_small_box_is_not_taught() -> None:
    image = np.zeros((100, 160, 3), np.uint8)
    boxes = np.array([[-30, 10, 7, 40], [-30, 10, 20, 40], [0, 0, 4, 4], [-900, -900, 60, 900]], np.float32)
    kept = clipped(Picture(image, boxes, np.arange(4)))
    assert kept.classes.tolist() == [1, 3]  # half of it seen; large, though hardly any of it is seen
    assert kept.boxes[1].tolist() == [0, 0, 60, 100]


def test_other_water_changes_colours_and_keeps_the_scene() -> None:
    rng = np.random.default_rng(0)
    picture = white_box()
    changed = [other_water(rng, picture.image) for _ in range(20)]
    assert all(c.shape == picture.image.shape and c.dtype == np.uint8 for c in changed)
    assert all(c[50:70, 60:100].mean() > c[:30].mean() + 10 for c in changed)
    assert np.std([c[60, 80].astype(int) for c in changed]) > 10
