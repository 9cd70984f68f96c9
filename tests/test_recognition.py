"""The detector: every head's layout, the pixel convention, NMS, and clear lines for models that are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnxruntime
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leadline.config import Provider
from leadline.errors import InputError
from leadline.recognition import runtime
from leadline.recognition.boxes import Boxes
from leadline.recognition.detector import Detector
from leadline.recognition.heads import recognise
from leadline.recognition.letterbox import letterbox, planes
from leadline.recognition.track import iou
from leadline.samples import StereoFrame
from tiny_onnx import DOUBLE, FLOAT16, UINT8, constant_model

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


def yolox_output(width: int, height: int, classes: int = 1) -> np.ndarray:
    """One box on row 3, column 2 of stride 8: centre (20, 30), 10 x 8, score 0.45."""
    output = np.zeros((1, 21 * width * height // 1024, 5 + classes), np.float32)
    output[0, 3 * (width // 8) + 2, :6] = 0.5, 0.75, np.log(10 / 8), np.log(8 / 8), 0.9, 0.5
    return output


@pytest.mark.parametrize(("width", "height"), [(128, 64), (64, 128), (160, 96)])
def test_yolox_at_rectangular_sizes(tmp_path: Path, width: int, height: int) -> None:
    model = constant_model(tmp_path / "m.onnx", yolox_output(width, height), (1, 3, height, width))
    (found,) = Detector(model).detect(np.zeros((height, width, 3), np.uint8))
    assert found.box_px == pytest.approx((14.5, 25.5, 10, 8))


def test_yolox_whose_boxes_are_in_pixels_already(tmp_path: Path, image: np.ndarray) -> None:
    """As LibreYOLO exports it."""
    output = np.zeros((1, 84, 6), np.float32)
    corners = [8 * (k % 8) + 4 for k in range(64)], [8 * (k // 8) + 4 for k in range(64)]
    output[0, :64, 0], output[0, :64, 1] = corners
    output[0, 3 * 8 + 2] = 20, 30, 10, 8, 0.9, 0.5
    (found,) = Detector(constant_model(tmp_path / "m.onnx", output)).detect(image)
    assert found.box_px == pytest.approx((29.5, 19.5, 20, 16))


def test_the_head_is_told_where_shapes_are_not_enough() -> None:
    """A 64 x 64 input has 84 cells: 80 classes then give a square, 2 classes or 1 as many columns as end-to-end."""
    square = np.zeros((1, 84, 84), np.float32)
    square[0, :2] = 32.0  # centres by rows
    told = {names: recognise(square, 64, 64, names) for names in (0, 80)}
    assert [head and head.name for head in told.values()] == ["yolov8", "yolov8"]
    assert recognise(square, 64, 64, 79) is None  # rows 4 and 5 are no scores, columns 4 and on neither
    swapped = recognise(square.transpose(0, 2, 1), 64, 64, 79)
    assert swapped is not None
    assert swapped.name == "yolox"
    few = np.zeros((1, 84, 6), np.float32)
    few[0, :, 4:] = 0.3, 0.6  # no class is 0.6
    assert [head and head.name for head in (recognise(few, 64, 64, n) for n in (0, 1, 2))] == ["yolox", "yolox", None]
    few[0, :, 5] = 1.0
    told_end = recognise(few, 64, 64, 2)
    assert told_end is not None
    assert told_end.name == "end-to-end"
    tiny = np.zeros((1, 84, 21), np.float32)  # 80 classes on 32 x 32: more rows than columns
    assert [head and head.name for head in (recognise(tiny, 32, 32, n) for n in (0, 80))] == ["yolov8", "yolov8"]
    assert recognise(np.full((1, 6, 84), 7.0, np.float32), 64, 64) is None  # no scores, logits
    assert recognise(np.full((1, 6, 84), np.nan, np.float32), 64, 64) is None


@pytest.mark.parametrize(
    ("shape", "size"), [(("batch", 3, "h", "w"), (640, 320)), ((1, 3, 64, "w"), (128, 64)), ((1, 3, "h", 64), (64, 32))]
)
def test_sizes_that_are_free(
    tmp_path: Path, image: np.ndarray, shape: tuple[int | str, ...], size: tuple[int, int]
) -> None:
    model = constant_model(tmp_path / "m.onnx", yolov8_output((20, 16, 10, 8, 0.9, 0)), shape)
    scale = size[0] / 128
    (found,) = Detector(model).detect(image)
    assert found.box_px == pytest.approx((15 / scale - 0.5, 12 / scale - 0.5, 10 / scale, 8 / scale))


def test_the_long_side_of_a_free_model_can_be_chosen(tmp_path: Path, image: np.ndarray) -> None:
    meta = {"imgsz": "[256, 256]"}
    model = constant_model(tmp_path / "m.onnx", yolov8_output((20, 16, 10, 8, 0.9, 0)), (1, 3, "h", "w"), meta)
    widths = [Detector(model, long_side_px=side).detect(image)[0].box_px[2] for side in (None, 128, 512)]
    assert widths == pytest.approx([5, 10, 2.5])


@pytest.mark.parametrize("kind", [UINT8, FLOAT16])
def test_inputs_of_bytes_and_of_half_precision(tmp_path: Path, image: np.ndarray, kind: int) -> None:
    model = constant_model(tmp_path / "m.onnx", yolov8_output((20, 30, 10, 8, 0.9, 0)), input_type=kind)
    assert len(Detector(model).detect(image)) == 1


def test_a_box_in_the_border_alone_is_none(tmp_path: Path, image: np.ndarray) -> None:
    model = constant_model(tmp_path / "m.onnx", yolov8_output((32, 6, 20, 10, 0.9, 0)))
    assert Detector(model).detect(image) == []


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
    for content in (b"\x08\x07 not a model", b""):
        broken = tmp_path / "broken.onnx"
        broken.write_bytes(content)
        with pytest.raises(InputError, match=r"broken\.onnx: not a readable ONNX model") as caught:
            Detector(broken)
        assert "\n" not in str(caught.value)
    whole = constant_model(tmp_path / "whole.onnx", yolov8_output()).read_bytes()
    broken.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"broken\.onnx: not a readable ONNX model"):
        Detector(broken)


@pytest.mark.parametrize(
    ("shape", "kind", "told"),
    [
        ((1, 1, 64, 64), 1, r"unknown model input 1x1x64x64"),
        ((1, 4, 64, 64), 1, r"unknown model input 1x4x64x64"),
        ((1, 64, 64, 3), 1, r"unknown model input 1x64x64x3; .*channels first"),
        ((1, 3, 64), 1, r"unknown model input 1x3x64"),
        ((4, 3, 64, 64), 1, r"4 images at once; .*batch of 1"),
        ((1, 3, 64, 64), DOUBLE, r"tensor\(double\)"),
    ],
)
def test_models_with_another_input(tmp_path: Path, shape: tuple[int, ...], kind: int, told: str) -> None:
    model = constant_model(tmp_path / "other.onnx", yolov8_output(), shape, input_type=kind)
    with pytest.raises(InputError, match=told) as caught:
        Detector(model)
    assert "other.onnx" in str(caught.value)


def test_a_model_for_another_task_and_classes_that_do_not_fit(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="made to segment"):
        Detector(constant_model(tmp_path / "m.onnx", yolov8_output(), metadata={"task": "segment"}))
    three = {"names": "{0: 'a', 1: 'b', 2: 'c'}"}
    with pytest.raises(InputError, match="unknown model output 1x6x84 of 3 classes"):
        Detector(constant_model(tmp_path / "m.onnx", yolov8_output(), metadata=three))


@pytest.mark.parametrize("provider", ["cuda", "tensorrt", "openvino"])
def test_a_provider_that_is_not_installed(provider: Provider, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: ["CPUExecutionProvider"])
    with pytest.raises(InputError, match=rf"no {provider}, but cpu; .*pip install onnxruntime-") as caught:
        Detector(provider=provider)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("provider", ["cuda", "tensorrt", "openvino"])
def test_a_provider_that_does_not_start_is_not_replaced_in_silence(
    provider: Provider, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: list(runtime.NAMES.values()))
    with pytest.raises(InputError, match=provider):
        Detector(provider=provider)


def test_warm_up_runs_the_size_that_will_come(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    detector = Detector(constant_model(tmp_path / "m.onnx", yolov8_output(), (1, 3, "h", "w")))
    seen = []
    monkeypatch.setattr(detector._model, "run", lambda pixels: seen.append(pixels.shape) or yolov8_output())
    detector.warm_up(320, 192)
    assert seen == [(1, 3, 384, 640)]


@pytest.mark.parametrize("size", [(64, 64), (128, 64), (64, 96)])
def test_letterbox_maps_corners_onto_corners(size: tuple[int, int]) -> None:
    fitted = letterbox(np.full((60, 100, 3), 200, np.uint8), size)
    rows, columns = np.nonzero(fitted.canvas[..., 0] == 200)
    assert (columns.min(), rows.min()) == (fitted.left, fitted.top)
    assert columns.max() + 1 - fitted.left == pytest.approx(100 * fitted.scale, abs=0.51)
    assert rows.max() + 1 - fitted.top == pytest.approx(60 * fitted.scale, abs=0.51)


@pytest.mark.parametrize("shape", [(512, 1024), (511, 1023), (300, 500), (40, 90)])
def test_letterbox_keeps_places_to_a_fraction_of_a_pixel(shape: tuple[int, int]) -> None:
    height, width = shape
    y, x = np.mgrid[0:height, 0:width] + 0.5
    centre = 0.3 * width, 0.6 * height
    blob = 255 * np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / (2 * (0.08 * height) ** 2))
    fitted = letterbox(np.repeat(blob[..., None].astype(np.uint8), 3, axis=2), (128, 64))
    light = fitted.canvas[..., 0].astype(float)
    right, bottom = int(fitted.left + width * fitted.scale + 0.5), int(fitted.top + height * fitted.scale + 0.5)
    light[:, : fitted.left] = light[:, right:] = 0
    light[: fitted.top] = light[bottom:] = 0
    rows, columns = np.mgrid[0:64, 0:128] + 0.5
    seen = np.array([(light * columns).sum(), (light * rows).sum()]) / light.sum()
    assert (seen - [fitted.left, fitted.top]) / fitted.scale == pytest.approx(centre, abs=0.35 / fitted.scale)


def test_planes_order_and_scale() -> None:
    image = np.zeros((64, 64, 3), np.uint8)
    image[..., 2] = 255  # red, BGR
    assert planes(image)[0, :, 0, 0] == pytest.approx([1, 0, 0])
    assert planes(image, bgr_255=True)[0, :, 0, 0] == pytest.approx([0, 0, 255])
    assert planes(image, np.uint8)[0, :, 0, 0].tolist() == [255, 0, 0]
    half = planes(image, np.float16)
    assert half.dtype == np.float16
    assert half[0, :, 0, 0] == pytest.approx([1, 0, 0])


@pytest.mark.parametrize(
    ("image", "told"),
    [
        (np.zeros((64, 64), np.uint16), "uint16"),
        (np.zeros((64, 64, 3), np.float32), "float32"),
        (np.zeros((64, 64, 4), np.uint8), "64x64x4"),
        (np.zeros((64, 64, 2), np.uint8), "64x64x2"),
        (np.zeros((0, 0, 3), np.uint8), "0x0x3"),
    ],
)
def test_images_that_are_none(tmp_path: Path, image: np.ndarray, told: str) -> None:
    detector = Detector(constant_model(tmp_path / "m.onnx", yolov8_output((20, 30, 10, 8, 0.9, 0))))
    with pytest.raises(InputError, match=told):
        detector.detect(image)


def test_grey_images_in_both_shapes(tmp_path: Path, image: np.ndarray) -> None:
    detector = Detector(constant_model(tmp_path / "m.onnx", yolov8_output((20, 30, 10, 8, 0.9, 0))))
    assert detector.detect(image[..., 0]) == detector.detect(image[..., :1]) == detector.detect(image)


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


# overlap


boxes = st.tuples(*[st.floats(-50, 50)] * 2, *[st.floats(1, 80)] * 2)


@given(boxes, boxes)
def test_iou_is_symmetric_bounded_and_one_only_for_the_same(a: tuple[float, ...], b: tuple[float, ...]) -> None:
    assert iou(a, b) == pytest.approx(iou(b, a))
    assert 0 <= iou(a, b) <= 1 + 1e-12
    assert iou(a, a) == pytest.approx(1)
