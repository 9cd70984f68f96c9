"""Recordings against other libraries: schemas, files of other recorders, recovery, speed of the encoder."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from mcap_ros2.writer import Writer as OtherWriter
from rosbags.typesys import Stores, get_typestore

from leadline.errors import InputError
from leadline.samples import LaserRange, StereoFrame, VehicleMotion
from leadline.sinks import McapSink
from leadline.sources import open_source
from leadline.wire.images import encode_png
from leadline.wire.recording import RecordingWriter, recover
from leadline.wire.ros2_definitions import LASER, LEFT_IMAGE, MOTION, RIGHT_IMAGE, TOPIC_TYPES, definition
from leadline.wire.ros2_messages import compressed_image, motion_message, range_message
from wire_helpers import picture, same


@pytest.mark.parametrize("name", sorted(set(TOPIC_TYPES.values()) - {"vision_msgs/msg/Detection2DArray"}))
def test_definitions_are_those_of_ros2_jazzy(name: str) -> None:
    """Field by field; rosbags' type hash covers all types inside. It does not know vision_msgs."""
    store = get_typestore(Stores.ROS2_JAZZY)
    assert _parsed(definition(name)) == _parsed(store.generate_msgdef(name, ros_version=2)[0])


def _parsed(text: str) -> dict[str, list[str]]:
    blocks = [block.strip().splitlines() for block in text.split("=" * 80)]
    return {block[0] if i else "": block[1 if i else 0 :] for i, block in enumerate(blocks)}


def foreign(path: Path, skew_ns: int, ranged: str = "range") -> Path:
    """The topics as another tool records them: no attachment, no sample_info, right images before left ones.

    ``ranged``: what its description of a reading calls the range.
    """
    with path.open("wb") as stream, OtherWriter(stream) as writer:
        schemas = {
            name: writer.register_msgdef(name, definition(name).replace("float32 range\n", f"float32 {ranged}\n"))
            for name in TOPIC_TYPES.values()
        }
        for i in range(3):
            t_ns = i * 100_000_000
            left, right = (encode_png(picture(seed + i)) for seed in (0, 50))
            for topic, message in (
                (RIGHT_IMAGE, compressed_image(t_ns + skew_ns, "r", right)),
                (LASER, range_message(LaserRange(t_ns, 2.5 if i else float("nan")))),
                (LEFT_IMAGE, compressed_image(t_ns, "l", left)),
            ):
                writer.write_message(topic, schemas[TOPIC_TYPES[topic]], message, t_ns + 50_000_000, t_ns)
    return path


@pytest.mark.parametrize(("skew_ns", "pairs"), [(0, 3), (10_000_000, 3), (40_000_000, 0)])
def test_a_recording_by_another_tool(tmp_path: Path, skew_ns: int, pairs: int) -> None:
    path = foreign(tmp_path / "other.mcap", skew_ns)
    if not pairs:
        with pytest.raises(InputError, match="no stereo frame"):
            open_source(path)
        return
    source = open_source(path)
    samples = list(source)
    frames = [sample for sample in samples if isinstance(sample, StereoFrame)]
    assert [frame.t_ns for frame in frames] == [i * 100_000_000 + skew_ns // 2 for i in range(3)]
    assert frames[0].right_t_ns == (skew_ns or None)
    assert frames[2].arrival_ns == 250_000_000
    assert np.array_equal(frames[1].right, picture(51))
    readings = [sample for sample in samples if isinstance(sample, LaserRange)]
    assert readings == [LaserRange(i * 100_000_000, 2.5, None, i * 100_000_000 + 50_000_000) for i in (1, 2)]
    assert [str(notice.kind) for notice in source.notices if notice.kind != "late"] == ["skipped"]  # the NaN


def test_messages_that_their_schema_describes_otherwise_are_skipped(tmp_path: Path) -> None:
    source = open_source(foreign(tmp_path / "other.mcap", 0, ranged="reach"))
    assert [type(sample) for sample in source] == [StereoFrame] * 3
    skipped = [str(notice) for notice in source.notices if notice.kind == "skipped"]
    assert len(skipped) == 3
    assert all(LASER in one and "range" in one for one in skipped)


@pytest.mark.parametrize("variances", [(0.01, 4e-6), (0.0, -1.0), (-1.0, 4e-6), (-1.0, -1.0)])
def test_a_twist_by_another_tool(tmp_path: Path, variances: tuple[float, float]) -> None:
    """0: of unknown certainty, the usual one is taken; negative: not measured."""
    path = tmp_path / "other.mcap"
    foreign(path, 0)
    message = motion_message(VehicleMotion(50_000_000, (0.1, 0.2, 0.3), (0.01, 0.02, 0.03)))
    message["twist"]["covariance"] = np.diag(np.repeat(variances, 3)).ravel().tolist()
    with path.open("wb") as stream, OtherWriter(stream) as writer:
        for topic, one in (
            (MOTION, message),
            (LEFT_IMAGE, compressed_image(0, "l", encode_png(picture(0)))),
            (RIGHT_IMAGE, compressed_image(0, "r", encode_png(picture(1)))),
        ):
            schema = writer.register_msgdef(TOPIC_TYPES[topic], definition(TOPIC_TYPES[topic]))
            writer.write_message(topic, schema, one, 60_000_000, 50_000_000)
    source = open_source(path)
    motions = [sample for sample in source if isinstance(sample, VehicleMotion)]
    if max(variances) < 0:
        assert not motions
        assert "neither" in str(source.notices[0])
        return
    usual = VehicleMotion(0)
    (motion,) = motions
    assert (motion.velocity_m_s is None, motion.rotation_rad_s is None) == (variances[0] < 0, variances[1] < 0)
    assert motion.velocity_sigma_m_s == (0.1 if variances[0] > 0 else usual.velocity_sigma_m_s)
    assert motion.rotation_sigma_rad_s == (0.002 if variances[1] > 0 else usual.rotation_sigma_rad_s)
    assert motion.arrival_ns == 60_000_000


def test_recover_makes_a_whole_file(tmp_path: Path) -> None:
    sink = McapSink(tmp_path / "dive.mcap")
    samples = [StereoFrame(i * 100_000_000, picture(i), picture(i + 50)) for i in range(5)]
    for sample in samples:
        sink.sample(sample)
    sink.close()
    data = (tmp_path / "dive.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) * 7 // 10])
    lost = recover(tmp_path / "cut.mcap", tmp_path / "good.mcap")
    assert len(lost.lost) == 1
    source = open_source(tmp_path / "good.mcap")
    assert source.frame_count == 3  # from its index
    assert all(same(before, after) for before, after in zip(samples[:3], source, strict=True))
    assert source.notices == []
    assert recover(tmp_path / "good.mcap", tmp_path / "again.mcap").lost == []
    with pytest.raises(InputError, match="another name"):
        recover(tmp_path / "cut.mcap", tmp_path / "good.mcap")
    (tmp_path / "none.mcap").write_bytes(data[:100])
    with pytest.raises(InputError, match="nothing to recover"):
        recover(tmp_path / "none.mcap", tmp_path / "new.mcap")
    assert not list(tmp_path.glob("*.part"))


def test_images_are_written_fast_enough(tmp_path: Path) -> None:
    """Two 2 MB images at 20 Hz leave 50 ms a frame; a message encoded byte by byte would take over 100 ms."""
    data = bytes(2_000_000)
    with RecordingWriter(tmp_path / "fast.mcap") as writer:
        start = time.process_time()
        for i in range(10):
            writer.write(LEFT_IMAGE, compressed_image(i, "l", data), log_ns=i, publish_ns=i)
            writer.flush()
    assert (time.process_time() - start) / 10 < 0.05


@pytest.mark.data
def test_folder_and_recording_are_the_same_dive(data_dir: Path, tmp_path: Path) -> None:
    folder = open_source(data_dir / "rendered_dives" / "approach_ball_clear")
    sink = McapSink(tmp_path / "dive.mcap", folder.rig, folder.truth)
    for sample in folder:
        sink.sample(sample)
    sink.close()
    recording = open_source(tmp_path / "dive.mcap")
    pairs = list(zip(folder, recording, strict=True))
    assert len(pairs) == 42
    for one, other in pairs:
        assert same(one, other)
        if isinstance(one, StereoFrame) and isinstance(other, StereoFrame):
            assert one.encoded == other.encoded
    assert (recording.truth, recording.frame_count, recording.image_size) == (
        folder.truth,
        folder.frame_count,
        folder.image_size,
    )
    assert folder.notices == recording.notices == []
