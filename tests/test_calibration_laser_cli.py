"""`calibrate laser` and `calibrate range` from the command line: dive to rig file, one line for each mistake."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from laser_scenes import AIR_Z_M, WATER_Z_M, air_rig, painted_dive, truth_rig
from leadline.cli import main
from leadline.rig import Rig
from leadline.samples import StereoFrame

RIG = truth_rig().scaled(0.5)


def write_dive(folder: Path, rig: Rig, z_m: Sequence[float], *, readings: bool = True) -> Path:
    folder.mkdir()
    frames, ranges = ["t_s,left,right"], ["t_s,range_m"]
    for sample in painted_dive(rig, z_m):
        if isinstance(sample, StereoFrame):
            right = sample.name.replace("left", "right")
            cv2.imwrite(str(folder / sample.name), sample.left)
            cv2.imwrite(str(folder / right), sample.right)
            frames.append(f"{sample.t_s},{sample.name},{right}")
        else:
            ranges.append(f"{sample.t_s},{sample.range_m}")
    (folder / "frames.csv").write_text("\n".join(frames) + "\n")
    if readings:
        (folder / "laser.csv").write_text("\n".join(ranges) + "\n")
    return folder


@pytest.fixture(scope="module")
def dives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dives")
    write_dive(folder / "air", air_rig(RIG), AIR_Z_M)
    write_dive(folder / "water", RIG, WATER_Z_M[::2])
    write_dive(folder / "silent", air_rig(RIG), AIR_Z_M[:2], readings=False)
    dataclasses.replace(RIG, laser=None).save(folder / "bare.yaml")
    dataclasses.replace(air_rig(RIG), laser=None).save(folder / "dry.yaml")
    RIG.save(folder / "full.yaml")
    return folder


def call(*words: str | Path) -> int:
    return main([str(word) for word in words])


def test_air_then_water_in_one_file(dives: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A rig without a laser becomes one with it, from the same file into the same file."""
    rig = tmp_path / "rig.yaml"
    rig.write_bytes((dives / "bare.yaml").read_bytes())
    assert call("calibrate", "laser", "--dive", dives / "air", "--rig", rig, "--out", rig) == 0
    said = capsys.readouterr().out
    assert f"{len(AIR_Z_M)} stations" in said
    assert "laser.range_scale" in said
    board = ("--board", "11x8", "--square", "0.030")
    assert call("calibrate", "range", "--dive", dives / "water", *board, "--rig", rig, "--out", rig) == 0
    assert "scale x group index 1.36" in capsys.readouterr().out
    found, truth = Rig.load(rig), RIG
    assert found.laser is not None
    assert truth.laser is not None
    for raw in (0.7, 1.5, 2.9):
        assert np.linalg.norm(found.laser.point_m(raw) - truth.laser.point_m(raw)) < 0.003
    assert found.virtual_focal_px is not None
    assert "laser.direction[0]" in found.covariance.names
    assert {"laser", "range"} <= set(found.provenance)
    for step in ("laser", "range"):
        page = (tmp_path / f"rig-{step}.html").read_text()
        assert "laser.range_scale" in page
        assert "left_02.png" in page
        assert page.count("<svg") == (
            5 if step == "laser" else 6
        )  # readings, two images, the point's sigma, limits, f'
    assert "water.group_index" in found.covariance.names


def test_refine_gives_an_air_rig_a_port(dives: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = tmp_path / "rig.yaml"
    assert call("calibrate", "laser", "--dive", dives / "air", "--rig", dives / "dry.yaml", "--out", rig) == 0
    known = ("--port-distance", "0.011", "--water-state", "salinity=0,temperature=20")
    assert call("calibrate", "range", "--refine", *known, "--dive", dives / "water", "--rig", rig, "--out", rig) == 0
    assert "sigma of a stereo depth" in capsys.readouterr().out
    found = Rig.load(rig)
    assert found.port is not None
    assert found.port.distance_m == pytest.approx(0.010, abs=0.004)
    assert found.port.outside_index == pytest.approx(1.335, abs=0.002)
    assert {"port.distance_m", "water.index"} <= set(found.covariance.names)


def test_the_papers_method(dives: Path, tmp_path: Path) -> None:
    out = tmp_path / "rig.yaml"
    assert (
        call(
            "calibrate",
            "laser",
            "--method",
            "paper",
            "--dive",
            dives / "air",
            "--rig",
            dives / "bare.yaml",
            "--out",
            out,
        )
        == 0
    )
    laser = Rig.load(out).laser
    assert laser is not None
    assert (laser.range_scale, laser.range_offset_m) == (1.0, 0.0)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("laser", "--dive", "silent", "--rig", "bare.yaml"), "no laser reading"),
        (("laser", "--dive", "nowhere", "--rig", "bare.yaml"), "nowhere"),
        (("laser", "--dive", "air"), "--rig is missing"),
        (("laser", "--dive", "water", "--rig", "bare.yaml"), "check --medium"),
        (("laser", "--dive", "water", "--medium", "water", "--rig", "dry.yaml"), "has no port"),
        (("laser", "--dive", "air", "--rig", "rendered"), "960x540"),
        (("laser", "--dive", "air", "--rig", "bare.yaml", "--board", "11x8"), "go together"),
        (("range", "--dive", "water", "--rig", "bare.yaml"), "calibrate laser"),
        (("range", "--dive", "water", "--rig", "dry.yaml"), "--refine"),
        (("range", "--refine", "--dive", "water", "--rig", "dry.yaml"), "calibrate laser"),
        (("range", "--dive", "air", "--rig", "full.yaml"), "expected in water"),
        (("range", "--refine", "--port-distance", "12", "--dive", "water", "--rig", "dry.yaml"), "--port-distance"),
        (("range", "--refine", "--water-state", "salt", "--dive", "water", "--rig", "dry.yaml"), "--water-state"),
    ],
)
def test_a_mistake_is_one_line(
    dives: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], said: str
) -> None:
    places = [str(dives / w) if w in ("silent", "air", "water", "nowhere") or w.endswith(".yaml") else w for w in words]
    if "--medium" in words:
        places[words.index("--medium") + 1] = "water"
    out = tmp_path / "out.yaml"
    assert call("calibrate", *places, "--out", out) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not out.exists()
    assert str(dives) in error or "--" in error


def test_boards_and_ranges(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is wrong with a board-and-rangefinder set is told with its row."""
    folder = tmp_path / "set"
    (folder / "images").mkdir(parents=True)
    cv2.imwrite(str(folder / "images" / "a.png"), np.zeros((480, 640, 3), np.uint8))
    table = folder / "ranges.csv"
    table.write_text("image,range_m\na.png,1.0\nb.png,2.0\n")
    wanted = ("calibrate", "laser", "--dive", folder, "--out", tmp_path / "out.yaml")
    assert call(*wanted) == 2
    assert "--board" in capsys.readouterr().err
    assert call(*wanted, "--board", "8x6", "--square", "0.0387") == 2
    assert "board" in capsys.readouterr().err
    table.write_text("image,range_m\nc.png,1.0\na.png,-1\n")
    assert call(*wanted, "--board", "8x6", "--square", "0.0387") == 2
    assert "no file c.png" in capsys.readouterr().err


@pytest.mark.data
def test_a_real_board_set_with_its_own_camera(
    data_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a rig the camera comes from the same boards; its file, given back as --rig, says the same."""
    folder, out = data_dir / "laser_rangefinder_board_air", tmp_path / "camera.yaml"
    words = ("calibrate", "laser", "--dive", folder, "--board", "8x6", "--square", "0.0387", "--out", out)
    assert call(*words) == 0
    said = capsys.readouterr().out
    assert "the device is wrong below 0." in said
    assert "0020.jpg" in said
    assert call(*words, "--rig", out) == 0
    again = capsys.readouterr().out
    assert again.split("laser.origin")[1] == said.split("laser.origin")[1]
