"""Dive folders: what is read, what is skipped and told, what is refused."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest

from leadline.errors import InputError
from leadline.rig import Rig
from leadline.samples import LaserRange, StereoFrame, VehicleMotion
from leadline.sources import count_notices, open_source, require_size
from leadline.wire.dive_writer import write_dive
from leadline.wire.truth import read_truth
from wire_helpers import memory_dive, picture, same, write_folder


def frames_of(source: object) -> list[StereoFrame]:
    return [sample for sample in source if isinstance(sample, StereoFrame)]  # type: ignore[attr-defined]


def ranges_of(source: object) -> list[LaserRange]:
    return [sample for sample in source if isinstance(sample, LaserRange)]  # type: ignore[attr-defined]


def test_clean_dive_is_given_whole(tmp_path: Path) -> None:
    source = open_source(write_folder(tmp_path))
    samples = list(source)
    assert [sample.t_ns for sample in samples] == [t for i in range(4) for t in (i * 400_000_000,) * 2]
    assert [type(sample) for sample in samples] == [StereoFrame, LaserRange] * 4  # the frame first where they tie
    assert source.notices == []
    assert (source.frame_count, source.image_size, source.rig, source.truth) == (4, (64, 48), None, [])
    frame = frames_of(source)[1]
    assert frame.name == "left_1.jpg"
    assert frame.encoded == ((tmp_path / "left_1.jpg").read_bytes(), (tmp_path / "right_1.jpg").read_bytes())
    assert np.array_equal(frame.right, cv2.imread(str(tmp_path / "right_1.jpg")))


def test_second_iteration_is_a_replay(tmp_path: Path) -> None:
    write_folder(tmp_path)
    (tmp_path / "left_2.jpg").write_bytes(b"not a picture")
    source = open_source(tmp_path)
    first = list(source)
    assert all(same(a, b) for a, b in zip(first, source, strict=True))
    assert count_notices(source.notices) == {"skipped": 1}


def test_side_by_side_is_split(tmp_path: Path) -> None:
    both = picture(1, (128, 48))
    cv2.imwrite(str(tmp_path / "s.png"), both)
    (tmp_path / "frames.csv").write_text("t_s,stereo\n0.5,s.png\n")
    (frame,) = open_source(tmp_path)
    assert isinstance(frame, StereoFrame)
    assert np.array_equal(frame.left, both[:, :64])
    assert np.array_equal(frame.right, both[:, 64:])
    assert (frame.name, frame.encoded) == ("s.png", None)


def test_latency_orders_by_arrival_and_tells_late(tmp_path: Path) -> None:
    """Frames 80 ms late: the reading taken 40 ms after a frame is given before it."""
    write_folder(
        tmp_path,
        2,
        frames_csv="t_s,t_arrival_s,left,right\n0.0,0.08,left_0.jpg,right_0.jpg\n1.0,1.08,left_1.jpg,right_1.jpg\n",
        laser_csv="t_s,t_arrival_s,range_m\n0.04,0.05,2\n0.5,0.51,2\n",
    )
    source = open_source(tmp_path)
    assert [sample.t_s for sample in source] == [0.04, 0.0, 0.5, 1.0]
    assert [(str(notice.kind), notice.where) for notice in source.notices] == [("late", "frame at 0.0 s")]


def test_optional_columns_are_read(tmp_path: Path) -> None:
    write_folder(
        tmp_path,
        1,
        frames_csv="t_right_s,t_s,left,right,t_left_s,note\n0.102,0.1,left_0.jpg,right_0.jpg,0.098,x\n",
        laser_csv="t_s,range_m,quality\n0.2,2.5,0.75\n0.3,2.5,\n",
    )
    frame, *readings = open_source(tmp_path)
    assert isinstance(frame, StereoFrame)
    assert (frame.left_t_ns, frame.right_t_ns, frame.arrival_ns) == (98_000_000, 102_000_000, None)
    assert [reading.quality for reading in readings if isinstance(reading, LaserRange)] == [0.75, None]


@pytest.mark.parametrize("cell", ["nan", "inf", "-inf", "-1.5", "0", "abc", "", "1e999"])
def test_senseless_range_is_skipped_with_its_row(tmp_path: Path, cell: str) -> None:
    source = open_source(write_folder(tmp_path, 1, laser_csv=f"t_s,range_m\n0.0,2.5\n0.1,{cell}\n0.2,2.4\n"))
    assert [reading.range_m for reading in ranges_of(source)] == [2.5, 2.4]
    (notice,) = source.notices
    assert (str(notice.kind), notice.where) == ("skipped", f"{tmp_path / 'laser.csv'} row 3")
    assert "range_m" in notice.why


def test_missing_image_is_skipped_with_file_and_row(tmp_path: Path) -> None:
    write_folder(tmp_path)
    (tmp_path / "right_2.jpg").unlink()
    source = open_source(tmp_path)
    assert [frame.name for frame in frames_of(source)] == ["left_0.jpg", "left_1.jpg", "left_3.jpg"]
    (notice,) = source.notices
    assert notice.where.endswith("frames.csv row 4")
    assert "right_2.jpg" in notice.why


@pytest.mark.parametrize("damage", ["garbage", "empty", "cut"])
def test_unreadable_image_is_skipped(tmp_path: Path, damage: str) -> None:
    write_folder(tmp_path)
    path = tmp_path / "left_1.jpg"
    data = path.read_bytes()
    path.write_bytes({"garbage": b"\xff\xd8" + bytes(1000), "empty": b"", "cut": data[: len(data) * 2 // 3]}[damage])
    source = open_source(tmp_path)
    assert len(frames_of(source)) == 3
    (notice,) = source.notices
    assert notice.where.endswith("frames.csv row 3")
    assert "left_1.jpg" in notice.why


def test_row_out_of_order_is_taken_in_its_place_and_told(tmp_path: Path) -> None:
    source = open_source(write_folder(tmp_path, 1, laser_csv="t_s,range_m\n0.0,2\n0.3,2.3\n0.1,2.1\n0.4,2.4\n"))
    assert [reading.range_m for reading in ranges_of(source)] == [2, 2.1, 2.3, 2.4]
    assert [(str(notice.kind), notice.where[-5:]) for notice in source.notices] == [("reordered", "row 4")]


def test_repeated_row_is_given_once(tmp_path: Path) -> None:
    source = open_source(write_folder(tmp_path, 1, laser_csv="t_s,range_m\n0.1,2\n0.1,2\n0.2,2\n"))
    assert [reading.t_s for reading in ranges_of(source)] == [0.1, 0.2]
    assert count_notices(source.notices) == {"repeated": 1}


def test_bad_quality_does_not_cost_the_reading(tmp_path: Path) -> None:
    source = open_source(write_folder(tmp_path, 1, laser_csv="t_s,range_m,quality\n0.1,2,nan\n"))
    assert ranges_of(source) == [LaserRange(100_000_000, 2.0)]
    assert count_notices(source.notices) == {"ignored": 1}


@pytest.mark.parametrize("cell", ["", "x", "1700000000123"])
def test_bad_stamp_is_skipped(tmp_path: Path, cell: str) -> None:
    frames = f"t_s,left,right\n0,left_0.jpg,right_0.jpg\n{cell},left_1.jpg,right_1.jpg\n"
    source = open_source(write_folder(tmp_path, 2, frames_csv=frames))
    assert len(frames_of(source)) == 1
    assert count_notices(source.notices) == {"skipped": 1}


def test_later_frame_of_other_size_is_skipped(tmp_path: Path) -> None:
    write_folder(tmp_path)
    cv2.imwrite(str(tmp_path / "right_1.jpg"), picture(1, (32, 48)))
    for side in ("left", "right"):
        cv2.imwrite(str(tmp_path / f"{side}_2.jpg"), picture(1, (32, 24)))
    source = open_source(tmp_path)
    assert [frame.name for frame in frames_of(source)] == ["left_0.jpg", "left_3.jpg"]
    assert ["64x48 and 32x48" in source.notices[0].why, "32x24" in source.notices[1].why] == [True, True]


def break_first_pair(folder: Path) -> None:
    cv2.imwrite(str(folder / "right_0.jpg"), picture(1, (32, 48)))


def remove_images(folder: Path) -> None:
    for path in folder.glob("*.jpg"):
        path.unlink()


def spoil_images(folder: Path) -> None:
    for path in folder.glob("*.jpg"):
        path.write_bytes(b"\x00")


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (
            lambda folder: [path.unlink() for path in folder.iterdir()],
            ["no frames.csv", "t_s,left,right or t_s,stereo"],
        ),
        (lambda folder: (folder / "frames.csv").write_text("t_s,left,right\n"), ["no rows"]),
        (lambda folder: (folder / "frames.csv").write_text(""), ["empty", "t_s,left,right or t_s,stereo"]),
        (lambda folder: (folder / "frames.csv").write_text("time,l,r\n0,a,b\n"), ["'time,l,r'", "t_s,left,right"]),
        (lambda folder: (folder / "frames.csv").write_bytes(b"\xff\xfe\x00t"), ["frames.csv", "UTF-8"]),
        (lambda folder: (folder / "laser.csv").write_text("t,range\n"), ["laser.csv", "t_s,range_m"]),
        (lambda folder: (folder / "truth.csv").write_text("t,range\n"), ["truth.csv", "t_s,x_m,y_m,z_m,range_m"]),
        (lambda folder: (folder / "rig.yaml").write_text("nonsense: 1\n"), ["rig.yaml"]),
        (remove_images, ["left_0.jpg", "frames.csv"]),
        (spoil_images, ["no frame can be read", "left_0.jpg"]),
        (break_first_pair, ["64x48 and 32x48", "frames.csv row 2"]),
    ],
)
def test_no_dive_left_is_one_clear_line(tmp_path: Path, spoil: object, told: list[str]) -> None:
    write_folder(tmp_path)
    spoil(tmp_path)  # type: ignore[operator]
    with pytest.raises(InputError) as caught:
        open_source(tmp_path)
    text = str(caught.value)
    assert "\n" not in text
    assert all(word in text for word in told), text
    assert str(tmp_path) in text


@pytest.mark.parametrize("spec", ["nowhere", "README.md"])
def test_what_is_no_source(spec: str) -> None:
    with pytest.raises(InputError, match="dive folder"):
        open_source(spec)


MOTION = """t_s,vx_m_s,vy_m_s,vz_m_s,wx_rad_s,wy_rad_s,wz_rad_s,velocity_sigma_m_s
0.0,0.1,0,-0.2,,,,
0.3,,,,0.01,0.02,0.03,
0.6,0.1,0,fast,,,,
0.7,0.1,,0.2,,,,
0.8,,,,,,,
0.9,0.1,0,0,0,0,0,-1
1.0,0.3,0,0,0,0,0.1,0.004
"""


def test_the_vehicles_motion_comes_along_and_bad_rows_are_told(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "dive")
    (folder / "motion.csv").write_text(MOTION)
    source = open_source(folder)
    motions = [sample for sample in source if isinstance(sample, VehicleMotion)]
    assert motions == [
        VehicleMotion(0, (0.1, 0.0, -0.2)),
        VehicleMotion(300_000_000, None, (0.01, 0.02, 0.03)),
        VehicleMotion(1_000_000_000, (0.3, 0.0, 0.0), (0.0, 0.0, 0.1), 0.004),
    ]
    told = [str(notice) for notice in source.notices]
    assert len(told) == 4
    for text, row, why in zip(told, (4, 5, 6, 7), ("fast", "vy_m_s", "neither", "positive"), strict=True):
        assert f"motion.csv row {row}" in text
        assert why in text
    assert isinstance(next(iter(source)), VehicleMotion)  # of equal arrival it comes first: it helps the frame


def test_motion_of_other_columns_is_refused(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "dive")
    (folder / "motion.csv").write_text("t_s,speed\n0,1\n")
    with pytest.raises(InputError, match=r"motion\.csv.*vx_m_s,vy_m_s,vz_m_s or t_s,wx_rad_s"):
        open_source(folder)


def test_truth_with_gaps(tmp_path: Path) -> None:
    path = tmp_path / "truth.csv"
    path.write_text("t_s,x_m,y_m,z_m,range_m\n2,,,,5.0\n1,0.1,-0.2,2.3,2.25\nbad,1,1,1,1\n")
    told: list[object] = []
    first, second = read_truth(path, told.append)
    assert (first.t_ns, first.position_m, first.range_m) == (1_000_000_000, (0.1, -0.2, 2.3), 2.25)
    assert second.range_m == 5.0
    assert np.isnan(second.position_m).all()
    assert len(told) == 1


def test_real_time_keeps_the_pace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now, naps = [10.0], []

    def sleep(seconds: float) -> None:
        naps.append(seconds)
        now[0] += seconds

    monkeypatch.setattr("leadline.sources.base.time.monotonic", lambda: now[0])
    monkeypatch.setattr("leadline.sources.base.time.sleep", sleep)
    assert len(list(open_source(write_folder(tmp_path), real_time=True))) == 8
    assert sum(naps) == pytest.approx(1.2)
    naps.clear()
    list(open_source(tmp_path))
    assert naps == []


def test_written_folder_gives_the_same_samples(tmp_path: Path) -> None:
    samples = memory_dive()
    write_dive(tmp_path / "dive", samples, details={"spot_px": [1, 2]})
    source = open_source(tmp_path / "dive")
    again = list(source)
    for before, after in zip(samples, again, strict=True):
        if isinstance(before, StereoFrame):
            assert isinstance(after, StereoFrame)
            assert after.name == before.name
        assert same(before, after)
    assert source.notices == []
    assert (tmp_path / "dive" / "truth.json").exists()


def test_written_copy_keeps_the_bytes(tmp_path: Path) -> None:
    write_folder(tmp_path / "a")
    write_dive(tmp_path / "b", open_source(tmp_path / "a"))
    for path in (tmp_path / "a").iterdir():
        if path.suffix == ".jpg":
            assert (tmp_path / "b" / path.name).read_bytes() == path.read_bytes()
    pairs = zip(open_source(tmp_path / "a"), open_source(tmp_path / "b"), strict=True)
    assert all(same(a, b) for a, b in pairs)


@pytest.mark.parametrize("name", ["../escaped.png", "/tmp/escaped.png", "..", ""])
def test_a_name_does_not_lead_out_of_the_folder(tmp_path: Path, name: str) -> None:
    frame = StereoFrame(0, picture(1), picture(2), name=name)
    write_dive(tmp_path / "a" / "dive", [frame])
    assert sorted(path.name for path in (tmp_path / "a" / "dive").iterdir()) == [
        "frames.csv",
        "left_0000.png",
        "right_0000.png",
    ]
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["dive"]


def test_frames_of_one_name_do_not_overwrite_each_other(tmp_path: Path) -> None:
    samples = [StereoFrame(i, picture(i), picture(i + 9), name="left.png") for i in range(3)]
    write_dive(tmp_path / "dive", samples)
    back = frames_of(open_source(tmp_path / "dive"))
    assert [np.array_equal(one.left, other.left) for one, other in zip(samples, back, strict=True)] == [True] * 3


def test_a_folder_that_holds_something_is_not_written(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("x")
    with pytest.raises(InputError, match="empty folder"):
        write_dive(tmp_path, [])


@pytest.mark.data
def test_all_rendered_dives_are_clean(data_dir: Path) -> None:
    counts = Counter()
    for folder in sorted((data_dir / "rendered_dives").iterdir()):
        if (folder / "frames.csv").exists():
            source = open_source(folder)
            frames = sum(isinstance(sample, StereoFrame) for sample in source)
            assert source.notices == []
            assert frames == source.frame_count
            assert len(source.truth) > 0
            counts[folder.name] = frames
    assert counts["approach_ball_clear"] == 21


def test_image_size_against_the_rig(tmp_path: Path) -> None:
    source = open_source(write_folder(tmp_path))
    rig = Rig.load("rendered")
    with pytest.raises(InputError, match=r"64x48.*1920x1080"):
        require_size(rig, source)
    source.image_size = (1920, 1080)
    require_size(rig, source)


def test_a_row_that_ends_early_is_told_by_its_own_columns(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "dive", frames=3)
    with (folder / "frames.csv").open("a") as table:
        table.write("2.4\n")
    assert [notice.why for notice in open_source(folder).notices] == ["left is empty"]
