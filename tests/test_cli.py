"""End to end through the command line, on a small simulated dive."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import leadline
from leadline.cli import main
from leadline.errors import InputError
from leadline.evaluation.accuracy import by_stage, compare
from leadline.pipeline import build, loop
from leadline.pipeline.begin import begun
from leadline.pipeline.demo import demo_job
from leadline.pipeline.worker import Worker
from leadline.recognition.boxes import Boxes
from leadline.samples import NS_PER_S, Detection, LaserRange, Sample, Solution, Status, StereoFrame
from leadline.sinks import Sink
from leadline.sources import Source, open_source
from leadline.sources.folder import FolderSource
from leadline.target import Sphere
from leadline.wire.solutions import read_solutions
from leadline.wire.spool import Spool

SCENARIO = """
name: tiny
path: {start_m: 1.1, end_m: 0.6, speed_m_s: 0.25, dwell_s: 0.0}
camera: {image_width_px: 480, rate_hz: 4.0}
laser: {dropouts: 0.0}
"""
FRAMES = 9


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """tiny.yaml, dive/ of `leadline sim`, boxes.json from its truth, and run/ of `leadline run`."""
    folder = tmp_path_factory.mktemp("cli")
    (folder / "tiny.yaml").write_text(SCENARIO)
    assert main(["sim", str(folder / "tiny.yaml"), "--out", str(folder / "dive"), "--seed", "3"]) == 0
    results = []
    for frame in json.loads((folder / "dive" / "truth.json").read_text())["frames"]:
        x0, y0, x1, y1 = frame["box_left_px"]
        box = {"image_id": frame["name"], "bbox": [x0, y0, x1 - x0, y1 - y0], "score": 0.9}
        results.append(box)
    (folder / "boxes.json").write_text(json.dumps(results))
    assert run(folder, "run", "--record") == 0
    return folder


def run(place: Path, out: str, *options: str, source: str = "dive") -> int:
    boxes = ["--boxes", str(place / "boxes.json"), "--target", "sphere:0.34"]
    return main(["run", str(place / source), "--out", str(place / out), *boxes, *options])


def summary(folder: Path) -> dict[str, object]:
    content: dict[str, object] = json.loads((folder / "summary.json").read_text())
    return content


def test_a_run_writes_what_the_contract_names(place: Path) -> None:
    names = {"solutions.csv", "config.yaml", "rig.yaml", "summary.json", "run.png", "dive.mcap"}
    assert {path.name for path in (place / "run").iterdir()} == names
    assert (place / "run" / "run.png").read_bytes().startswith(b"\x89PNG")
    content = summary(place / "run")
    assert content["frames"] == FRAMES
    assert content["notices"]["counts"].get("skipped", 0) == 0  # type: ignore[index]
    assert content["interrupted"] is False
    assert main(["config", "check", str(place / "run" / "config.yaml")]) == 0


def test_every_frame_has_a_row_with_its_own_stamp_and_the_truth_is_met(place: Path) -> None:
    source = FolderSource(place / "dive")
    solutions = read_solutions(place / "run" / "solutions.csv")
    frames = [sample.t_ns for sample in source if hasattr(sample, "left")]
    assert set(frames) <= {solution.t_ns for solution in solutions}
    assert all(solution.status is Status.VALID for solution in solutions)
    overall = by_stage(compare(solutions, source.truth, Sphere(0.34)))[-1]
    assert overall.count == len(solutions)
    assert overall.mean_m < 0.015


def test_a_replay_gives_the_same_bytes(place: Path) -> None:
    assert run(place, "replay", source="run/dive.mcap") == 0
    assert (place / "replay" / "solutions.csv").read_bytes() == (place / "run" / "solutions.csv").read_bytes()


def test_the_papers_method_and_every_frame_alone(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(place, "as_paper", "--method", "paper") == 0
    out = capsys.readouterr().out
    assert out.index("against its own point") < out.index("against the nearest surface")
    assert summary(place / "as_paper")["method"] == "paper"
    assert summary(place / "as_paper")["solutions"] == FRAMES
    assert run(place, "alone", "--no-filter") == 0
    assert summary(place / "alone")["solutions"] == FRAMES


@pytest.mark.parametrize("image_id", ["zzz.jpg", 7])
def test_boxes_of_another_dive(
    place: Path, tmp_path: Path, image_id: str | int, capsys: pytest.CaptureFixture[str]
) -> None:
    """Known before the run where the names are; of a recording at its end."""
    strange = [{"image_id": image_id, "bbox": [1, 2, 3, 4], "score": 0.9}]
    (tmp_path / "strange.json").write_text(json.dumps(strange))
    with_them = ["--target", "sphere:0.34", "--boxes", str(tmp_path / "strange.json")]
    told = "no box belongs to any frame of this dive; image_id must be the left image's file name, such as left_05.jpg"
    assert main(["run", str(place / "dive"), "--out", str(tmp_path / "strange"), *with_them]) == 2
    assert capsys.readouterr().err == f"leadline: {tmp_path / 'strange.json'}: {told}\n"
    assert not (tmp_path / "strange").exists()
    assert main(["run", str(place / "run" / "dive.mcap"), "--out", str(tmp_path / "strange"), *with_them]) == 0
    assert told in " ".join(capsys.readouterr().out.split())
    assert summary(tmp_path / "strange")["boxes"] == {"images": 1, "found": 0}


def test_an_empty_file_of_boxes_is_told(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (place / "no_boxes.json").write_text("[]")
    with_them = ["--target", "sphere:0.34", "--boxes", str(place / "no_boxes.json")]
    assert main(["run", str(place / "dive"), "--out", str(place / "unseen"), *with_them]) == 0
    assert "the file of boxes is empty: nothing was looked for" in capsys.readouterr().out
    assert summary(place / "run")["boxes"] == {"images": FRAMES, "found": FRAMES}


def test_the_end_of_a_run_says_what_a_pixel_costs(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(place, "again") == 0
    captured = capsys.readouterr()
    assert "one pixel of disparity is" in captured.out
    assert str(place / "again" / "run.png") in captured.out
    assert captured.err == ""  # no progress bar where stderr is not a terminal
    cost = summary(place / "again")["pixel_cost"]
    focal, baseline = 1.335 * 1401.8 / 4, 0.063  # the paper's rig at a quarter of its size
    expected = cost["range_m"] ** 2 / (focal * baseline)  # type: ignore[index]
    assert cost["m_per_px"] == pytest.approx(expected, rel=0.1)  # type: ignore[index]


def test_an_earlier_run_is_replaced_and_its_recording_kept(place: Path) -> None:
    shutil.copytree(place / "run", place / "twice")
    (place / "twice" / "mine.txt").write_text("kept")
    assert run(place, "twice", "--method", "paper") == 0
    assert summary(place / "twice")["method"] == "paper"
    assert (place / "twice" / "mine.txt").exists()
    assert (place / "twice" / "dive.mcap").exists()


def test_an_earlier_recording_is_never_written_over(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(place / "run", place / "again_recorded")
    earlier = (place / "run" / "dive.mcap").read_bytes()
    for _ in range(2):
        assert run(place, "again_recorded", "--record") == 0
    kept = [place / "again_recorded" / name for name in ("dive.mcap", "dive_2.mcap", "dive_3.mcap")]
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if "earlier" in line] == [
        f"the earlier recording {kept[0]} is now {path}" for path in kept[1:]
    ]
    assert kept[1].read_bytes() == earlier
    assert str(kept[0]) in lines
    assert all(len(list(open_source(path))) == len(list(open_source(kept[1]))) for path in kept)
    with pytest.raises(InputError, match=r"there are 3 recordings in it; name one of them: .*dive\.mcap"):
        open_source(place / "again_recorded")


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize(("camera", "told"), [("none.avi", "cannot be opened"), ("small.avi", "the image is 320x180")])
def test_a_source_that_does_not_begin_costs_nothing_of_the_earlier_run(
    place: Path, camera: str, told: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(place)
    film = cv2.VideoWriter("small.avi", cv2.VideoWriter.fourcc(*"MJPG"), 10, (640, 180))
    for _ in range(5):
        film.write(np.zeros((180, 640, 3), np.uint8))
    film.release()
    before = files(place / "run")
    arguments = ["--out", "run", "--rig", "run/rig.yaml", "--boxes", "boxes.json", "--record"]
    assert main(["run", f"uvc:{camera}", *arguments]) == 2
    captured = capsys.readouterr()
    assert told in captured.err
    assert captured.err.count("\n") == 1
    assert files(place / "run") == before


@pytest.mark.parametrize(("frame_at", "opened", "held"), [(2, True, 3), (90, True, 6), (90, False, 62)])
def test_readings_wait_for_a_frame_but_not_for_ever(place: Path, frame_at: int, opened: bool, held: int) -> None:
    """Four a second. What waited is given all the same, and in its order."""
    dive = FolderSource(place / "dive")
    frame = next(sample for sample in dive if isinstance(sample, StereoFrame))
    samples: list[Sample] = [LaserRange(i * NS_PER_S // 4, 1.0) for i in range(100)]
    samples[frame_at] = replace(frame, t_ns=samples[frame_at].t_ns)
    given: list[Sample] = []

    class Device(Source):
        @property
        def opened(self) -> bool:
            return opened

        def read(self) -> Iterator[Sample]:
            for sample in samples:
                given.append(sample)
                yield sample

    assert dive.rig is not None
    rest = begun(Device("device"), dive.rig)
    assert len(given) == held
    assert [sample.t_ns for sample in rest] == [sample.t_ns for sample in samples]


def test_ctrl_c_keeps_what_is_written(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    everything = FolderSource.read

    def cut(self: FolderSource) -> Iterator[Sample]:
        frames = 0
        for sample in everything(self):
            yield sample
            frames += hasattr(sample, "left")
            if frames == 3:
                raise KeyboardInterrupt

    monkeypatch.setattr(FolderSource, "read", cut)
    assert run(place, "cut", "--method", "paper") == 0
    assert summary(place / "cut")["interrupted"] is True
    assert len(read_solutions(place / "cut" / "solutions.csv")) == 3
    assert (place / "cut" / "run.png").exists()


def live_run(place: Path, out: str, outputs: tuple[Sink, ...] = ()) -> loop.Report:
    job = build.build_job(f"live:{place / 'dive'}", boxes=place / "boxes.json", target="sphere:0.34")
    return loop.run(replace(job, outputs=outputs), place / out, record=True)


def test_a_live_run_on_a_full_disk_says_at_its_end_what_was_recorded(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write = Spool._write

    def full(self: Spool, block: bytes) -> None:
        if self.path.suffix == ".mcap" and self.written[0] > 600_000:
            raise OSError(errno.ENOSPC, "No space left on device")
        write(self, block)

    monkeypatch.setattr(Spool, "_write", full)
    arguments = ["--boxes", str(place / "boxes.json"), "--record"]
    assert main(["run", f"live:{place / 'dive'}", "--out", str(place / "full"), *arguments]) == 0
    (line,) = capsys.readouterr().err.splitlines()
    found = re.fullmatch(
        r"leadline: dive\.mcap stopped (.*) s into the dive: No space left on device; it holds what came before", line
    )
    assert found is not None, line
    held = list(open_source(place / "full" / "dive.mcap"))
    assert 0 < len(held) < FRAMES
    stopped_s = float(found[1]) + (held[0].arrival_ns or held[0].t_ns) / NS_PER_S
    assert (held[-1].arrival_ns or held[-1].t_ns) / NS_PER_S < stopped_s + 0.1
    assert "off" in str(summary(place / "full")["health"])


class Stuck:
    """An output whose receiver has gone to sleep."""

    name = "MAVLink"

    def __init__(self) -> None:
        self.woken = threading.Event()

    def sample(self, sample: Sample) -> None:
        self.woken.wait(60)

    def detections(self, frame: StereoFrame, detections: Sequence[Detection]) -> None: ...
    def solution(self, solution: Solution) -> None: ...
    def close(self) -> None: ...


@pytest.mark.parametrize("interrupted", [False, True])
def test_an_output_that_is_stuck_holds_up_no_summary(
    place: Path, interrupted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C while it closes, or the time that it is given."""
    close, sink = Worker.close, Stuck()

    def cut(self: Worker, timeout_s: float) -> bool:
        if self._thread.name == "Stuck" and interrupted:
            threading.Timer(0.3, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
        return close(self, timeout_s)

    monkeypatch.setattr(Worker, "close", cut)
    monkeypatch.setattr("leadline.pipeline.watch.CLOSE_S", 30.0 if interrupted else 3.0)
    out = f"stuck_{interrupted}"
    report = live_run(place, out, (sink,))
    sink.woken.set()
    assert report.summary["unfinished"] == ["MAVLink was stuck: what it was given from 0.0 s into the dive on is lost"]
    assert summary(place / out)["interrupted"] is interrupted
    assert len(read_solutions(place / out / "solutions.csv")) >= FRAMES - report.summary["live"]["dropped"]
    assert len(list(open_source(place / out / "dive.mcap"))) >= FRAMES - report.summary["live"]["dropped"]


def test_a_bug_is_not_hidden_and_what_was_written_stays(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    take, steps = loop.Track.take, []

    def fail(self: loop.Track, sample: Sample) -> None:
        steps.append(sample)
        if len(steps) > 6:
            raise RuntimeError("a bug")
        take(self, sample)

    monkeypatch.setattr(loop.Track, "take", fail)
    with pytest.raises(RuntimeError, match="a bug"):
        run(place, "bug", "--method", "paper")
    assert len(read_solutions(place / "bug" / "solutions.csv")) >= 3


def test_the_demo_ends_with_both_methods_side_by_side(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(build, "_finder", lambda *_: Boxes(place / "boxes.json"))
    source = f"sim:{place / 'tiny.yaml'}"
    monkeypatch.setattr("leadline.pipeline.demo.demo_job", lambda seed, real_time: demo_job(source=source, seed=3))
    assert main(["demo", "--out", str(place / "demo")]) == 0
    out = capsys.readouterr().out
    assert "ours beside the paper's method" in out
    for name in ("solutions.csv", "solutions_paper.csv", "run.png", "summary.json"):
        assert (place / "demo" / name).is_file()
        assert str(place / "demo" / name) in out
    ours, paper = (compare_demo(place, name) for name in ("solutions.csv", "solutions_paper.csv"))
    assert ours < paper


def compare_demo(place: Path, name: str) -> float:
    truth = FolderSource(place / "dive").truth  # the same scenario and seed
    return by_stage(compare(read_solutions(place / "demo" / name), truth, Sphere(0.34)), own_point=True)[-1].mean_m


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["run"], "Missing argument"),
        (["run", "nowhere", "--out", "x"], "nowhere: no such file or folder"),
        (["run", "dive", "--out", "x", "--target", "cube"], "--target: 'cube' is not a target"),
        (["run", "dive", "--out", "x", "--target", "sphere:big"], "'big' is not a diameter"),
        (["run", "dive", "--out", "x", "--rig", "none.yaml"], "none.yaml"),
        (["run", "dive", "--out", "x", "--rig", "rendered"], "images are 480x270, the rig's left camera is 1920x1080"),
        (["run", "dive", "--out", "x", "--method", "best"], "best"),
        (["run", "dive", "--out", "x", "--bogus"], "--bogus"),
        (["run", "dive", "--out", "x", "--boxes", "none.json"], "none.json"),
        (["run", "dive", "--out", "x", "--boxes", "boxes.json", "--model", "m.onnx"], "one of them"),
        (["run", "dive", "--out", "x", "--boxes", "boxes.json", "--config", "bad.yaml"], "bad.yaml: paper.block"),
        (["run", "dive", "--out", "x", "--boxes", "boxes.json", "--water-state", "salt=3"], "'salt=3'"),
        (["run", "dive", "--out", "dive", "--boxes", "boxes.json"], "where the source is"),
        (["run", "run/dive.mcap", "--out", "run", "--boxes", "boxes.json"], "where the source is"),
        (["run", "dive", "--out", "boxes.json", "--boxes", "boxes.json"], "this is a file"),
        (["run", "sim:nothing", "--out", "x"], "no such scenario"),
        (["sim", "nothing", "--out", "x"], "no such scenario"),
        (["sim", "tiny.yaml", "--out", "dive"], "something already"),
        (["detect", "nowhere", "--out", "x", "--model", "m.onnx"], "m.onnx"),
        (["config", "check", "bad.yaml"], "bad.yaml: paper.block"),
        (["config", "check", "twice.yaml"], "twice.yaml: score: is there twice, again in line 3; leave one of the two"),
        (["sim", "twice.yaml", "--out", "x"], "twice.yaml: score: is there twice"),
        (["plan", "twice.yaml"], "twice.yaml: score: is there twice"),
        (["nonsense"], "nonsense"),
        (["demo", "--seed", "-1"], "--seed"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(
    place: Path,
    arguments: list[str],
    told: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(place)
    (place / "bad.yaml").write_text("paper: {block: 3}\n")
    (place / "twice.yaml").write_text("detector:\n  score: 0.5\n  score: 0.1\n")
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("leadline: ")
    assert captured.err.count("\n") == 1
    assert told in captured.err
    assert not (place / "x").exists()


WITHIN_A_FILE = "boxes.json/x"


@pytest.mark.parametrize(
    "arguments",
    [
        ["sim", "tiny.yaml", "--out", WITHIN_A_FILE],
        ["detect", "dive", "--out", WITHIN_A_FILE],
        ["detect", "dive", "--out", "boxes.json"],
        ["dataset", "dive", "--out", WITHIN_A_FILE],
        ["recover", "run/dive.mcap", "--out", f"{WITHIN_A_FILE}/whole.mcap"],
        ["recover", "run/dive.mcap", "--out", f"boxes.json{'x' * 238}.mcap"],
        ["run", "dive", "--out", WITHIN_A_FILE, "--boxes", "boxes.json"],
        ["board", "--out", f"{WITHIN_A_FILE}/board.pdf"],
        ["capture", "dive", "--target", "--out", WITHIN_A_FILE],
        ["evaluate", "run", "run", "--truth", "dive/truth.csv", "--out", WITHIN_A_FILE],
        ["calibrate", "convert", "rendered", "--format", "ros", "--out", WITHIN_A_FILE],
        ["calibrate", "convert", "rendered", "--out", f"{WITHIN_A_FILE}/rig.yaml"],
        ["calibrate", "range", "--dive", "dive", "--rig", "rendered", "--out", f"{WITHIN_A_FILE}/rig.yaml"],
        ["calibrate", "laser", "--dive", "dive", "--rig", "rendered", "--out", f"{WITHIN_A_FILE}/rig.yaml"],
        ["calibrate", "cameras", "--air", "dive", "--board", "8x6", "--square", "0.03", "--out", WITHIN_A_FILE],
    ],
    ids=" ".join,
)
def test_a_place_that_cannot_be_made_is_one_line_and_status_2(
    place: Path, arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(place)
    boxes = (place / "boxes.json").read_bytes()
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert "boxes.json" in captured.err
    assert "cannot be written" in captured.err
    assert (place / "boxes.json").read_bytes() == boxes


def test_a_folder_without_permission_is_told_before_the_work(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("leadline.files.os.access", lambda path, mode: mode != os.W_OK)  # to root all is permitted
    assert run(place, "locked") == 2
    assert "locked: cannot be written (Permission denied); give a folder that can be" in capsys.readouterr().err


def test_files_come_into_new_folders_too(place: Path) -> None:
    new = place / "new"
    assert main(["board", "--out", str(new / "paper" / "board.pdf")]) == 0
    assert main(["recover", str(place / "run" / "dive.mcap"), "--out", str(new / "whole" / "dive.mcap")]) == 0
    assert main(["calibrate", "convert", "rendered", "--out", str(new / "rig" / "rig.yaml")]) == 0
    assert {path.name for path in new.rglob("*.*")} == {"board.pdf", "dive.mcap", "rig.yaml"}


def test_a_folder_that_is_no_run_is_left_alone(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (place / "other").mkdir()
    (place / "other" / "thesis.tex").write_text("years of work")
    assert run(place, "other") == 2
    assert "not a run" in capsys.readouterr().err
    assert [path.name for path in (place / "other").iterdir()] == ["thesis.tex"]


def test_config_dump_is_a_good_config(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "dump"]) == 0
    text = capsys.readouterr().out
    (tmp_path / "config.yaml").write_text(text)
    assert main(["config", "check", str(tmp_path / "config.yaml")]) == 0
    assert "block_px" in text


def test_version_help_and_no_arguments(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"leadline {leadline.__version__}\n"
    assert main(["run", "--help"]) == 0
    assert "--no-filter" in capsys.readouterr().out
    assert main([]) == 2
    assert "Commands" in capsys.readouterr().err


def test_importing_the_package_is_light_and_its_names_are_there() -> None:
    heavy = "import sys, leadline; print([m for m in ('cv2', 'scipy', 'onnxruntime', 'pydantic') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", heavy], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "[]"
    for name in leadline.__all__:
        assert getattr(leadline, name) is not None
    assert set(leadline.__all__) <= set(dir(leadline))
    with pytest.raises(AttributeError, match="nothing_like_it"):
        _ = leadline.nothing_like_it


def test_python_m_leadline_and_its_exit_status() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "leadline", "run", "nowhere", "--out", "x"], check=False, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert done.stderr.startswith("leadline: nowhere")
