"""Where torch is installed: the assignment, a short training, and ONNX against torch."""

# ruff: noqa: E402

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

from leadline.recognition.detector import Detector, letterbox
from leadline.training.dataset import Example
from leadline.training.export import export_onnx
from leadline.training.loss import detection_loss, heat_of
from leadline.training.network import STRIDES, Exported, cell_centres
from leadline.training.train import Pool, Settings, train

pytestmark = pytest.mark.long


def test_heat_is_one_at_the_centre_and_only_on_levels_that_fit() -> None:
    centres = [cell_centres(256 // s, 256 // s, s, torch.device("cpu")) for s in STRIDES]
    cells = torch.cat(centres)
    strides = torch.cat([torch.full((len(c),), float(s)) for c, s in zip(centres, STRIDES, strict=True)])
    truth = torch.tensor([[10.0, 20, 40, 50], [0, 0, 256, 200], [100, 100, 156, 156]])
    heat = heat_of(cells, strides, truth)
    for k, expected in enumerate(({8.0}, {32.0}, {8.0, 16.0})):
        assert set(strides[heat[k] > 0.01].tolist()) == expected
        hot = cells[heat[k] == 1]
        assert 1 <= len(hot) <= 4 * len(expected)
        middle = (truth[k, :2] + truth[k, 2:]) / 2
        assert ((hot - middle).abs() <= strides[heat[k] == 1][:, None] / 2).all()


def test_nothing_is_taught_in_an_unsure_box() -> None:
    cells = cell_centres(8, 8, 8, torch.device("cpu")), torch.full((64,), 8.0)
    logits = torch.full((1, 64, 1), 3.0, requires_grad=True)
    boxes = torch.cat([cells[0] - 6, cells[0] + 6], -1)[None]
    unsure = torch.tensor([[0.0, 0, 32, 64]]), torch.tensor([-1])
    detection_loss(logits, boxes, cells, [unsure[0]], [unsure[1]]).backward()
    assert (logits.grad[0, :, 0].reshape(8, 8)[:, :4] == 0).all()
    assert (logits.grad[0, :, 0].reshape(8, 8)[:, 4:] > 0).all()


def test_short_training_learns_and_the_export_says_the_same(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    examples = []
    for k in range(40):
        image = np.full((128, 128, 3), (120, 90, 20), np.uint8)
        x, y, r = (int(v) for v in (rng.uniform(30, 98), rng.uniform(30, 98), rng.uniform(14, 28)))
        cv2.circle(image, (x, y), r, (20, 90, 230), -1, cv2.LINE_AA)
        cv2.imwrite(str(tmp_path / f"{k}.png"), image)
        box = np.array([[x - r, y - r, x + r + 1, y + r + 1]], np.float32)
        examples.append(Example(tmp_path / f"{k}.png", box, np.zeros(1, np.int64)))
    losses: list[float] = []
    settings = Settings(
        steps=70, batch=8, sizes=((128, 128),), size_weights=(1.0,), mosaic=0.0, warm_up=10, average=0.9
    )
    network = train([Pool(examples[:32], 1.0)], 1, settings, lambda _, loss: losses.append(loss))
    assert np.mean(losses[-10:]) < 0.6 * np.mean(losses[:10])
    file = tmp_path / "model.onnx"
    export_onnx(network, file, ["ball"], 128, {"license": "Apache-2.0"})
    detector = Detector(file, score=0.05)
    image = cv2.imread(str(examples[35].image))
    blob, _, _ = letterbox(image, (128, 128), bgr_255=False)
    with torch.no_grad():
        expected = Exported(network)(torch.from_numpy(blob))[0].numpy()
    (answer,) = detector._session.run(None, {"images": blob})
    assert answer[0] == pytest.approx(expected, abs=1e-3)
    best = detector.detect(image)[0]
    assert best.label == "ball"
    assert best.box_px[0] + 0.5 == pytest.approx(examples[35].boxes[0, 0], abs=12)
