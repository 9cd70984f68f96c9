"""Where torch is installed: the assignment, a short training, and ONNX against torch."""

# ruff: noqa: E402

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
import onnxruntime
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

from tests.training_scenes import write_dives

from leadline.cli import main
from leadline.evaluation.detection import evaluate_detections
from leadline.recognition.detector import Detector
from leadline.recognition.track import iou
from leadline.training.dataset import Example, read_dataset
from leadline.training.engines.in_torch import TorchDetector
from leadline.training.export import export_onnx
from leadline.training.loss import detection_loss, heat_of
from leadline.training.network import STRIDES, Exported, Network, cell_centres
from leadline.training.train import Pool, Settings, Trainer, train

QUICK = ["--epochs", "15", "--size", "320", "--threads", "1"]


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


def test_a_score_is_pulled_all_the_way_to_what_its_box_is_worth() -> None:
    """Cross entropy's gradient, score minus quality, undamped however near; 1 for the very box."""
    cells = cell_centres(8, 8, 8, torch.device("cpu")), torch.full((64,), 8.0)
    truth = torch.tensor([[16.0, 16, 40, 40]])  # its centre is that of cell (3, 3)
    for shift, quality in ((0.0, 1.0), (8.0, 0.75)):
        logits = torch.full((1, 64, 1), 0.8473, requires_grad=True)  # a score of 0.7
        boxes = truth.repeat(64, 1)[None] + torch.tensor([shift, 0, shift, 0])
        detection_loss(logits, boxes, cells, [truth], [torch.zeros(1, dtype=torch.long)]).backward()
        assert float(logits.grad[0, 3 * 8 + 3, 0]) == pytest.approx(0.7 - quality, abs=1e-3)


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
    exported = Detector(file, score=0.01, nms_iou=0.5)
    in_torch = TorchDetector(network, ["ball"], 128)
    best = 0.0
    for example in examples[32:]:
        image = np.asarray(cv2.imread(str(example.image)), np.uint8)
        found, expected = exported.detect(image), in_torch.detect(image)
        assert [d.score for d in found] == pytest.approx([d.score for d in expected], abs=1e-3)
        assert [d.box_px for d in found[:3]] == [pytest.approx(d.box_px, abs=0.05) for d in expected[:3]]
        assert {d.label for d in found} <= {"ball"}
        best = max([best, *(iou(d.box_px, _rectangle(example)) for d in found[:1])])
    assert best > 0.5


def test_export_is_the_network_at_any_size(tmp_path: Path) -> None:
    torch.manual_seed(0)
    network = Network(3).eval()
    file = tmp_path / "model.onnx"
    export_onnx(network, file, ["a", "b", "c"], 128, {})
    session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
    for height, width in ((64, 96), (160, 128)):
        image = torch.rand(1, 3, height, width)
        with torch.no_grad():
            expected = Exported(network)(image).numpy()
        (answer,) = session.run(None, {"images": image.numpy()})
        assert answer.shape == (1, 7, sum(height * width // s**2 for s in STRIDES))
        assert answer == pytest.approx(expected, abs=2e-3, rel=1e-4)


def test_steps_after_a_saved_state_are_the_same_bit_for_bit(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "1.png"), np.random.default_rng(0).integers(0, 255, (64, 64, 3)).astype(np.uint8))
    example = Example(tmp_path / "1.png", np.array([[5, 5, 40, 40]], np.float32), np.zeros(1, np.int64))
    settings = Settings(steps=6, batch=2, sizes=((64, 64),), size_weights=(1.0,), warm_up=2)
    whole = Trainer([Pool([example], 1.0)], 1, settings)
    losses = [whole.step() for _ in range(6)]
    first = Trainer([Pool([example], 1.0)], 1, settings)
    assert [first.step() for _ in range(3)] == losses[:3]
    torch.save(first.state(), tmp_path / "state.pt")
    second = Trainer([Pool([example], 1.0)], 1, settings)
    second.load(torch.load(tmp_path / "state.pt", weights_only=True))
    assert [second.step() for _ in range(3)] == losses[3:]
    for a, b in zip(whole.average.state_dict().values(), second.average.state_dict().values(), strict=True):
        assert torch.equal(a, b)


def _rectangle(example: Example) -> tuple[float, float, float, float]:
    x0, y0, x1, y1 = example.boxes[0].tolist()
    return x0 - 0.5, y0 - 0.5, x1 - x0, y1 - y0


@pytest.mark.long
def test_two_hundred_images_in_five_minutes_of_processor_time(tmp_path: Path) -> None:
    """200 labelled images of 25 simulated dives with one orange ball (see training_scenes; no other round things in
    them) -> AP50 of at least 0.9 on 25 other dives, by the command line, splitting and judging included."""
    labelled = write_dives(tmp_path / "set", range(100, 125), 8)
    others = write_dives(tmp_path / "other", range(200, 225), 4)
    began = time.process_time()
    assert main(["train", str(labelled), "--out", str(tmp_path / "out"), *QUICK]) == 0
    spent_s = time.process_time() - began
    examples = read_dataset(others).examples
    detector = Detector(tmp_path / "out" / "model.onnx", score=0.01, threads=1)
    found = {str(e.image): detector.detect(np.asarray(cv2.imread(str(e.image)), np.uint8)) for e in examples}
    truth = {str(e.image): [_rectangle(e)] if len(e.boxes) else [] for e in examples}
    quality = evaluate_detections(found, truth)
    measured = f"AP50 {quality.ap50:.3f}, AP50-95 {quality.ap50_95:.3f} after {spent_s:.0f} s of processor time"
    assert quality.ap50 >= 0.9, measured
    assert spent_s <= 300, measured
