"""A simulated dive: repeatable, in order, true to its own truth; and its pictures hold what stereo needs."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from leadline.errors import InputError
from leadline.geometry import Pose
from leadline.rig import Rig
from leadline.samples import LaserRange, Sample, StereoFrame, VehicleMotion
from leadline.simulation.dive import SimulatedDive
from leadline.simulation.renderer import Eye, View
from leadline.simulation.scenario import Scenario, shipped_scenarios
from leadline.simulation.scene import Scene
from leadline.simulation.spot import Beamed, spot_light
from leadline.sources import open_source

SMALL: dict[str, Any] = {"camera": {"image_width_px": 320, "rate_hz": 4.0}, "path": {"start_m": 1.6, "speed_m_s": 0.4}}


def small(**changes: Any) -> Scenario:
    return Scenario.model_validate({**SMALL, **changes})


def digest(samples: list[Sample]) -> str:
    h = hashlib.sha256()
    for s in samples:
        h.update(repr((s.t_ns, s.arrival_ns)).encode())
        h.update(s.left.tobytes() + s.right.tobytes() if isinstance(s, StereoFrame) else repr(s).encode())
    return h.hexdigest()


@cache
def a_dive() -> tuple[SimulatedDive, list[Sample]]:
    dive = SimulatedDive(small(camera={"image_width_px": 320, "rate_hz": 4.0, "skew_s": 0.01}), seed=2)
    return dive, list(dive.samples())


def test_a_seed_gives_the_same_bytes() -> None:
    scenario = small(laser={"dropouts": 0.3, "outliers": 0.2}, water="turbid")
    first, again, other = (digest(list(islice(SimulatedDive(scenario, s).samples(), 8))) for s in (5, 5, 6))
    assert first == again
    assert first != other


def test_a_dive_can_be_taken_twice() -> None:
    dive = SimulatedDive(small(water="green"), seed=2)
    assert digest(list(islice(dive.samples(), 5))) == digest(list(islice(dive.samples(), 5)))


def test_samples_come_in_the_order_of_arrival_and_have_truth() -> None:
    dive, samples = a_dive()
    arrivals = [s.arrival_ns for s in samples if s.arrival_ns is not None]
    assert len(arrivals) == len(samples)
    assert arrivals == sorted(arrivals)
    assert all(s.arrival_ns > s.t_ns for s in samples if s.arrival_ns is not None)
    assert {s.t_ns for s in samples} <= {t.t_ns for t in dive.truth}
    frames = [s for s in samples if isinstance(s, StereoFrame)]
    assert len(frames) == dive.frame_count == len({f.name for f in frames})
    assert frames[0].left.shape == (180, 320, 3)
    assert all(f.left_t_ns == f.t_ns and f.right_t_ns == f.t_ns + 10_000_000 for f in frames)


def test_details_are_plain_json() -> None:
    dive = SimulatedDive(
        small(faults=[{"sensor": "laser", "mode": "off"}], camera={"image_width_px": 64, "rate_hz": 1.0})
    )
    assert not any(isinstance(s, LaserRange) for s in dive.samples())
    again = json.loads(json.dumps(dive.details, allow_nan=False))
    assert again["scenario"]["faults"][0]["end_s"] is None
    assert len(again["frames"]) == dive.frame_count


def test_truth_of_a_ball_is_the_analytic_one() -> None:
    dive, _ = a_dive()
    for truth in dive.truth:
        assert truth.range_m == pytest.approx(float(np.linalg.norm(truth.position_m)) - 0.17, abs=1e-12)
    ranges = [t.range_m for t in dive.truth]
    assert ranges[0] == pytest.approx(1.6, abs=0.03)
    assert min(ranges) == pytest.approx(0.2, abs=0.02)


def test_velocity_is_the_positions_rate() -> None:
    dive, _ = a_dive()
    frames = dive.details["frames"]
    for frame in frames[2:8]:
        steps = [dive.truth_at(frame["t_ns"] + s) for s in (-5_000_000, 5_000_000)]
        rate = (np.array(steps[1].position_m) - steps[0].position_m) / 0.01
        np.testing.assert_allclose(frame["velocity_m_s"], rate, atol=2e-4)
    assert max(-f["velocity_m_s"][2] for f in frames) > 0.3


def test_the_vehicles_motion_is_that_of_what_stands_still() -> None:
    """A still ball's centre moves by -v - w x p; the readings scatter by their sigmas (2000 numbers: 4 sigma)."""
    scenario = Scenario.model_validate(
        {"path": {"start_m": 1.6, "speed_m_s": 0.3, "attitude_deg": 5.0}, "vehicle": {"rate_hz": 100}}
    )
    dive = SimulatedDive(scenario, seed=2)
    off = []
    for motion in _motions(dive):
        p_m = np.array(dive.truth_at(motion.t_ns).position_m)
        assert motion.arrival_ns == motion.t_ns + 20_000_000
        still = -np.array(motion.velocity_m_s) - np.cross(motion.rotation_rad_s, p_m)
        sigma = np.sqrt(0.01**2 + 0.002**2 * (p_m @ p_m - p_m**2))
        off.append((dive.velocity_m_s(motion.t_ns) - still) / sigma)
    assert len(off) > 300
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(1.0, abs=4 / np.sqrt(2 * np.size(off)))


def _motions(dive: SimulatedDive) -> list[VehicleMotion]:
    """Without rendering a single frame."""
    dive._frame_times = []
    return [sample for sample in dive.samples() if isinstance(sample, VehicleMotion)]


def test_spot_pixels_triangulate_to_the_beams_point() -> None:
    dive, _ = a_dive()
    assert dive.rig.laser is not None
    spots = [f["spot"] for f in dive.details["frames"]]
    seen = [s for s in spots if s and s["on_target"] and s["left_px"] and s["right_px"]]
    assert len(seen) >= 5
    for spot in seen:
        point, _ = dive.rig.triangulate([spot["left_px"]], [spot["right_px"]])
        np.testing.assert_allclose(point[0], spot["point_m"], atol=1e-7)
        np.testing.assert_allclose(
            dive.rig.laser.origin_m + spot["length_m"] * dive.rig.laser.direction, point[0], atol=1e-7
        )


def test_the_spot_lies_on_the_targets_surface() -> None:
    dive, _ = a_dive()
    for frame in dive.details["frames"]:
        if frame["spot"] and frame["spot"]["on_target"]:
            away = np.linalg.norm(np.array(frame["spot"]["point_m"]) - frame["position_m"])
            assert away == pytest.approx(0.17, abs=1e-9)


def test_boxes_hold_the_projected_ball() -> None:
    dive, _ = a_dive()
    for frame in dive.details["frames"]:
        centre = np.array(frame["position_m"])
        if centre[2] < 0.9:
            continue
        across = np.array([[0.17, 0, 0], [-0.17, 0, 0], [0, 0.17, 0], [0, -0.17, 0]])
        left, right = dive.rig.project(centre + across * 0.97)
        for pixels, box in ((left, frame["box_left_px"]), (right, frame["box_right_px"])):
            assert pixels[:, 0].min() > box[0] - 0.5
            assert pixels[:, 0].max() < box[2] - 0.5
            assert box[2] - box[0] < (pixels[0, 0] - pixels[1, 0]) * 1.12 + 2


def test_laser_readings_follow_the_rigs_model() -> None:
    part = {"scale": 1.004, "offset_m": 0.012, "dropouts": 0.0, "rate_hz": 40.0}
    dive = SimulatedDive(small(laser=part, camera={"image_width_px": 64, "rate_hz": 0.5}), seed=1)
    readings = [s for s in dive.samples() if isinstance(s, LaserRange)]
    truth = {d["t_ns"]: d for d in dive.details["laser"]}
    assert dive.rig.laser is not None
    assert dive.rig.laser.group_index == pytest.approx(1.35656, abs=1e-4)
    errors = [r.range_m - (1.004 * 1.35656 * truth[r.t_ns]["length_m"] + 0.012) for r in readings]
    # 100+ readings: the standard deviation of the estimate of sigma is 7 %
    assert len(errors) > 100
    assert np.std(errors) == pytest.approx(0.003, rel=0.28)
    assert abs(np.mean(errors)) < 0.0012
    assert all(abs(r.range_m * 1000 - round(r.range_m * 1000)) < 1e-6 for r in readings)
    assert all(r.quality is not None and 0 < r.quality <= 1 for r in readings)


def test_laser_faults_come_at_their_rates() -> None:
    part = {"dropouts": 0.2, "outliers": 0.1, "early_returns": 0.5, "rate_hz": 100.0, "clock_offset_s": 0.02}
    dive = SimulatedDive(small(laser=part, water="turbid", camera={"image_width_px": 64, "rate_hz": 0.5}), seed=3)
    readings = [s for s in dive.samples() if isinstance(s, LaserRange)]
    kinds = [d["kind"] for d in dive.details["laser"]]
    n = len(kinds)
    assert n > 350
    # three-sigma bands of the binomial
    assert abs(kinds.count("outlier") / n - 0.1) < 3 * (0.09 / n) ** 0.5
    assert abs(kinds.count("none") / n - 0.2) < 3 * (0.16 / n) ** 0.5
    early = [d for d in dive.details["laser"] if d["kind"] == "early"]
    assert len(early) > 30
    assert all(d["stamp_ns"] - d["t_ns"] == 20_000_000 for d in dive.details["laser"])
    assert dive.rig.laser is not None
    by_stamp = {r.t_ns: r for r in readings}
    raw = [dive.rig.laser.length_m(by_stamp[d["stamp_ns"]].range_m) - d["length_m"] for d in early]
    assert np.mean(np.array(raw) < -0.02) > 0.8
    quality = {
        k: np.mean([by_stamp[d["stamp_ns"]].quality for d in dive.details["laser"] if d["kind"] == k])
        for k in ("early", "target")
    }
    assert quality["early"] < quality["target"] - 0.15


def test_a_beam_that_passes_by_ranges_to_the_wall_behind() -> None:
    dive = SimulatedDive(
        small(path={"start_m": 1.5, "offset_m": [0.6, 0.0], "speed_m_s": 1.0}, laser={"dropouts": 0.0})
    )
    readings = [s for s in dive.samples() if isinstance(s, LaserRange)]
    assert readings
    assert {d["kind"] for d in dive.details["laser"]} == {"backdrop"}
    assert all(d["length_m"] > d["range_m"] + 1 for d in dive.details["laser"])
    assert not any(f["spot"]["on_target"] for f in dive.details["frames"])


CLEAN = {"vignetting": 0.0, "shot_noise": 0.0, "read_noise": 0.0, "exposure_s": 0.0, "jitter_s": 0.0}


@pytest.mark.parametrize("shape", ["sphere", "plane", "cylinder", "lump"])
def test_matched_texture_triangulates_to_the_surface(shape: str) -> None:
    """Render at 1 m, follow patches from left to right by optical flow, triangulate: on the surface, to millimetres."""
    scenario = Scenario.model_validate(
        {
            "target": {"shape": shape, "diameter_m": 0.5, "contrast": 1.2, "tilt_deg": [4, -6]},
            "water": {"c": [0.1] * 3, "B": [0.1] * 3, "k": [0.1] * 3, "forward": 0.0, "snow_per_m3": 0},
            "camera": CLEAN,
            "laser": {"power": 0.0},
            "path": {"start_m": 1.0, "end_m": 0.99, "dwell_s": 0.0, "offset_m": [-0.03, 0.0]},
        }
    )
    dive = SimulatedDive(scenario, 4)
    frame = next(s for s in dive.samples() if isinstance(s, StereoFrame))
    T = dive._motion.pose(0.0).inverse()
    nearest = np.array(dive.truth_at(0).position_m) if shape in ("plane", "lump") else np.array([-0.03, 0, 1.0])
    centre = dive.rig.project(nearest[None])[0][0]
    grid = np.stack(np.meshgrid(np.arange(-40, 41, 20), np.arange(-40, 41, 20)), -1).reshape(-1, 2) + centre
    guess = grid - [dive.rig.left.fx * 1.333 * 0.063, 0]
    grey = [cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in (frame.left, frame.right)]
    matched, found, _ = cv2.calcOpticalFlowPyrLK(
        grey[0],
        grey[1],
        np.ascontiguousarray(grid[:, None], np.float32),
        np.ascontiguousarray(guess[:, None], np.float32),
        winSize=(25, 25),
        maxLevel=0,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    found = found.ravel() == 1
    assert found.sum() >= 20
    points, _ = dive.rig.triangulate(grid[found], matched[found, 0])
    origins, directions = dive.rig.rays(grid[found])
    errors = []
    for point, origin, direction in zip(points, origins, directions, strict=True):
        length = dive._scene.shape.hit_m(T.apply(origin), T.rotate(direction))
        assert length is not None
        errors.append(np.linalg.norm(point - origin) - length)
    assert abs(np.median(errors)) < 0.003
    assert np.percentile(np.abs(errors), 80) < 0.01


@pytest.mark.parametrize("range_m", [0.35, 1.0, 2.0])
def test_the_rendered_spot_is_centred_on_the_true_pixel(range_m: float) -> None:
    """Light's centroid against the projected point, on a wall square to the beam: 0.05 px."""
    rig = Rig.load("paper").scaled(1 / 3)
    assert rig.laser is not None
    scenario = Scenario.model_validate({"target": {"shape": "plane", "contrast": 0.0}})
    scene = Scene(scenario, np.random.default_rng(0), 64)
    T = Pose(np.eye(3), [0.0, 0.0, range_m])
    origin = T.inverse().apply(rig.laser.origin_m)
    length = scene.shape.hit_m(origin, rig.laser.direction)
    assert length is not None
    point = rig.laser.origin_m + length * rig.laser.direction
    normal = np.array([0.0, 0.0, -1.0])
    beam = Beamed(origin, rig.laser.direction, length, point, rig.laser.origin_m, normal, True, 0.003, 1.0)
    for side, pixel in zip(("left", "right"), rig.project(point[None]), strict=True):
        eye = Eye(rig, side, scenario.camera)  # type: ignore[arg-type]
        x0, y0 = np.round(pixel[0]).astype(int) - 30
        part = (slice(y0, y0 + 61), slice(x0, x0 + 61))
        light = spot_light(scene, beam, *eye.rays_in(T, part), eye.pixel_rad[part])[..., 1]
        y, x = np.mgrid[:61, :61]
        centroid = np.array([(light * x).sum(), (light * y).sum()]) / light.sum() + [x0, y0]
        assert np.abs(centroid - pixel[0]).max() < 0.05


def test_spot_is_drawn_in_both_pictures() -> None:
    def greens(power: float) -> list[Any]:
        dive = SimulatedDive(Scenario.model_validate({**common, "laser": {"power": power, "dropouts": 1.0}}))
        frame = next(s for s in dive.samples() if isinstance(s, StereoFrame))
        spots.append(dive.details["frames"][0]["spot"])
        return [image[..., 1].astype(float) for image in (frame.left, frame.right)]

    spots: list[Any] = []
    common = {"camera": CLEAN, "path": {"start_m": 1.0, "end_m": 0.9}}
    for on, off, side in zip(greens(20.0), greens(0.0), ("left_px", "right_px"), strict=True):
        extra = on - off
        row, column = np.unravel_index(int(np.argmax(extra)), extra.shape)
        assert extra[row, column] > 60
        assert np.abs(np.array([column, row]) - spots[0][side]).max() < 1.5


def test_water_takes_red_light_and_contrast() -> None:
    ratios, contrasts = [], []
    for water in ("clear", "green", "turbid"):
        dive = SimulatedDive(Scenario.model_validate({"water": water, "camera": CLEAN, "path": {"start_m": 2.0}}))
        frame = next(s for s in dive.samples() if isinstance(s, StereoFrame))
        x0, y0, x1, y1 = dive.details["frames"][0]["box_left_px"]
        ball = frame.left[(y0 + y1) // 2 - 8 : (y0 + y1) // 2 + 8, (x0 + x1) // 2 - 8 : (x0 + x1) // 2 + 8].astype(
            float
        )
        beside = frame.left[(y0 + y1) // 2 - 8 : (y0 + y1) // 2 + 8, x1 + 5 : x1 + 21].astype(float)
        ratios.append(ball[..., 2].mean() / ball[..., 1].mean())
        contrasts.append(np.abs(ball.mean((0, 1)) - beside.mean((0, 1))).max())
    assert ratios[0] > ratios[1] > ratios[2]
    assert contrasts[0] > contrasts[1] > contrasts[2] > 5


def test_snow_hangs_in_space() -> None:
    """The same particles, lit and unlit by nothing else, stand at places of one depth in both pictures."""
    from leadline.simulation.particles import Snow, project_side  # noqa: PLC0415

    rig = Rig.load("paper").scaled(1 / 3)
    places, _ = Snow(50.0, (), np.random.default_rng(0)).seen(1.0, Pose(np.eye(3), [0, 0, 1.0]))
    assert len(places) > 50
    left, right = project_side(rig, "left", places), project_side(rig, "right", places)
    seen = np.isfinite(left).all(1) & np.isfinite(right).all(1)
    points, _ = rig.triangulate(left[seen], right[seen])
    np.testing.assert_allclose(points, places[seen], atol=1e-6)


def test_motion_blurs_along_the_motion() -> None:
    rig = Rig.load("paper").scaled(1 / 3)
    scenario = Scenario.model_validate({"camera": CLEAN})
    scene, eye = Scene(scenario, np.random.default_rng(0), 512), Eye(rig, "left", scenario.camera)
    from leadline.simulation.particles import Snow  # noqa: PLC0415

    def gradients(motion: list[float]) -> tuple[float, float]:
        view = View(0.0, Pose(np.eye(3), [0, 0, 0.9]), 0.73, np.array(motion), np.zeros(2), None)
        image, box = eye.render(scene, view, Snow(0, (), np.random.default_rng(0)), np.random.default_rng(0))
        assert box is not None
        inner = image[120:240, 260:360].astype(float)
        return float(np.abs(np.diff(inner, axis=1)).mean()), float(np.abs(np.diff(inner, axis=0)).mean())

    still, moving = gradients([0.0, 0.0]), gradients([8.0, 0.0])
    assert moving[0] / moving[1] < 0.85 * still[0] / still[1]


@pytest.mark.parametrize("name", shipped_scenarios())
def test_shipped_scenarios_load_and_render(name: str) -> None:
    scenario = Scenario.load(name)
    assert scenario.name == name
    tiny = scenario.model_copy(update={"camera": scenario.camera.model_copy(update={"image_width_px": 160})})
    dive = SimulatedDive(tiny)
    frame = next(s for s in dive.samples() if isinstance(s, StereoFrame))
    assert frame.left.std() > 1
    assert dive.truth[0].range_m == pytest.approx(scenario.path.start_m, rel=0.05)
    assert dive.truth[-1].range_m == pytest.approx(scenario.path.end_m, abs=0.05)


def test_shipped_names() -> None:
    assert {"approach", "hull", "pile", "turbid", "stress", "demo"} <= set(shipped_scenarios())
    assert Scenario.load("demo").duration_s <= 20


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("wator: clear", "wator"),
        ("camera: {rate_hz: -1}", "camera.rate_hz"),
        ("path: {start_m: 0.1, end_m: 0.2}", "path"),
        ("water: soup", "water"),
        ("faults: [{sensor: laser, mode: melted}]", "faults.0.mode"),
        ("a: [", "YAML"),
        ("- 1", "the file"),
    ],
)
def test_a_wrong_scenario_names_the_key(tmp_path: Path, text: str, names: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=names) as caught:
        Scenario.load(path)
    assert "\n" not in str(caught.value)
    assert "mine.yaml" in str(caught.value)


def test_an_unknown_scenario_lists_those_there_are() -> None:
    with pytest.raises(InputError, match=r"approach.*turbid"):
        Scenario.load("aproach")


def test_as_a_source(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("name: mine\ncamera: {image_width_px: 64, rate_hz: 2.0}\npath: {start_m: 0.6, speed_m_s: 0.4}\n")
    source = open_source(f"sim:{path}", seed=3)
    samples = list(source)
    assert source.name == "sim:mine"
    assert source.rig is not None
    assert source.image_size == (64, 36)
    assert source.frame_count == sum(isinstance(s, StereoFrame) for s in samples)
    assert source.notices == []
    assert digest(samples) == digest(list(source))
