"""Data sets and augmentation for training: numpy and OpenCV only."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from leadline.training.augment import Picture, clipped, framed, mosaic, other_water
from leadline.training.dataset import Example, split_by_numbers


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
