"""`leadline train` from a set to an ONNX file: what it writes, going on after a kill, and what it says to mistakes."""

# ruff: noqa: E402

from __future__ import annotations

import ast
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")

from tests.training_sets import voc

from leadline.cli import main
from leadline.recognition.detector import Detector

SMALL = ["--epochs", "3", "--size", "64", "--threads", "1"]


@pytest.fixture(scope="module")
def labelled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five clips of four pictures of an orange block."""
    rng = np.random.default_rng(0)
    images = {}
    for clip in "abcde":
        for k in range(4):
            x, y, side = (int(v) for v in (rng.uniform(2, 30), rng.uniform(2, 20), rng.uniform(14, 26)))
            images[f"{clip}{k}.png"] = [("ball", x, y, x + side, y + side)]
    return voc(tmp_path_factory.mktemp("set"), images)


@pytest.fixture(scope="module")
def trained(labelled: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("trained") / "out"
    assert main(["train", str(labelled), "--out", str(out), *SMALL]) == 0
    return out


def weights(model: Path) -> dict[str, bytes]:
    return {
        tensor.name: onnx.numpy_helper.to_array(tensor).tobytes() for tensor in onnx.load(str(model)).graph.initializer
    }


def test_the_model_says_what_it_is_and_where_it_comes_from(trained: Path, labelled: Path) -> None:
    about = Detector(trained / "model.onnx").metadata
    assert ast.literal_eval(about["names"]) == {0: "ball"}
    assert ast.literal_eval(about["imgsz"]) == [64, 64]
    assert about["engine"] == "leadline"
    assert "Apache-2.0" in about["license"]
    assert "20 images (Pascal VOC)" in about["data"]
    record = yaml.safe_load((trained / "settings.yaml").read_text())
    assert about["data_sha256"] == record["data"]["sha256"]
    assert json.loads(about["settings"]) == record["settings"]
    assert record["settings"]["epochs"] == 3
    split = json.loads(about["split"])
    assert {part: count["images"] for part, count in split.items()} == {"train": 12, "val": 4, "test": 4}


def test_what_stands_beside_the_model(trained: Path) -> None:
    rows = (trained / "split.csv").read_text().splitlines()
    assert rows[0] == "image,clip,part"
    assert len(rows) == 21
    history = (trained / "history.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in history] == ["epoch", "1", "2", "3"]
    assert {"pr_curve.svg", "summary.json", "detector.html"} <= {file.name for file in (trained / "test").iterdir()}


def test_the_split_can_be_given_back(trained: Path, labelled: Path, tmp_path: Path) -> None:
    from leadline.pipeline.train import plan_training  # noqa: PLC0415
    from leadline.training.settings import TrainConfig  # noqa: PLC0415

    plan = plan_training(labelled, tmp_path / "out", TrainConfig(seed=9), clips=trained / "split.csv")
    images = {(e.image.name, part) for part in ("train", "val", "test") for e in getattr(plan.split, part)}
    rows = (line.split(",") for line in (trained / "split.csv").read_text().splitlines()[1:])
    assert images == {(image, part) for image, _, part in rows}


def test_a_killed_training_goes_on_to_the_same_weights(trained: Path, labelled: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "leadline", "train", str(labelled), "--out", str(out), *SMALL]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env={**os.environ, "OMP_NUM_THREADS": "1"})
    deadline = time.monotonic() + 300
    while not (out / "history.csv").exists() and time.monotonic() < deadline:
        assert process.poll() is None, "it ended before it could be killed"
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not (out / "model.onnx").exists()
    assert main(["train", str(labelled), "--out", str(out), *SMALL]) == 0
    assert weights(out / "model.onnx") == weights(trained / "model.onnx")

    def figures(folder: Path) -> list[list[str]]:
        return [row.split(",")[:-1] for row in (folder / "history.csv").read_text().splitlines()]  # without the seconds

    assert figures(out) == figures(trained)


def test_another_training_is_not_overwritten(trained: Path, labelled: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = weights(trained / "model.onnx")
    assert main(["train", str(labelled), "--out", str(trained), *SMALL, "--batch", "8"]) == 2
    assert "holds another training (batch 4 there, 8 now); give a new folder to --out" in capsys.readouterr().err
    assert main(["train", str(labelled), "--out", str(trained), *SMALL, "--classes", "buoy=ball"]) == 2
    assert "holds another training (other images or classes)" in capsys.readouterr().err
    assert weights(trained / "model.onnx") == before


def test_a_checkpoint_of_another_version_is_told(
    labelled: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from leadline.pipeline.train import plan_training  # noqa: PLC0415
    from leadline.training.settings import TrainConfig  # noqa: PLC0415

    out = tmp_path / "out"
    out.mkdir()
    settings = TrainConfig(epochs=3, size=64, threads=1)
    (out / "settings.yaml").write_text(yaml.safe_dump(plan_training(labelled, tmp_path / "new", settings).record))
    state = {"network": {"weight": torch.zeros(1)}}
    for content in ({"trainer": state, "best": {}, "history": []}, {"other": 1}):
        torch.save(content, out / "checkpoint.pt")
        assert main(["train", str(labelled), "--out", str(out), *SMALL]) == 2
        assert "checkpoint.pt: is no checkpoint of this version of leadline; give a new" in capsys.readouterr().err
    (out / "checkpoint.pt").write_bytes(b"half")
    assert main(["train", str(labelled), "--out", str(out), *SMALL]) == 2
    assert "is no checkpoint of this version" in capsys.readouterr().err


def test_a_finished_training_is_only_judged_again(trained: Path, labelled: Path) -> None:
    before = (trained / "model.onnx").stat().st_mtime_ns
    (trained / "test" / "pr_curve.svg").unlink()
    assert main(["train", str(labelled), "--out", str(trained), *SMALL]) == 0
    assert (trained / "model.onnx").stat().st_mtime_ns == before
    assert (trained / "test" / "pr_curve.svg").exists()


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--size", "100"], "--size: 100: Input should be a multiple of 32"),
        (["--engine", "yolov9"], "--engine: yolov9: Input should be 'leadline' or 'yolov8n'"),
        (["--epochs", "0"], "--epochs: 0: Input should be greater than or equal to 1"),
        (["--classes", "boat"], "no class 'boat'; its classes: ball"),
        (["--clips", "none.csv"], "none.csv: cannot be read"),
    ],
)
def test_wrong_calls_get_one_line(
    labelled: Path, tmp_path: Path, arguments: list[str], line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", str(labelled), "--out", str(tmp_path / "out"), *arguments]) == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_folders_that_must_not_be_written_to(
    labelled: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", str(labelled), "--out", str(labelled / "out")]) == 2
    assert "lies within the set; give another folder to --out" in capsys.readouterr().err
    assert main(["train", str(tmp_path / "nosuch"), "--out", str(tmp_path / "out")]) == 2
    assert "nosuch: no such folder or file" in capsys.readouterr().err  # not: out lies within it
    (tmp_path / "letter.txt").write_text("mine")
    assert main(["train", str(labelled), "--out", str(tmp_path)]) == 2
    assert "holds something that is not a training" in capsys.readouterr().err
    assert main(["train", str(labelled), "--out", str(tmp_path / "letter.txt")]) == 2
    assert "holds something that is not a training" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("engine", "missing", "line"),
    [
        ("leadline", "torch", "training needs torch, which is not installed; pip install 'leadline[train]'"),
        ("leadline", "onnx", "training needs onnx, which is not installed; pip install 'leadline[train]'"),
        (
            "yolov8n",
            "ultralytics",
            "the engine yolov8n needs ultralytics, which is not installed; pip install ultralyt",
        ),
    ],
)
def test_a_missing_extra_is_told_with_the_command(
    labelled: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    engine: str,
    missing: str,
    line: str,
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    assert main(["train", str(labelled), "--out", str(tmp_path / "out"), "--engine", engine]) == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_out_of_time_it_ends_with_a_model(labelled: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert main(["train", str(labelled), "--out", str(out), "--size", "64", "--threads", "1", "--minutes", "0.01"]) == 0
    assert len((out / "history.csv").read_text().splitlines()) < 50
    assert (out / "model.onnx").exists()


def test_one_corrupt_file_does_not_end_it(labelled: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from leadline.pipeline.train import plan_training  # noqa: PLC0415
    from leadline.training.settings import TrainConfig  # noqa: PLC0415

    rng = np.random.default_rng(1)
    root = voc(tmp_path / "set", {f"{c}{k}.png": [("ball", 5, 5, 30, 30)] for c in "abcde" for k in range(4)})
    broken = root / "Images" / f"c{rng.integers(4)}.png"
    broken.write_bytes(broken.read_bytes()[:40])
    plan = plan_training(root, tmp_path / "out", TrainConfig())
    assert len(plan.data.examples) == 19
    assert f"1 images left out, the first: {broken}: not a readable image" in plan.data.notices
