"""ROS 2 with the real rclpy: two processes over DDS, each of them killed and started again.

Needs a Python that has rclpy: $LEADLINE_ROS_PYTHON, else `.venv-ros/bin/python` (`make ros`), else these are skipped.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import sysconfig
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from leadline.pipeline.build import build_job
from leadline.simulation.dive import SimulatedDive
from leadline.simulation.scenario import Scenario
from leadline.sources import open_source
from leadline.wire.dive_writer import write_dive
from leadline.wire.ros2_definitions import DETECTIONS, LEFT_IMAGE, TARGET

REPOSITORY = Path(__file__).parents[1]
DRIVER = Path(__file__).with_name("ros2_driver.py")
TARGET_SPEC = "sphere:0.34"
PATIENCE_S = 400.0  # of a test on a busy machine
DOMAINS = 100


def ros_python() -> str:
    """The Python with rclpy; skips where there is none."""
    said = os.environ.get("LEADLINE_ROS_PYTHON")
    own = REPOSITORY / ".venv-ros" / "bin" / "python"
    if said is None and not own.exists():
        pytest.skip("no Python with rclpy: set LEADLINE_ROS_PYTHON, or `make ros` (x86-64, Python 3.11)")
    return said or str(own)


def ros_environment() -> dict[str, str]:
    """leadline and what it needs come from here, rclpy from there; nobody outside this machine hears of it."""
    paths = [REPOSITORY / "src", REPOSITORY / "ros2", sysconfig.get_paths()["purelib"]]
    own = {
        "PYTHONPATH": os.pathsep.join(map(str, paths)),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_DOMAIN_ID": str(1 + os.getpid() % DOMAINS),
        "OMP_NUM_THREADS": "1",
    }
    return os.environ | own


@contextmanager
def process(*arguments: str, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    with log.open("wb") as stream:
        made = subprocess.Popen(
            [ros_python(), *arguments], env=ros_environment(), stdout=stream, stderr=subprocess.STDOUT
        )
    try:
        yield made
    finally:
        made.kill()
        made.wait()


def localizer(dive: Path, log: Path, **parameters: str) -> Any:
    said = {"rig": str(dive / "rig.yaml"), "target": TARGET_SPEC, "reliable": "true", **parameters}
    options = [word for name, value in said.items() for word in ("-p", f"{name}:={value}")]
    code = "import sys; from leadline_ros.nodes import localizer; sys.exit(localizer())"
    return process("-c", code, "--ros-args", *options, log=log)


def until(true: Callable[[], bool], *logs: Path) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not true():
        if time.monotonic() > end_s:
            pytest.fail("\n".join(f"{log.name}:\n{log.read_text()}" for log in logs))
        time.sleep(0.05)


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three seconds of an approach at 320x180, the readings in tenths of a millimetre as a device gives them."""
    scenario = Scenario.load("demo")
    path = scenario.path.model_copy(update={"start_m": 1.4, "end_m": 0.5, "speed_m_s": 0.3, "dwell_s": 0.0})
    camera = scenario.camera.model_copy(update={"rate_hz": 6.0, "image_width_px": 320})
    simulated = SimulatedDive(scenario.model_copy(update={"path": path, "camera": camera}), seed=3)
    out = tmp_path_factory.mktemp("ros2") / "dive"
    write_dive(out, simulated.samples(), rig=simulated.rig, truth=simulated.truth)
    head, *rows = (out / "laser.csv").read_text().splitlines()
    column = head.split(",").index("range_m")
    kept = [row.split(",") for row in rows]
    for row in kept:
        row[column] = f"{float(row[column]):.4f}"
    (out / "laser.csv").write_text("\n".join([head, *(",".join(row) for row in kept)]) + "\n")
    return out


def direct(source: Path) -> dict[int, Any]:
    job = build_job(str(source), target=TARGET_SPEC)
    found = (job.methods["fused"].step(sample) for sample in job.source)
    return {one.t_ns: one.position_m for one in found if one is not None and one.position_m is not None}


def test_two_processes_give_the_poses_of_the_direct_run(dive: Path, tmp_path: Path) -> None:
    """Bit for bit; and the node's recording is read by rosbags, by rclpy, and by our own replay."""
    out, log, driver_log = tmp_path / "driver.json", tmp_path / "localizer.log", tmp_path / "driver.log"
    record = tmp_path / "record"
    with (
        localizer(dive, log, record=str(record)) as node,
        process(str(DRIVER), "gate", str(dive), str(out), log=driver_log) as driver,
    ):
        until(lambda: driver.poll() is not None or node.poll() is not None, log, driver_log)
        assert driver.poll() == 0, driver_log.read_text() + log.read_text()
        node.terminate()
        assert node.wait(PATIENCE_S) == 0, log.read_text()
    said = json.loads(out.read_text())
    assert said["changes"] == [True, True, True]
    wanted = direct(dive)
    got = {int(t_ns): pose for t_ns, pose in said["poses"].items()}
    assert len(wanted) >= 20
    assert got.keys() == wanted.keys()
    worst_m = max(float(np.abs(np.array(got[t_ns]) - wanted[t_ns]).max()) for t_ns in wanted)
    assert worst_m == 0.0
    assert said["pictures"] > 0
    assert {"leadline: left", "leadline: right", "leadline: laser"} <= said["statuses"].keys()
    _check_recording(next(record.glob("*.mcap")), wanted)


def _check_recording(path: Path, wanted: dict[int, Any]) -> None:
    with AnyReader([path]) as reader:
        counts = {one.topic: one.msgcount for one in reader.connections}
        poses = [reader.deserialize(raw, one.msgtype) for one, _, raw in reader.messages() if one.topic == TARGET]
    assert counts[TARGET] >= len(wanted)
    first = next(iter(wanted.values()))
    assert (poses[0].pose.pose.position.x, poses[0].pose.pose.position.z) == (first[0], first[2])
    code = """
import sys
from collections import Counter
from pathlib import Path
from rclpy.serialization import deserialize_message
from leadline.wire.recording import RecordingReader
from leadline.wire.ros2_node import message_class
done = Counter()
for schema, channel, record in RecordingReader(Path(sys.argv[1]), print).raw_messages():
    kind = message_class(schema.name)
    if kind is not None:
        message = deserialize_message(record.data, kind)
        done[channel.topic] += 1
print(*sorted(f"{topic}={count}" for topic, count in done.items()))
"""
    run = subprocess.run(
        [ros_python(), "-c", code, str(path)], env=ros_environment(), capture_output=True, text=True, check=True
    )
    read = {topic: int(count) for topic, count in (pair.split("=") for pair in run.stdout.split())}
    said = {topic: count for topic, count in counts.items() if count}
    assert {**read, DETECTIONS: said[DETECTIONS]} == said  # vision_msgs need not be there
    frames = [sample for sample in open_source(path) if hasattr(sample, "left")]
    assert len(frames) == counts[LEFT_IMAGE]


def player(dive: Path, out: Path) -> Any:
    return process(str(DRIVER), "play", str(dive), str(out), log=out.with_suffix(".log"))


def lines(out: Path) -> int:
    return len(out.read_text().splitlines()) if out.exists() else 0


def test_either_side_may_be_killed_and_comes_back(dive: Path, tmp_path: Path) -> None:
    logs = tmp_path / "one.log", tmp_path / "two.log"
    told, told_again = tmp_path / "first", tmp_path / "second"
    with player(dive, told) as first:
        with localizer(dive, logs[0], autostart="true") as node:
            until(lambda: lines(told) > 5, logs[0])
            node.kill()
            node.wait()
        before = lines(told)
        with localizer(dive, logs[1], autostart="true") as node:
            until(lambda: lines(told) > before + 20, *logs)  # a pass may have been under way
            first.kill()
            first.wait()
            with player(dive, told_again):
                until(lambda: lines(told_again) > 5, *logs)
            assert node.poll() is None


def test_a_run_takes_topics_and_gives_topics(dive: Path, tmp_path: Path) -> None:
    log, told, out = tmp_path / "run.log", tmp_path / "told", tmp_path / "out"
    options = ["--rig", str(dive / "rig.yaml"), "--target", TARGET_SPEC, "--out", str(out), "--ros2", "--headless"]
    with player(dive, told), process("-m", "leadline", "run", "ros2:", *options, log=log) as run:
        until(lambda: lines(told) > 5 or run.poll() is not None, log)
        run.send_signal(signal.SIGINT)
        assert run.wait(PATIENCE_S) == 0, log.read_text()
    assert len((out / "solutions.csv").read_text().splitlines()) > 6


def test_without_a_rig_the_camera_infos_are_taken(dive: Path, tmp_path: Path) -> None:
    log, told = tmp_path / "localizer.log", tmp_path / "told"
    with player(dive, told), localizer(dive, log, rig="''", autostart="true"):
        until(lambda: lines(told) > 5, log)
    assert "waiting for" in log.read_text()


def test_a_rig_that_is_not_there_is_one_line_and_the_node_stays(dive: Path, tmp_path: Path) -> None:
    log = tmp_path / "localizer.log"
    with localizer(dive, log, rig="/nowhere.yaml", autostart="true") as node:
        until(lambda: "nowhere.yaml" in log.read_text(), log)
        assert node.poll() is None
        assert "Traceback" not in log.read_text()


def test_without_rclpy_the_source_says_what_to_do(tmp_path: Path) -> None:
    run = subprocess.run(
        [sys.executable, "-m", "leadline", "run", "ros2:", "--rig", "paper", "--out", str(tmp_path / "out")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 2, run.stderr
    assert "ROS 2 is not here" in run.stderr
    assert len(run.stderr.strip().splitlines()) == 1
