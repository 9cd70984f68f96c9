"""`leadline capture` from pictures to files: what is told at once, what is saved, what is called enough."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from guided_scenes import SMALL, frame_of, held, picture, small_rig
from leadline import cli
from leadline.calibration.amiss import Fault, amiss
from leadline.calibration.board import find_corners
from leadline.config import Config
from leadline.pipeline.calibrate_cameras import calibrate
from leadline.pipeline.capture import CaptureReport, capture, new_sink
from leadline.pipeline.capture_board import BoardCapture
from leadline.pipeline.capture_steady import Steady
from leadline.pipeline.capture_target import TargetCapture
from leadline.rig import Rig
from leadline.rig_derivatives import Medium
from leadline.samples import Image, Sample, StereoFrame
from leadline.sinks.control import Wish
from leadline.sources import Source
from leadline.training.dataset import read_dataset
from leadline.wire.calibration_folder import read_calibration_folder
from leadline.wire.images import encode_png
from test_dataset import boxed
from test_evaluate_detector import block_model

RNG = np.random.default_rng(8)


# -- what is told at once ----------------------------------------------------------------------------------------------


def told(left: Image, right: Image) -> Fault | None:
    wrong = amiss((left, find_corners(left, SMALL)), (right, find_corners(right, SMALL)), SMALL)
    return None if wrong is None else wrong.fault


def shone_on(image: Image) -> Image:
    """A reflection on the middle of the board."""
    y, x = np.indices(image.shape)
    spot = 150 * np.exp(-((x - 340) ** 2 + (y - 180) ** 2) / (2 * 22.0**2))
    return np.clip(image + spot, 0, 255).astype(np.uint8)


def blurred(image: Image) -> Image:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 3.2), np.uint8)


def empty(image: Image) -> Image:
    return np.full_like(image, 110)


def dim(image: Image) -> Image:
    return np.asarray(100 + 0.08 * image, np.uint8)


def burnt(image: Image) -> Image:
    return np.clip(image.astype(float) * 1.8, 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("spoil", "fault"),
    [(shone_on, Fault.GLARE), (blurred, Fault.BLUR), (empty, Fault.ONE), (dim, Fault.FAINT), (burnt, Fault.BURNT)],
)
def test_what_is_wrong_with_one_picture_is_told(spoil: Callable[[Image], Image], fault: Fault) -> None:
    pair = [picture(small_rig(), side, held(0.6), RNG) for side in ("left", "right")]
    assert told(*pair) is None
    assert told(pair[0], spoil(pair[1])) is fault
    assert told(spoil(pair[0]), pair[1]) is fault
    assert told(empty(pair[0]), empty(pair[1])) is Fault.NONE


def steady_after(
    steps_px: list[float], *, period_s: float = 0.1, apart_ms: float | None = None, stills: bool = False
) -> list[bool]:
    steady, at = Steady(stills=stills), np.zeros((4, 2))
    out = []
    for number, step in enumerate(steps_px):
        at = at + np.array([step, 0.0])
        t_ns = round(number * period_s * 1e9)
        other = None if apart_ms is None else t_ns + round(apart_ms * 1e6)
        image = np.zeros((360, 640), np.uint8)
        frame = StereoFrame(t_ns, image, image, left_t_ns=None if other is None else t_ns, right_t_ns=other)
        out.append(steady.judge(frame, at))
    return out


def test_a_board_must_be_held_still() -> None:
    assert steady_after([0, 0, 0, 0, 0, 0]) == [False, False, False, False, True, True]
    assert not any(steady_after([3.0] * 12))  # 30 px/s
    assert steady_after([0.0] * 5 + [9.0] + [0.0] * 5)[5:9] == [False] * 4
    assert any(steady_after([1.0] * 8))
    assert not any(steady_after([1.0] * 8, apart_ms=40))  # it moves by 0.4 px between the two exposures


def test_stills_need_not_be_held() -> None:
    assert all(steady_after([50.0] * 4, period_s=2.0, stills=True))
    assert not any(steady_after([50.0] * 4, period_s=2.0))


# -- a session in pictures ---------------------------------------------------------------------------------------------


class Robot(Source):
    """Holds the board where the advice says: three pictures at rest, one every quarter of a second."""

    def __init__(self, task: BoardCapture, rig: Rig, seed: int = 0) -> None:
        super().__init__("robot")
        self.task, self.rig, self.rng = task, rig, np.random.default_rng(seed)
        self.places = 0

    def read(self) -> Iterator[Sample]:
        t_s = 0.0
        while self.places < 60:
            guide = self.task.guide
            goal = held() if guide is None or guide.advice is None else guide.advice.pose
            self.places += 1
            for _ in range(3):
                t_s += 0.25
                yield frame_of(self.rig, goal, t_s, self.rng)


def run(task: BoardCapture | TargetCapture, source: Source) -> CaptureReport:
    return capture(source, task, new_sink(task, source, "test"))


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, CaptureReport]:
    """A whole session of a robot."""
    out = tmp_path_factory.mktemp("capture") / "air"
    task = BoardCapture(out, SMALL, Medium.AIR)
    return out, run(task, Robot(task, small_rig()))


def test_a_session_ends_with_a_good_set(taken: tuple[Path, CaptureReport], tmp_path: Path) -> None:
    out, report = taken
    assert report.enough
    assert not report.missing
    assert report.next[0].startswith(f"next: leadline calibrate cameras --air {out} --board 7x5 --square 0.04")
    pairs = read_calibration_folder(out).pairs
    assert len(pairs) == report.count
    assert all(pair.right is not None for pair in pairs)
    notes = json.loads((out / "capture.json").read_text())
    assert notes["enough"] is True
    assert len([one for one in notes["shots"].values() if "set_aside" not in one]) == report.count
    found = calibrate(SMALL, tmp_path / "rig.yaml", air=out).calibration.rig
    assert found.left.fx == pytest.approx(480, rel=0.003)
    assert found.T_right_left.t_m[0] == pytest.approx(-0.063, rel=0.005)


def test_the_same_command_again_knows_that_it_is_enough(taken: tuple[Path, CaptureReport]) -> None:
    task = BoardCapture(taken[0], SMALL, Medium.AIR, patient=True)
    assert task.enough
    report = run(task, Robot(task, small_rig()))
    assert (report.looked_at, report.count) == (0, taken[1].count)


def test_a_killed_session_goes_on_with_what_is_whole(taken: tuple[Path, CaptureReport], tmp_path: Path) -> None:
    out = copied(taken[0], tmp_path, 6)
    (out / "left" / ".0007.png.part").write_bytes(b"half")
    (out / "right" / "0009.png").write_bytes(encode_png(np.zeros((360, 640), np.uint8)))
    task = BoardCapture(out, SMALL, Medium.AIR)
    assert task.status().count == 6
    assert not list(out.rglob("*.part"))
    assert (out / "set_aside" / "right" / "0009.png").exists()
    assert task.undo() == "Image 6 is taken out."
    assert len(list((out / "set_aside" / "left").iterdir())) == 1
    assert task.status().count == 5
    frame = frame_of(small_rig(), held(0.9, 0.1), 1.0, RNG)
    looks = [task.take(StereoFrame(frame.t_ns + k * 2 * 10**8, frame.left, frame.right)) for k in range(4)]
    assert [look.state for look in looks] in (["wait", "wait", "saved", "same"], ["same"] * 4)
    assert not task.finish()


def copied(out: Path, to: Path, count: int) -> Path:
    folder = to / "some"
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
        for path in sorted((out / side).iterdir())[:count]:
            (folder / side / path.name).write_bytes(path.read_bytes())
    (folder / "capture.json").write_text((out / "capture.json").read_text())
    return folder


# -- images of the target ----------------------------------------------------------------------------------------------


class Walk(Source):
    """A red block, at each of the places and sizes, before a changing wall; ``lazy``: always the same."""

    def __init__(self, *, lazy: bool = False) -> None:
        super().__init__("walk")
        self.lazy = lazy

    def read(self) -> Iterator[Sample]:
        rng = np.random.default_rng(4)
        for number in range(400):
            wall = cv2.resize(rng.integers(40, 160, (12, 20, 3), np.uint8), (320, 192))
            side = 80 if self.lazy else int(rng.choice([0, 10, 24, 48, 90, 150]))
            x, y = (100, 50) if self.lazy else (int(rng.uniform(0, 320 - side)), int(rng.uniform(0, 192 - side)))
            if side:
                cv2.rectangle(wall, (x, y), (x + side - 1, y + side - 1), (20, 30, 240), -1)
            yield StereoFrame(number * 10**8, np.asarray(wall, np.uint8), np.asarray(wall, np.uint8))


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return block_model(tmp_path_factory.mktemp("model") / "block.onnx")


def by_colour(out: Path, model: Path) -> TargetCapture:
    task = TargetCapture(out, model, Config())
    task.labeller.labels = boxed  # type: ignore[method-assign]
    return task


def test_target_images_are_a_set_for_training(tmp_path: Path, model: Path) -> None:
    out = tmp_path / "set"
    report = run(by_colour(out, model), Walk())
    assert report.enough, report.missing
    assert len(read_dataset(out).examples) == report.count
    assert {path.name for path in out.iterdir()} >= {
        "images",
        "labels",
        "annotations.json",
        "preview.html",
        "README.md",
    }
    again = by_colour(out, model)
    assert again.enough
    assert again.status().count == report.count


def test_pictures_of_one_kind_are_no_set(tmp_path: Path, model: Path) -> None:
    report = run(by_colour(tmp_path / "set", model), Walk(lazy=True))
    assert not report.enough
    assert any("under 1/16" in line for line in report.missing)
    assert any("of the picture" in line for line in report.missing)


def test_a_picture_can_be_kept_by_hand(tmp_path: Path, model: Path) -> None:
    task = by_colour(tmp_path / "set", model)
    source = Walk(lazy=True)
    sink = new_sink(task, source, "test")
    frames = list(source.read())[:3]
    source.read = lambda: iter(frames)  # type: ignore[method-assign, assignment, return-value]
    sink.control.ask(Wish.KEEP)  # before the first picture there is nothing to keep
    report = capture(source, task, sink, say=lambda words: sink.control.ask(Wish.KEEP) if "Saved" in words else None)
    assert report.count > 1


# -- the command line --------------------------------------------------------------------------------------------------


def test_a_folder_of_stills_that_is_not_enough(
    taken: tuple[Path, CaptureReport], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    some = copied(taken[0], tmp_path, 5)
    (some / "capture.json").unlink()
    call = ["capture", str(some), "--out", str(tmp_path / "out"), "--board", "7x5", "--square", "0.04"]
    assert cli.main(call) == 1
    said = capsys.readouterr().out
    assert "NOT enough: 5 images in" in said
    assert "19 boards more in all" in said
    assert "the same command goes on" in said
    assert "Saved: image 5. 5 of 24. Hold the board" in said
    assert len(read_calibration_folder(tmp_path / "out").pairs) == 5


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "images of what?"),
        (["--board", "7x5", "--square", "0.04", "--target"], "two kinds"),
        (["--board", "7x5", "--square", "40"], "too large"),
        (["--board", "7x5", "--square", "0.04", "--model", "x.onnx"], "--model is for --target"),
        (["--board", "7x5", "--square", "0.04", "--medium", "water"], "captured with medium air, this is water"),
        (["--board", "8x5", "--square", "0.04"], "captured with board 7x5 0.04, this is 8x5 0.04"),
        (["--target"], "captured of a board, this is target"),
        (["--board", "7x5", "--square", "0.04", "--rig", "rendered"], "the rig is for 1920x1080"),
    ],
)
def test_mistakes_get_one_line(
    taken: tuple[Path, CaptureReport],
    tmp_path: Path,
    options: list[str],
    words: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    stills = copied(taken[0], tmp_path, 2)
    (stills / "capture.json").unlink()
    out = copied(taken[0], tmp_path / "begun", 2)
    assert cli.main(["capture", str(stills), "--out", str(out), *options]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1


def test_other_folders_are_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    call = ["--out", str(tmp_path), "--board", "7x5", "--square", "0.04"]
    assert cli.main(["capture", "sim:demo", *call]) == 2
    assert "holds something that is no guided capture" in capsys.readouterr().err
    assert cli.main(["capture", str(tmp_path / "nowhere"), *call]) == 2
    assert cli.main(["capture", str(tmp_path), *call]) == 2  # a folder without images
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.mark.data
@pytest.mark.parametrize("medium", ["air", "water"])
def test_the_rendered_set_is_good_but_does_not_reach_everywhere(
    data_dir: Path, tmp_path: Path, medium: str, capsys: pytest.CaptureFixture[str]
) -> None:
    source = data_dir / "rendered_dives" / f"calib_{medium}"
    call = ["capture", str(source), "--out", str(tmp_path / "out"), "--board", "11x8", "--square", "0.030"]
    assert cli.main([*call, "--medium", medium]) == 1
    said = capsys.readouterr().out
    assert "NOT enough: 20 images" in said
    assert "fields of the left picture" in said
    notes = json.loads((tmp_path / "out" / "capture.json").read_text())
    assert "good to ±0." in notes["quality"]
