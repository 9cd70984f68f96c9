"""A laser that is switched from frame to frame: what the frame without it takes away."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from leadline.config import Config
from leadline.localizer.laser import LaserSight
from leadline.localizer.motion import Skew
from leadline.recognition.dark import aligned
from leadline.samples import Image, Measurement, StereoFrame
from leadline.simulation.dive import SimulatedDive
from leadline.simulation.scenario import Scenario
from leadline.sinks import McapSink
from leadline.sources.mcap import McapSource
from leadline.target import Sphere
from leadline.wire.dive_folder import read_frames
from leadline.wire.dive_writer import write_dive
from leadline.wire.notice import Notice

STILL = Skew(0.0, np.zeros(3), np.zeros((3, 3)))


def switched(seed: int) -> SimulatedDive:
    """A weathered ball, 20 frames a second, approached at 0.3 m/s from 1.1 to 0.7 m."""
    demo = Scenario.load("demo")
    parts = {
        "laser": demo.laser.model_copy(update={"alternates": True}),
        "target": demo.target.model_copy(update={"contrast": 1.5, "detail": 1.5}),
        "camera": demo.camera.model_copy(update={"rate_hz": 20.0}),
        "path": demo.path.model_copy(update={"start_m": 1.1, "end_m": 0.7, "speed_m_s": 0.3, "dwell_s": 0.0}),
    }
    return SimulatedDive(demo.model_copy(update=parts), seed)


def test_the_other_frame_takes_the_texture_away_while_the_target_moves() -> None:
    """Lengths by the spot: with the pair closer to the truth than by each lit frame alone."""
    dive = switched(5)
    frames = [sample for sample in dive.samples() if isinstance(sample, StereoFrame)]
    truth = {frame["name"]: frame for frame in dive.details["frames"]}
    assert [frame.laser_on for frame in frames[:4]] == [True, False, True, False]
    pair, alone = (LaserSight(dive.rig, Sphere(0.34), Config()) for _ in range(2))
    errors: list[tuple[float, float]] = []
    for dark, lit in pairwise(frames):
        if not lit.laser_on:
            continue
        one = truth[lit.name]
        x = np.array(one["position_m"])
        assert pair.spot(dark, dark.t_ns, x, STILL) == []
        found = [sight.spot(lit, lit.t_ns, x, STILL)[0] for sight in (pair, alone)]
        assert all(isinstance(measurement, Measurement) for measurement in found)
        lengths = [float(measurement.z[0]) for measurement in found if isinstance(measurement, Measurement)]
        errors.append((lengths[0] - one["spot"]["length_m"], lengths[1] - one["spot"]["length_m"]))
    with_pair, by_itself = np.sqrt(np.mean(np.square(errors), axis=0))
    assert len(errors) > 8
    assert with_pair < 0.8 * by_itself


def textured(rng: np.random.Generator) -> Image:
    field = cv2.GaussianBlur(rng.normal(0, 1, (160, 240)), (0, 0), 2.0)
    return np.clip(np.round(100 + 25 * field / field.std()), 0, 255).astype(np.uint8)


def moved(image: Image, x: float, y: float) -> Image:
    move = np.array([[1.0, 0.0, x], [0.0, 1.0, y]])
    size = image.shape[1], image.shape[0]
    return np.asarray(cv2.warpAffine(image, move, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT), np.uint8)


def test_a_picture_that_moved_is_moved_back() -> None:
    dark = textured(np.random.default_rng(1))
    back = aligned(dark, moved(dark, 3.4, -2.7))
    assert back is not None
    rest = back[20:-20, 20:-20].astype(float) - moved(dark, 3.4, -2.7)[20:-20, 20:-20]
    assert rest.std() < 4  # of 25


@pytest.mark.parametrize("what", ["another", "far", "bare"])
def test_a_picture_that_does_not_help_is_left(what: str) -> None:
    rng = np.random.default_rng(2)
    dark = textured(rng)
    bare = np.clip(100 + rng.normal(0, 2, dark.shape), 0, 255).astype(np.uint8)
    light = {"another": textured(rng), "far": moved(dark, 30, 0), "bare": bare}[what]
    assert aligned(bare[::-1].copy() if what == "bare" else dark, light) is None


def test_the_switch_is_in_the_dive_folder(tmp_path: Path) -> None:
    picture = np.zeros((4, 6, 3), np.uint8)
    frames = [StereoFrame(10**9 * i, picture, picture, laser_on=on) for i, on in enumerate((True, False, None))]
    write_dive(tmp_path / "dive", frames)
    read = [entry.load().laser_on for entry in read_frames(tmp_path / "dive", lambda _: None)]
    assert read == [True, False, None]
    write_dive(tmp_path / "plain", [dataclasses.replace(frame, laser_on=None) for frame in frames])
    assert "laser_on" not in (tmp_path / "plain" / "frames.csv").read_text()


def test_the_switch_is_in_a_recording(tmp_path: Path) -> None:
    picture = np.zeros((4, 6, 3), np.uint8)
    sink = McapSink(tmp_path / "dive.mcap")
    for i, on in enumerate((True, False, None)):
        sink.sample(StereoFrame(10**9 * i, picture, picture, laser_on=on))
    sink.close()
    read = [one.laser_on for one in McapSource(tmp_path / "dive.mcap") if isinstance(one, StereoFrame)]
    assert read == [True, False, None]


def test_a_switch_that_is_neither_is_told(tmp_path: Path) -> None:
    picture = np.zeros((4, 6, 3), np.uint8)
    write_dive(tmp_path / "dive", [StereoFrame(10**9 * i, picture, picture, laser_on=True) for i in range(2)])
    table = tmp_path / "dive" / "frames.csv"
    lines = table.read_text().splitlines()
    table.write_text("\n".join([*lines[:2], lines[2][:-1] + "yes"]) + "\n")
    told: list[Notice] = []
    assert len(read_frames(tmp_path / "dive", told.append)) == 1
    assert "laser_on is yes, not 0 or 1" in told[0].why
