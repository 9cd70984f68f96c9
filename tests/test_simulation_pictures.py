"""Training pictures: boxes are true, pictures vary and repeat by seed."""

from __future__ import annotations

from functools import cache

import numpy as np

from leadline.samples import Image
from leadline.simulation.canvas import Box
from leadline.simulation.pictures import LABEL, random_picture

Picture = tuple[Image, list[Box], list[str]]


@cache
def _many(count: int, size: tuple[int, int] = (208, 208)) -> list[Picture]:
    return [random_picture(np.random.default_rng([7, i]), size) for i in range(count)]


def test_same_seed_same_picture() -> None:
    first, again = (random_picture(np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(first[0], again[0])
    assert first[1] == again[1]
    assert not np.array_equal(first[0], random_picture(np.random.default_rng(4))[0])


def test_boxes_lie_in_the_picture_and_stand_out() -> None:
    for image, boxes, labels in _many(30, (200, 260)):
        assert image.shape == (200, 260, 3)
        assert image.dtype == np.uint8
        assert labels == [LABEL] * len(boxes)
        for x, y, w, h in boxes:
            assert x >= 0
            assert y >= 0
            assert x + w <= 260
            assert y + h <= 200
            assert min(w, h) >= 8


def test_pictures_cover_none_small_and_overflowing_balls() -> None:
    boxes = [b for _, b, _ in _many(100)]
    sides = [max(w, h) for b in boxes for *_, w, h in b]
    assert 0.05 < np.mean([not b for b in boxes]) < 0.5
    assert min(sides) < 25
    assert sum(side >= 200 for side in sides) >= 2


def test_a_box_is_tight_around_its_ball() -> None:
    """Where a ball is alone and bright before open water, the pixels that differ from the water fill the box."""
    tight = 0
    for image, boxes, _ in _many(100):
        if len(boxes) != 1:
            continue
        x, y, w, h = boxes[0]
        if x < 5 or y < 5 or x + w > 203 or y + h > 203 or w < 40:
            continue
        grey = image.astype(float).max(2)
        column, row = int(x + w / 2), int(y + h / 2)
        inside = (
            np.abs(grey[row, int(x) + 3] - grey[row, int(x) - 4]),
            np.abs(grey[int(y) + 3, column] - grey[int(y) - 4, column]),
        )
        tight += max(inside) > 6
    assert tight >= 2
