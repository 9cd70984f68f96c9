"""`leadline dataset`: which frames are drawn, what is written about them, and bad input."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from leadline import cli
from leadline.errors import InputError
from leadline.pipeline.dataset import draw_dataset
from leadline.pipeline.dataset_choice import Candidate, candidate, choose_frames
from leadline.pipeline.dataset_labels import Labels
from leadline.recognition.track import iou
from leadline.samples import Detection, Sample, StereoFrame
from leadline.sources import Source
from leadline.training.dataset import read_dataset
from leadline.wire.dive_writer import write_dive
from test_evaluate_detector import block_model

WIDTH, HEIGHT = 160, 96


def texture(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.asarray(cv2.resize(rng.integers(40, 160, (24, 40, 3), np.uint8), (WIDTH, HEIGHT)), np.uint8)


def approach(count: int = 40) -> list[StereoFrame]:
    """A red block grows before a wall that hardly moves; every tenth frame is blurred, the last ten stand still."""
    out = []
    for k in range(count):
        side = 6 + 2 * min(k, count - 10)
        image = np.roll(texture(), min(k, count - 10), axis=1)
        cv2.rectangle(image, (20, 10), (20 + side - 1, 10 + side - 1), (20, 30, 240), -1)
        image = np.asarray(cv2.add(image, np.random.default_rng(k).integers(0, 3, image.shape, np.uint8)), np.uint8)
        if k % 10 == 5:
            image = np.asarray(cv2.blur(image, (15, 1)), np.uint8)
        out.append(StereoFrame(k * 10**8, image, image, name=f"l{k}.png"))
    return out


def boxed(frame: StereoFrame) -> Labels:
    rows, columns = np.nonzero((frame.left[..., 2] > 200) & (frame.left[..., 1] < 60))
    if not len(rows):
        return Labels((), None, ("nothing found",))
    x, y = float(columns.min()), float(rows.min())
    box = (x - 0.5, y - 0.5, float(columns.max() + 1 - x), float(rows.max() + 1 - y))
    score = 0.5 if box[2] < 20 else 0.9
    return Labels((Detection(box, score, "ball"),), None, ("score 0.50",) if score < 0.6 else ())


class Recording(Source):
    def __init__(self, name: str, frames: list[StereoFrame]) -> None:
        super().__init__(name, frame_count=len(frames))
        self.frames = frames

    def read(self) -> Iterator[Sample]:
        return iter(self.frames)


class Fake:
    """Labels by colour, recordings by name."""

    provenance = "colour"

    def __init__(self, **recordings: list[StereoFrame]) -> None:
        self.names, self.recordings = ["ball"], recordings

    def open(self, spec: str) -> tuple[Source, Iterator[tuple[StereoFrame, Labels]]]:
        source = Recording(spec, self.recordings[spec])
        return source, ((f, boxed(f)) for f in source if isinstance(f, StereoFrame))


def candidates(frames: list[StereoFrame]) -> list[Candidate]:
    return [candidate(0, k, frame, boxed(frame)) for k, frame in enumerate(frames)]


def test_blurred_frames_are_not_drawn() -> None:
    chosen = {c.number for c in choose_frames(candidates(approach()), 40)}
    assert not chosen & {5, 15, 25, 35}
    assert len(chosen) > 20


def test_of_frames_that_are_alike_one_is_drawn() -> None:
    chosen = [c.number for c in choose_frames(candidates(approach()), 40)]
    assert sum(number >= 30 for number in chosen) == 1
    still = candidates([approach()[3]] * 12)
    assert len(choose_frames(still, 10)) == 1
    assert choose_frames([], 5) == []


def test_all_distances_are_drawn_alike() -> None:
    """Most frames show the target far away, few of them near: in the set both are as many."""
    frames = []
    for k, side in enumerate([8] * 30 + [60] * 7):
        image = texture(k)
        cv2.rectangle(image, (20, 10), (20 + side - 1, 10 + side - 1), (20, 30, 240), -1)
        frames.append(StereoFrame(k, image, image))
    chosen = [c.size for c in choose_frames(candidates(frames), 10)]
    assert len(set(chosen)) == 2
    assert chosen.count(max(chosen)) == chosen.count(min(chosen)) == 5


def test_empty_frames_are_a_tenth() -> None:
    empty = [StereoFrame(k, np.roll(texture(9), 3 * k, axis=1), texture(), name=f"{k}") for k in range(20)]
    mixed = [candidate(0, k, f, boxed(f)) for k, f in enumerate([*empty, *approach()])]
    chosen = choose_frames(mixed, 20)
    assert sum(c.size == 0 for c in chosen) == 2
    assert len(choose_frames(mixed[:20], 10)) == 10  # where there is nothing else, they are what there is


def test_the_set_is_read_by_training_as_it_is(tmp_path: Path) -> None:
    other = [replace(frame, left=frame.left[::-1]) for frame in approach(20)]
    labeller = Fake(dive=approach(), other=other)
    report = draw_dataset(["dive", "other"], tmp_path / "set", labeller, count=24)
    assert len(report.items) == 24
    assert report.looked_at == 60
    dataset = read_dataset(tmp_path / "set")
    assert dataset.format == "YOLO"
    assert dataset.names == ("ball",)
    assert dataset.notices == ()
    assert len(dataset.examples) == 24
    assert {example.clip.split("/")[-1] for example in dataset.examples} == {"dive_", "other_"}
    for example in dataset.examples:
        image = cv2.imread(str(example.image))
        truth = boxed(StereoFrame(0, image, image)).boxes[0].box_px
        x0, y0, x1, y1 = example.boxes[0]
        assert iou((x0 - 0.5, y0 - 0.5, x1 - x0, y1 - y0), truth) > 0.85  # JPEG's edges


def test_coco_and_tasks_say_the_same_with_score_and_provenance(tmp_path: Path) -> None:
    report = draw_dataset(["dive"], tmp_path / "set", Fake(dive=approach()), count=12)
    coco_file = tmp_path / "set" / "annotations.json"
    yolo, coco = read_dataset(tmp_path / "set"), read_dataset(coco_file)
    for a, b in zip(yolo.examples, coco.examples, strict=True):
        assert a.image == b.image
        assert a.boxes == pytest.approx(b.boxes, abs=0.02)
    content = json.loads(coco_file.read_text())
    assert {note["score"] for note in content["annotations"]} == {0.5, 0.9}
    assert content["annotations"][0]["attributes"]["provenance"] == "colour"
    tasks = json.loads((tmp_path / "set" / "label_studio.json").read_text())
    for task, item, example in zip(tasks, report.items, yolo.examples, strict=True):
        result = task["predictions"][0]["result"][0]
        value = result["value"]
        percent = np.array([value["x"], value["y"], value["x"] + value["width"], value["y"] + value["height"]])
        assert percent * np.tile([WIDTH, HEIGHT], 2) / 100 == pytest.approx(example.boxes[0], abs=0.02)
        assert task["data"]["image"].endswith(f"images/{item.file}")


def test_doubtful_frames_come_first(tmp_path: Path) -> None:
    report = draw_dataset(["dive"], tmp_path / "set", Fake(dive=approach()), count=12)
    with (tmp_path / "set" / "review.csv").open() as file:
        rows = list(csv.DictReader(file))
    looks = [row["look"] for row in rows]
    assert looks == sorted(looks)  # first, then later
    assert looks.count("first") == report.first > 0
    assert {row["lowest_score"] for row in rows[: report.first]} == {"0.500"}
    page = (tmp_path / "set" / "preview.html").read_text()
    assert page.count("data:image/jpeg") == 12
    assert page.index(rows[0]["image"]) < page.index(rows[-1]["image"])
    assert "12 frames, pre-labelled by colour" in (tmp_path / "set" / "README.md").read_text()


def test_the_same_recordings_give_the_same_set(tmp_path: Path) -> None:
    for name in "ab":
        draw_dataset(["dive"], tmp_path / name, Fake(dive=approach()), count=10)
    files = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*") if p.is_file())
    assert len(files) == 10 + 10 + 6
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_nothing_is_overwritten_and_bad_recordings_leave_nothing(tmp_path: Path) -> None:
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="something already"):
        draw_dataset(["dive"], tmp_path / "set", Fake(dive=approach()))
    assert (tmp_path / "set" / "mine.txt").read_text() == "mine"
    with pytest.raises(InputError, match="no frame can be read"):
        draw_dataset(["dive"], tmp_path / "new", Fake(dive=[]))
    assert not list((tmp_path / "new").iterdir())


def test_frames_of_which_nobody_knows_are_not_taken_for_empty_ones(tmp_path: Path) -> None:
    class Unsure(Fake):
        def open(self, spec: str) -> tuple[Source, Iterator[tuple[StereoFrame, Labels]]]:
            source, frames = super().open(spec)
            return source, ((f, labels if k % 2 else Labels(known=False)) for k, (f, labels) in enumerate(frames))

    report = draw_dataset(["dive"], tmp_path / "set", Unsure(dive=approach()))
    assert all(item.labels.known and item.t_ns // 10**8 % 2 for item in report.items)
    assert any("20 frames left out" in line for line in report.notices)


def dive_folder(path: Path) -> Path:
    write_dive(path, approach(16))
    return path


def test_the_command_with_a_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dive, model, out = dive_folder(tmp_path / "dive"), block_model(tmp_path / "m.onnx"), tmp_path / "set"
    assert cli.main(["dataset", str(dive), "--model", str(model), "--out", str(out), "--count", "6"]) == 0
    shown = capsys.readouterr().out
    assert "6 of 16 frames" in shown
    assert "m.onnx" in shown
    names = sorted(p.name for p in (out / "images").iterdir())
    assert names[0] == "dive_0000.png"
    originals = {p.read_bytes() for p in dive.glob("*.png")}
    assert all(p.read_bytes() in originals for p in (out / "images").iterdir())  # the source's own bytes
    assert cli.main(["dataset", str(dive), "--model", str(model), "--out", str(out)]) == 2


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["none"], "no such file or folder"),
        (["dive", "--label", "range"], "has no rig"),
        (["dive", "--label", "range", "--model", "m.onnx"], "two answers"),
        (["dive", "--target", "sphere:0.3"], "--label range"),
        (["sim:demo", "--label", "range", "--target", "plane"], "a plane has no box of its own"),
        (["sim:nothing"], "nothing"),
        (["dive", "--model", "none.onnx"], "no such model"),
    ],
)
def test_bad_input_gets_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str], told: str
) -> None:
    monkeypatch.chdir(tmp_path)
    dive_folder(tmp_path / "dive")
    assert cli.main(["dataset", *arguments, "--out", "set"]) == 2
    line = capsys.readouterr().err
    assert told in line
    assert line.count("\n") == 1
    assert not (tmp_path / "set").exists()


@pytest.mark.data
def test_labels_by_beam_and_range_lie_on_the_rendered_ball(data_dir: Path, tmp_path: Path) -> None:
    """No detector: the laser says where to look, the outline does the rest."""
    dive = data_dir / "rendered_dives" / "approach_ball_turbid"
    arguments = ["--label", "range", "--rig", "rendered", "--target", "sphere:0.34", "--name", "ball"]
    assert cli.main(["dataset", str(dive), *arguments, "--out", str(tmp_path / "set"), "--count", "12"]) == 0
    truth = {round(f["t_s"], 3): f["bbox_left_px"] for f in json.loads((dive / "truth.json").read_text())["frames"]}
    content = json.loads((tmp_path / "set" / "annotations.json").read_text())
    assert len(content["images"]) == len(content["annotations"]) == 12
    for image, note in zip(content["images"], content["annotations"], strict=True):
        x0, y0, x1, y1 = truth[round(float(image["t_s"]), 3)]
        assert iou(tuple(note["bbox"]), (x0, y0, x1 - x0, y1 - y0)) > 0.98
