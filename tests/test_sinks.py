"""What a run writes: the solutions table and the recording."""

from __future__ import annotations

import dataclasses
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader

from leadline.errors import InputError
from leadline.rig import Rig
from leadline.samples import Detection, Kind, LaserRange, Rejected, Sample, Solution, Stage, Status, StereoFrame, Truth
from leadline.sinks import McapSink, SolutionsCsv
from leadline.sources import open_source
from leadline.wire.dive_writer import write_dive
from leadline.wire.recording import RecordingReader
from leadline.wire.ros2_definitions import TOPIC_TYPES
from leadline.wire.solutions import HEADER, read_solutions
from wire_helpers import memory_dive, picture, same

SOLUTION = Solution(
    t_ns=1_700_000_000_123_456_789,
    stage=Stage.BOTH,
    status=Status.VALID,
    position_m=np.array([-0.05, 0.03, 2.37]),
    cov_m2=np.array([[1e-6, 2e-7, 3e-7], [2e-7, 4e-6, 5e-7], [3e-7, 5e-7, 6e-6]]),
    range_m=2.2007172,
    range_sigma_m=0.0024,
    velocity_m_s=np.array([0.0, 0.01, -0.25]),
    used=(Kind.STEREO, Kind.LASER),
    rejected=(Rejected(Kind.SPOT, 0, "gate, 3 sigma + more", 12.0), Rejected(Kind.SIZE, 0, "cut off")),
)
LOST = Solution(400_000_000, Stage.SEARCHING, Status.LOST)


def test_solutions_table_as_promised(tmp_path: Path) -> None:
    sink = SolutionsCsv(tmp_path / "run" / "solutions.csv")
    sink.solution(LOST)
    sink.solution(SOLUTION)
    written = (tmp_path / "run" / "solutions.csv").read_text()  # before close: a killed run keeps its rows
    sink.close()
    assert written.splitlines() == [
        "t_s,stage,status,x_m,y_m,z_m,range_m,range_sigma_m,cov_xx,cov_xy,cov_xz,cov_yy,cov_yz,cov_zz,"
        "vx_m_s,vy_m_s,vz_m_s,used,rejected",
        "0.4,0,lost,,,,,,,,,,,,,,,,",
        "1700000000.123456789,2,valid,-0.05,0.03,2.37,2.2007172,0.0024,1e-06,2e-07,3e-07,4e-06,5e-07,6e-06,"
        "0,0.01,-0.25,stereo+laser,spot:gate; 3 sigma & more+size:cut off",
    ]


def test_a_velocity_that_nobody_knows_is_neither_empty_nor_nought(tmp_path: Path) -> None:
    still = dataclasses.replace(SOLUTION, velocity_m_s=None)
    path = tmp_path / "solutions.csv"
    sink = SolutionsCsv(path)
    sink.solution(still)
    sink.close()
    assert ",6e-06,nan,nan,nan,stereo+laser," in path.read_text()
    (read,) = read_solutions(path)
    assert read.velocity_m_s is None
    assert read.position_m == pytest.approx(still.position_m)


def test_solutions_are_read_back(tmp_path: Path) -> None:
    path = tmp_path / "solutions.csv"
    sink = SolutionsCsv(path)
    sink.solution(SOLUTION)
    sink.solution(LOST)
    sink.close()
    one, lost = read_solutions(path)
    assert (one.t_ns, one.stage, one.status, one.used) == (SOLUTION.t_ns, Stage.BOTH, Status.VALID, SOLUTION.used)
    assert one.position_m is not None
    assert one.cov_m2 is not None
    np.testing.assert_allclose(one.position_m, SOLUTION.position_m, rtol=1e-9)
    np.testing.assert_array_equal(one.cov_m2, SOLUTION.cov_m2)
    assert [(each.kind, each.reason) for each in one.rejected] == [
        (Kind.SPOT, "gate; 3 sigma & more"),
        (Kind.SIZE, "cut off"),
    ]
    assert (lost.status, lost.position_m, lost.cov_m2, lost.range_m) == (Status.LOST, None, None, None)


@pytest.mark.parametrize(
    ("cell", "bad"), [("stage", "7"), ("status", "fine"), ("status", '"fi\nne"'), ("t_s", "x"), ("x_m", "nan")]
)
def test_a_foreign_table_is_refused_with_its_row(tmp_path: Path, cell: str, bad: str) -> None:
    path = tmp_path / "solutions.csv"
    row = dict.fromkeys(HEADER, "") | {"t_s": "1", "stage": "1", "status": "valid"} | {cell: bad}
    path.write_text(",".join(HEADER) + "\n" + ",".join(row.values()) + "\n")
    with pytest.raises(InputError, match=r"^[^\n]*row [23][^\n]*solutions\.csv[^\n]*$"):
        read_solutions(path)


def test_a_header_with_a_column_twice_and_rows_of_once_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "solutions.csv"
    path.write_text(",".join(["t_s", *HEADER]) + "\n" + ",".join(["1"] * len(HEADER)) + "\n")
    with pytest.raises(InputError, match="the first rejected"):
        read_solutions(path)


def record(path: Path, samples: list[Sample], rig: Rig | None = None, truth: tuple[Truth, ...] = ()) -> Path:
    sink = McapSink(path, rig, truth)
    for sample in samples:
        sink.sample(sample)
        if isinstance(sample, StereoFrame):
            sink.detections(sample, [Detection((1.5, 2.0, 10.0, 20.0), 0.75, "ball")])
        sink.solution(SOLUTION if isinstance(sample, StereoFrame) else LOST)
    sink.close()
    sink.close()
    return path


def test_recording_gives_the_same_samples(tmp_path: Path) -> None:
    samples = memory_dive()
    source = open_source(record(tmp_path / "dive.mcap", samples))
    assert all(same(before, after) for before, after in zip(samples, source, strict=True))
    assert source.notices == []
    assert (source.frame_count, source.image_size, source.rig) == (2, (64, 48), None)


def test_a_bag_is_a_folder_with_a_recording(tmp_path: Path) -> None:
    record(tmp_path / "bag" / "bag_0.mcap", memory_dive())
    assert len(list(open_source(tmp_path / "bag"))) == 6


def test_a_senseless_recorded_range_is_skipped(tmp_path: Path) -> None:
    samples = memory_dive()
    samples[0] = LaserRange(0, float("nan"))
    source = open_source(record(tmp_path / "dive.mcap", samples))
    assert len(list(source)) == 5
    assert [str(notice.kind) for notice in source.notices] == ["skipped"]


FINITE = st.floats(1e-3, 1e6, allow_nan=False)
STAMPS = st.integers(-(10**9), 2**31 * 10**9 - 1)


@settings(deadline=None, max_examples=50)  # each closes a file, and that waits for the disk
@given(range_m=FINITE, quality=st.none() | FINITE, t_ns=STAMPS, arrival_ns=st.none() | STAMPS)
def test_every_reading_comes_back_exactly(
    tmp_path_factory: pytest.TempPathFactory, range_m: float, quality: float | None, t_ns: int, arrival_ns: int | None
) -> None:
    """float64 through a float32 message; stamps before zero too (a clock offset at the start of a dive)."""
    reading = LaserRange(t_ns, range_m, quality, arrival_ns)
    frame = StereoFrame(t_ns, FLAT, FLAT, arrival_ns)
    source = open_source(record(tmp_path_factory.mktemp("m") / "dive.mcap", [reading, frame]))
    back = list(source)
    assert back[0] == reading
    assert same(back[1], frame)


FLAT = np.zeros((2, 2), np.uint8)


def test_rig_and_truth_travel_along(tmp_path: Path) -> None:
    rig = Rig.load("rendered")
    truth = (Truth(400_000_000, (-0.05, 0.03, 2.37), 2.2007172), Truth(800_000_000, (0.1, 0.2, 0.3), 0.1))
    source = open_source(record(tmp_path / "dive.mcap", memory_dive(), rig, truth))
    assert source.truth == list(truth)
    assert source.rig is not None
    rig.save(tmp_path / "one.yaml")
    source.rig.save(tmp_path / "two.yaml")
    assert (tmp_path / "one.yaml").read_bytes() == (tmp_path / "two.yaml").read_bytes()


def test_rosbags_reads_every_topic(tmp_path: Path) -> None:
    rig = Rig.load("rendered")
    samples = memory_dive()
    path = record(tmp_path / "dive.mcap", samples, rig)
    messages: dict[str, list[tuple[int, object]]] = {}
    with AnyReader([path]) as reader:
        for connection, log_ns, data in reader.messages():
            assert connection.msgtype == TOPIC_TYPES[connection.topic]
            messages.setdefault(connection.topic, []).append((log_ns, reader.deserialize(data, connection.msgtype)))
    assert set(messages) == set(TOPIC_TYPES)

    log_ns, image = messages["/leadline/left/image/compressed"][0]
    assert (log_ns, image.header.stamp.sec, image.header.stamp.nanosec) == (180_000_000, 0, 99_000_000)
    assert (image.header.frame_id, image.format, bytes(image.data[:4])) == ("left_camera_optical", "png", b"\x89PNG")
    left, right = (messages[f"/leadline/{side}/camera_info"][0][1] for side in ("left", "right"))
    pinhole = rig.pinhole_water or (rig.left, rig.right)
    assert left.k[0] == pinhole[0].fx
    assert left.p[3] == 0
    assert right.p[3] == pytest.approx(-right.p[0] * rig.baseline_m, rel=1e-9)
    assert (left.width, left.height, left.distortion_model, len(left.d)) == (1920, 1080, "plumb_bob", 5)
    ranges = [message.range for _, message in messages["/leadline/laser/range"]]
    assert ranges == [np.float32(0.668), np.float32(3.0587654321)]
    box = messages["/leadline/detections"][0][1].detections[0]
    assert (box.bbox.center.position.x, box.bbox.center.position.y, box.bbox.size_x) == (6.5, 12.0, 10.0)
    assert (box.results[0].hypothesis.class_id, box.results[0].hypothesis.score) == ("ball", 0.75)
    target = messages["/leadline/target"][0][1]
    assert target.pose.pose.position.z == 2.37
    assert list(target.pose.covariance[6:9]) == list(SOLUTION.cov_m2[1])
    statuses = [message.status[0] for _, message in messages["/diagnostics"]]
    assert [(status.level, status.message) for status in statuses[:2]] == [(2, "lost, searching"), (0, "valid, both")]
    assert {pair.key: pair.value for pair in statuses[1].values}["range_m"] == "2.2007172"


def long_dive(count: int = 20) -> list[Sample]:
    samples: list[Sample] = []
    for i in range(count):
        samples += [LaserRange(i * 100_000_000, 2.0 + i), StereoFrame(i * 100_000_000, picture(i), picture(i + 50))]
    return samples


@pytest.mark.parametrize("kept", [0.3, 0.6, 0.95, 0.999])
def test_a_truncated_recording_gives_what_there_is(tmp_path: Path, kept: float) -> None:
    samples = long_dive()
    rig = Rig.load("rendered")
    data = record(tmp_path / "whole.mcap", samples, rig).read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(data[: int(len(data) * kept)])
    source = open_source(path)
    back = list(source)
    assert len(back) >= int(len(samples) * kept) - 3
    assert all(same(before, after) for before, after in zip(samples, back, strict=False))
    assert {str(notice.kind) for notice in source.notices} <= {"truncated", "skipped"}
    assert any(notice.kind == "truncated" for notice in source.notices)
    assert source.rig is not None


def test_a_damaged_chunk_costs_only_itself(tmp_path: Path) -> None:
    samples = long_dive()
    path = record(tmp_path / "dive.mcap", samples)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    source = open_source(path)
    assert len(list(source)) >= len(samples) - 3
    assert [str(notice.kind) for notice in source.notices][:1] == ["truncated"]


def test_a_killed_recorder_leaves_all_but_the_last_moment(tmp_path: Path) -> None:
    samples = long_dive()
    sink = McapSink(tmp_path / "dive.mcap")
    for sample in samples:
        sink.sample(sample)
    (tmp_path / "left.mcap").write_bytes((tmp_path / "dive.mcap").read_bytes())  # as the disk is at this moment
    sink.close()
    back = list(open_source(tmp_path / "left.mcap"))
    assert len(back) == len(samples)


def test_readings_alone_are_flushed_once_a_second(tmp_path: Path) -> None:
    sink = McapSink(tmp_path / "dive.mcap")
    for i in range(31):
        sink.sample(LaserRange(i * 100_000_000, 2.0))
    reader = RecordingReader(tmp_path / "dive.mcap", lambda _: None)
    count = len(list(reader.messages(["/leadline/laser/range"])))
    sink.close()
    assert count >= 21


@pytest.mark.parametrize("content", [b"", b"no mcap at all", b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + bytes(5000)])
def test_nothing_readable_is_one_clear_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "dive.mcap"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"dive\.mcap.*--record"):
        open_source(path)


def test_recording_of_unequal_images_is_refused(tmp_path: Path) -> None:
    frame = StereoFrame(0, picture(1), picture(2, (32, 24)))
    with pytest.raises(InputError, match="64x48 and 32x24"):
        open_source(record(tmp_path / "dive.mcap", [frame]))


def test_unreadable_image_in_a_recording_is_skipped(tmp_path: Path) -> None:
    samples = long_dive(3)
    samples[3] = StereoFrame(100_000_000, picture(1), picture(2), encoded=(b"no", b"image"))
    source = open_source(record(tmp_path / "dive.mcap", samples))
    assert len(list(source)) == 5
    assert [str(notice) for notice in source.notices] == [
        f"skipped: {tmp_path / 'dive.mcap'} frame at 0.1 s: not a readable image"
    ]


def test_a_simulated_dive_its_folder_and_its_recording_agree(tmp_path: Path) -> None:
    simulation = open_source("sim:stress", seed=1)
    samples = list(islice(simulation, 8))
    assert {type(sample) for sample in samples} == {StereoFrame, LaserRange}
    record(tmp_path / "dive.mcap", samples, simulation.rig, tuple(simulation.truth))
    write_dive(tmp_path / "dive", samples, rig=simulation.rig, truth=simulation.truth)
    for source in (open_source(tmp_path / "dive.mcap"), open_source(tmp_path / "dive")):
        assert all(same(before, after) for before, after in zip(samples, source, strict=True))
        assert source.truth == simulation.truth
        assert source.image_size == simulation.image_size
