"""The engine yolov8n, where the user has installed Ultralytics (AGPL-3.0; never a dependency of leadline)."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from tests.training_sets import voc

from leadline.cli import main
from leadline.recognition.detector import Detector

needs_ultralytics = pytest.mark.skipif(
    find_spec("ultralytics") is None or find_spec("torchvision") is None,
    reason="Ultralytics is not installed: AGPL-3.0, the user's own choice (pip install ultralytics)",
)
SMALL = ["--engine", "yolov8n", "--epochs", "2", "--size", "64", "--threads", "1"]


@needs_ultralytics
def test_from_a_set_to_a_model_of_the_same_kind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(0)
    images = {}
    for clip in "abcde":
        for k in range(4):
            x, y, side = (int(v) for v in (rng.uniform(2, 30), rng.uniform(2, 20), rng.uniform(14, 26)))
            images[f"{clip}{k}.png"] = [("ball", x, y, x + side, y + side)]
    out = tmp_path / "out"
    assert main(["train", str(voc(tmp_path / "set", images)), "--out", str(out), *SMALL]) == 0
    assert "AGPL-3.0" in capsys.readouterr().out
    about = Detector(out / "model.onnx").metadata
    assert about["engine"] == "yolov8n"
    assert about["license"].startswith("AGPL-3.0")
    assert len((out / "history.csv").read_text().splitlines()) == 3


def test_its_licence_is_in_the_help() -> None:
    page = subprocess.run(
        [sys.executable, "-m", "leadline", "train", "--help"], capture_output=True, text=True, check=True
    )
    assert "AGPL-3.0" in page.stdout


def test_its_own_recipe_unless_something_else_is_asked() -> None:
    from leadline.training.settings import TrainConfig  # noqa: PLC0415

    paper = TrainConfig.model_validate({"engine": "yolov8n"})
    assert (paper.epochs, paper.batch, paper.mosaic, paper.size, paper.patience) == (50, 4, 1.0, 640, 0)
    assert TrainConfig.model_validate({"engine": "yolov8n", "size": 320}).size == 320
    ours = TrainConfig()
    assert (ours.epochs, ours.batch) == (50, 4)
