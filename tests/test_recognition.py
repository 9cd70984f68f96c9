"""The detector: every head's layout, the pixel convention, NMS, and clear lines for models that are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leadline.errors import InputError
from leadline.recognition.boxes import Boxes
from leadline.recognition.detector import Detector, letterbox
from leadline.recognition.track import choose, iou
from leadline.samples import Detection, StereoFrame
from tiny_onnx import constant_model

NAMES = {"names": "{0: 'ball', 1: 'pile'}"}


def yolov8_output(*rows: tuple[float, ...], count: int = 84) -> np.ndarray:
    """Rows cx cy w h s0 s1 -> (1, 6, count), the rest without a score."""
    table = np.zeros((count, 6), np.float32)
    for k, row in enumerate(rows):
        table[k] = row
    return table.T[None]


@pytest.fixture
def image() -> np.ndarray:
    """128 x 64: in a 64 x 64 network at half size, with 16 rows of border above and below."""
    return np.zeros((64, 128, 3), np.uint8)


def test_yolov8_head_and_the_pixel_convention(tmp_path: Path, image: np.ndarray) -> None:
    model = constant_model(tmp_path / "m.onnx", yolov8_output((20, 30, 10, 8, 0.1, 0.9)), metadata=NAMES)
    (found,) = Detector(model).detect(image)
    assert found.box_px == pytest.approx((29.5, 19.5, 20, 16))  # corner (30, 20) is pixel centre (29.5, 19.5)
    assert (found.label, found.score) == ("pile", pytest.approx(0.9))


def test_end_to_end_head(tmp_path: Path, image: np.ndarray) -> None:
    output = np.zeros((1, 300, 6), np.float32)
    output[0, 0] = 15, 26, 25, 34, 0.8, 0
    (found,) = Detector(constant_model(tmp_path / "m.onnx", output, metadata=NAMES)).detect(image)
    assert found.box_px == pytest.approx((29.5, 19.5, 20, 16))
    assert found.label == "ball"


@pytest.mark.parametrize("classes", [1, 2])
def test_yolox_head(tmp_path: Path, image: np.ndarray, classes: int) -> None:
    output = np.zeros((1, 8 * 8 + 4 * 4 + 2 * 2, 5 + classes), np.float32)
    cell = 3 * 8 + 2  # row 3, column 2 of stride 8
    output[0, cell, :6] = 0.5, 0.75, np.log(10 / 8), np.log(8 / 8), 0.9, 0.5
    found = Detector(constant_model(tmp_path / "m.onnx", output)).detect(image)
    assert found[0].box_px == pytest.approx((29.5, 19.5, 20, 16))
    assert found[0].score == pytest.approx(0.45)


def test_boxes_are_cut_to_the_image(tmp_path: Path, image: np.ndarray) -> None:
    model = constant_model(tmp_path / "m.onnx", yolov8_output((32, 32, 200, 200, 0.9, 0)))
    assert Detector(model).detect(image)[0].box_px == pytest.approx((-0.5, -0.5, 128, 64))


def test_nms_keeps_the_best_of_a_class_and_other_classes(tmp_path: Path, image: np.ndarray) -> None:
    rows = ((20, 30, 10, 8, 0.6, 0), (21, 30, 10, 8, 0.9, 0), (20, 30, 10, 8, 0, 0.7), (50, 30, 10, 8, 0.2, 0))
    found = Detector(constant_model(tmp_path / "m.onnx", yolov8_output(*rows), metadata=NAMES)).detect(image)
    assert [(d.label, round(d.score, 2)) for d in found] == [("ball", 0.9), ("pile", 0.7)]
    low = Detector(constant_model(tmp_path / "m.onnx", yolov8_output(*rows), metadata=NAMES), score=0.1, nms_iou=0.99)
    assert len(low.detect(image)) == 4


def test_find_looks_at_the_left_image(tmp_path: Path, image: np.ndarray) -> None:
    detector = Detector(constant_model(tmp_path / "m.onnx", yolov8_output((20, 30, 10, 8, 0.9, 0))))
    frame = StereoFrame(0, image, np.zeros((10, 10), np.uint8))
    assert detector.find(frame) == detector.detect(image)


@pytest.mark.parametrize("shape", [(1, 1000), (1, 4, 84), (2, 6, 84), (1, 7, 7, 30)])
def test_a_model_with_another_output_is_told_with_file_and_shape(tmp_path: Path, shape: tuple[int, ...]) -> None:
    model = constant_model(tmp_path / "classifier.onnx", np.zeros(shape, np.float32))
    with pytest.raises(InputError, match=r"classifier\.onnx.*" + "x".join(map(str, shape))) as caught:
        Detector(model)
    assert "\n" not in str(caught.value)


def test_models_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent\.onnx: no such model file"):
        Detector(tmp_path / "absent.onnx")
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"\x08\x07 not a model")
    with pytest.raises(InputError, match=r"broken\.onnx: not a readable ONNX model") as caught:
        Detector(broken)
    assert "\n" not in str(caught.value)
    grey = constant_model(tmp_path / "grey.onnx", yolov8_output(), input_shape=(1, 1, 64, 64))
    with pytest.raises(InputError, match=r"grey\.onnx: unknown model input"):
        Detector(grey)


@pytest.mark.parametrize("size", [(64, 64), (128, 64), (64, 96)])
def test_letterbox_maps_corners_onto_corners(size: tuple[int, int]) -> None:
    image = np.full((60, 100, 3), 200, np.uint8)
    blob, scale, pad = letterbox(image, size, bgr_255=True)
    rows, columns = np.nonzero(blob[0, 0] == 200)
    assert columns.min() == pad[0]
    assert rows.min() == pad[1]
    assert columns.max() + 1 - pad[0] == pytest.approx(100 * scale, abs=0.51)
    assert rows.max() + 1 - pad[1] == pytest.approx(60 * scale, abs=0.51)


@pytest.mark.parametrize("shape", [(512, 1024), (511, 1023), (300, 500), (40, 90)])
def test_letterbox_keeps_places_to_a_fraction_of_a_pixel(shape: tuple[int, int]) -> None:
    height, width = shape
    y, x = np.mgrid[0:height, 0:width] + 0.5
    centre = 0.3 * width, 0.6 * height
    blob_image = 255 * np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / (2 * (0.08 * height) ** 2))
    blob, scale, pad = letterbox(blob_image.astype(np.uint8), (128, 64), bgr_255=True)
    light = blob[0, 0].astype(float)
    left, top, right, bottom = (int(v) for v in (*pad, pad[0] + width * scale + 0.5, pad[1] + height * scale + 0.5))
    light[:, :left] = light[:, right:] = 0
    light[:top] = light[bottom:] = 0
    rows, columns = np.mgrid[0:64, 0:128] + 0.5
    seen = np.array([(light * columns).sum(), (light * rows).sum()]) / light.sum()
    assert (seen - pad) / scale == pytest.approx(centre, abs=0.35 / scale)


def test_letterbox_channel_order_and_grey() -> None:
    image = np.zeros((64, 64, 3), np.uint8)
    image[..., 2] = 255  # red, BGR
    assert letterbox(image, (64, 64), bgr_255=False)[0][0, :, 0, 0] == pytest.approx([1, 0, 0])
    assert letterbox(image, (64, 64), bgr_255=True)[0][0, :, 0, 0] == pytest.approx([0, 0, 255])
    grey = np.full((64, 64), 51, np.uint8)
    assert letterbox(grey, (64, 64), bgr_255=False)[0][0, :, 0, 0] == pytest.approx([0.2] * 3)


# boxes from a file


def frame_named(name: str) -> StereoFrame:
    blank = np.zeros((4, 4), np.uint8)
    return StereoFrame(0, blank, blank, name=name)


@pytest.mark.parametrize("wrap", ["{}", '{{"annotations": {}}}'])
def test_boxes_by_image_name_best_first(tmp_path: Path, wrap: str) -> None:
    entries = (
        '[{"image_id": "a.jpg", "bbox": [10, 20, 30, 40], "score": 0.4, "category_name": "ball"},'
        ' {"image_id": "left/a.jpg", "bbox": [1, 2, 3, 4], "score": 0.8},'
        ' {"image_id": "b.jpg", "bbox": [5, 5, 5, 5], "score": 1}]'
    )
    file = tmp_path / "boxes.json"
    file.write_text(wrap.format(entries))
    found = Boxes(file).find(frame_named("left/a.jpg"))
    assert [d.score for d in found] == [0.8, 0.4]
    assert found[1].box_px == (9.5, 19.5, 30, 40)
    assert found[1].label == "ball"
    assert Boxes(file).find(frame_named("c.jpg")) == []


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[{", "not JSON"),
        ('{"images": []}', "neither"),
        ('[{"image_id": "a", "bbox": [1, 2, 3, 4], "score": 1}, {"bbox": [1, 2, 3, 4]}]', "entry 1: no 'image_id'"),
        ('[{"image_id": "a", "bbox": [1, 2, 3], "score": 1}]', "entry 0: not a detection"),
        ('[{"image_id": "a", "bbox": [1, 2, 0, 4], "score": 1}]', "entry 0: bad bbox"),
        ('[{"image_id": "a", "bbox": [1, 2, NaN, 4], "score": 1}]', "entry 0: bad bbox"),
        ('["a"]', "entry 0: not a detection"),
    ],
)
def test_bad_boxes_are_told_with_file_and_entry(tmp_path: Path, text: str, told: str) -> None:
    file = tmp_path / "boxes.json"
    file.write_text(text)
    with pytest.raises(InputError, match=r"boxes\.json") as caught:
        Boxes(file)
    assert told in str(caught.value)


def test_a_missing_boxes_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        Boxes(tmp_path / "absent.json")


# the choice of one


def test_choice_without_a_last_box_is_large_and_sure() -> None:
    small, large = Detection((0, 0, 10, 10), 0.9), Detection((50, 50, 40, 40), 0.5)
    assert choose([small, large]) is small  # a large box that is hardly sure is not the target ...
    assert choose([small, Detection(large.box_px, 0.6)]) is not small  # ... but a sure one is, before a small one
    assert choose([]) is None


def test_choice_stays_with_the_last_box() -> None:
    small, large = Detection((2, 1, 10, 10), 0.4), Detection((50, 50, 40, 40), 0.9)
    assert choose([large, small], last_box=(0, 0, 10, 10)) is small
    assert choose([large, Detection((14, 0, 10, 10), 0.3)], last_box=(0, 0, 15, 15)) is not large
    assert choose([large], last_box=(0, 0, 10, 10)) is large  # nothing near: look afresh


boxes = st.tuples(*[st.floats(-50, 50)] * 2, *[st.floats(1, 80)] * 2)


@given(boxes, boxes)
def test_iou_is_symmetric_bounded_and_one_only_for_the_same(a: tuple[float, ...], b: tuple[float, ...]) -> None:
    assert iou(a, b) == pytest.approx(iou(b, a))
    assert 0 <= iou(a, b) <= 1 + 1e-12
    assert iou(a, a) == pytest.approx(1)
