"""A simulated dive: samples in the order of their arrival, and the truth of everything."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from leadline.geometry import Beam, Pose
from leadline.rig import Rig
from leadline.samples import NS_PER_S, Array, LaserRange, Sample, StereoFrame, Truth, VehicleMotion
from leadline.simulation.faults import inject
from leadline.simulation.motion import Motion
from leadline.simulation.particles import Snow
from leadline.simulation.renderer import Box, Eye, View
from leadline.simulation.scenario import Scenario
from leadline.simulation.scene import Scene
from leadline.simulation.sensors import (
    Instant,
    Rangefinder,
    ReadingKind,
    beam_in_scene,
    camera_instants,
    laser_instants,
    vehicle_instants,
)
from leadline.simulation.spot import Beamed

Vector = tuple[float, float, float]
Pixel = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Spot:
    """Where the beam meets something: length, place (left frame) and pixels, None where a camera does not see it."""

    on_target: bool
    length_m: float
    point_m: Vector
    left_px: Pixel | None
    right_px: Pixel | None


@dataclass(frozen=True, slots=True)
class FrameTruth:
    """A stereo frame's truth. Boxes are x0, y0, x1, y1 of the target's pixels, the ends not included."""

    t_ns: int
    name: str
    position_m: Vector
    range_m: float
    velocity_m_s: Vector
    box_left_px: Box | None
    box_right_px: Box | None
    spot: Spot | None


@dataclass(frozen=True, slots=True)
class LaserTruth:
    """A reading's truth at its true time; ``stamp_ns`` is what the laser's clock says."""

    t_ns: int
    stamp_ns: int
    kind: ReadingKind
    length_m: float | None
    position_m: Vector
    range_m: float


class SimulatedDive:
    """``samples()`` can be called again and again; the same seed gives the same bytes.

    rig: the true rig, at the size of the images. truth: of every frame and reading, by true time. details: fills while
    samples are taken: {"frames": [...], "laser": [...]} as plain values, for ``truth.json``.
    """

    def __init__(self, scenario: Scenario | str | Path, seed: int = 0, rig: Rig | None = None) -> None:
        """``rig``: the true one, in place of the scenario's (a wrong index, a tilted port), at any image size."""
        self.scenario = scenario if isinstance(scenario, Scenario) else Scenario.load(scenario)
        self.seed = seed
        self.rig = _true_rig(self.scenario, rig)
        seeds = np.random.SeedSequence(seed).spawn(8)  # a new one goes to the end: the others' dives stay
        scene, motion, snow, times, self._laser_seed, self._fault_seed, self._noise_seed, self._vehicle_seed = seeds
        texels = 1024 if self.rig.left.width <= 960 else 4096
        self._scene = Scene(self.scenario, np.random.default_rng(scene), 2 * texels if texels < 4096 else texels)
        self._motion = Motion(self.scenario.path, self._scene.shape.reach_m, np.random.default_rng(motion))
        self._snow_seed = snow
        rng = np.random.default_rng(times)
        duration_s = self.scenario.duration_s
        self._frame_times = camera_instants(self.scenario.camera, duration_s, rng)
        self._laser_times = laser_instants(self.scenario.laser, duration_s, rng) if self.rig.laser is not None else []
        self._vehicle_times = vehicle_instants(self.scenario.vehicle, duration_s)
        times_ns = sorted({i.t_ns for i in (*self._frame_times, *self._laser_times)})
        self.truth = [self.truth_at(t_ns) for t_ns in times_ns]
        self.details: dict[str, Any] = {}

    @property
    def frame_count(self) -> int:
        return len(self._frame_times)

    def truth_at(self, t_ns: int) -> Truth:
        T_left_scene = self._motion.pose(t_ns / NS_PER_S)
        eye_m = T_left_scene.inverse().t_m
        shape = self._scene.shape
        position = T_left_scene.apply(shape.position_m(eye_m))
        return Truth(t_ns, _vector(position), float(np.linalg.norm(shape.nearest_m(eye_m) - eye_m)))

    def velocity_m_s(self, t_ns: int, step_ns: int = 100_000) -> Array:
        """Velocity (3,) of the target's position in the left camera's frame."""
        ahead, behind = (np.array(self.truth_at(t_ns + s).position_m) for s in (step_ns, -step_ns))
        return np.asarray((ahead - behind) / (2 * step_ns / NS_PER_S))

    def samples(self) -> Iterator[Sample]:
        """Rendered as they are taken."""
        return inject(self._healthy(), self.scenario.faults, np.random.default_rng(self._fault_seed))

    def _healthy(self) -> Iterator[Sample]:
        self.details.clear()
        self.details.update(scenario=self.scenario.model_dump(mode="json"), seed=self.seed, frames=[], laser=[])
        rng = np.random.default_rng(self._laser_seed)
        scenario = self.scenario
        snow = Snow(scenario.optics.snow_per_m3, scenario.snow_bursts_s, np.random.default_rng(self._snow_seed))
        vehicle_rng = np.random.default_rng(self._vehicle_seed)
        events = [(i.arrival_ns, 0, n, i) for n, i in enumerate(self._frame_times)]
        events += [(i.arrival_ns, 1, n, i) for n, i in enumerate(self._laser_times)]
        events += [(i.arrival_ns, -1, n, i) for n, i in enumerate(self._vehicle_times)]
        with ThreadPoolExecutor(2) as pool:
            eyes = list(pool.map(lambda side: Eye(self.rig, side, scenario.camera), ("left", "right")))
            for _, turn, number, instant in sorted(events, key=lambda event: event[:3]):
                if turn < 0:
                    yield self._sense_motion(instant, vehicle_rng)
                elif turn:
                    reading = self._read_laser(instant, rng)
                    if reading is not None:
                        yield reading
                else:
                    yield self._expose(number, instant, eyes, snow, pool)

    def _expose(
        self, number: int, instant: Instant, eyes: list[Eye], snow: Snow, pool: ThreadPoolExecutor
    ) -> StereoFrame:
        part = self.scenario.camera
        left_ns, right_ns = instant.t_ns, instant.t_ns + round(part.skew_s * NS_PER_S)
        shines = not (self.scenario.laser.alternates and number % 2)

        def render(side: int) -> tuple[Any, Box | None]:
            noise = np.random.SeedSequence((*_words(self._noise_seed), number, side))
            view = self._view((left_ns, right_ns)[side] / NS_PER_S)
            view = view if shines else dataclasses.replace(view, beam=None)
            return eyes[side].render(self._scene, view, snow, np.random.default_rng(noise))

        (left, box_left), (right, box_right) = pool.map(render, (0, 1))
        name = f"left_{number:05d}.png"
        truth = self.truth_at(left_ns)
        velocity = _vector(self.velocity_m_s(left_ns))
        spot = self._spot(left_ns) if shines else None
        frame_truth = FrameTruth(left_ns, name, truth.position_m, truth.range_m, velocity, box_left, box_right, spot)
        self.details["frames"].append(asdict(frame_truth))
        told = (left_ns, right_ns) if part.skew_s and part.skew_known else (None, None)
        laser_on = shines if self.scenario.laser.alternates else None
        return StereoFrame(left_ns, left, right, instant.arrival_ns, told[0], told[1], name, laser_on=laser_on)

    def _view(self, t_s: float) -> View:
        T = self._motion.pose(t_s)
        half_s = self.scenario.camera.exposure_s / 2
        eye_m = T.inverse().t_m
        nearest = self._scene.shape.nearest_m(eye_m)
        behind = T.inverse().apply(np.array([0.0, 0.0, float(np.linalg.norm(nearest - eye_m)) + 2.0]))
        moved = []
        for place in (nearest, behind):
            ends = np.stack([self._motion.pose(t_s + s).apply(place) for s in (-half_s, half_s)])
            pixels = self.rig.project(ends)[0]
            moved.append(np.nan_to_num(pixels[1] - pixels[0]))
        return View(t_s, T, float(np.linalg.norm(nearest - eye_m)), moved[0], moved[1], self._beamed(T))

    def _beamed(self, T_left_scene: Pose) -> Beamed | None:
        laser = self.rig.laser
        if laser is None:
            return None
        origin, direction, hit = self._beam_hit(laser, T_left_scene)
        if hit is None:
            return None
        length, on_target = hit
        point = origin + length * direction
        surface = self._scene.shape if on_target or self._scene.backdrop is None else self._scene.backdrop
        return Beamed(
            origin_m=origin,
            direction=direction,
            length_m=length,
            point_left_m=laser.origin_m + length * laser.direction,
            origin_left_m=laser.origin_m,
            normal=surface.normal_at(point),
            on_target=on_target,
            radius_m=self.scenario.laser.spot_diameter_m / 2,
            power=self.scenario.laser.power,
        )

    def _beam_hit(self, laser: Beam, T_left_scene: Pose) -> tuple[Array, Array, tuple[float, bool] | None]:
        inverse = T_left_scene.inverse()
        origin, direction = beam_in_scene(laser, inverse.R, inverse.t_m)
        return origin, direction, self._scene.beam_hit(origin, direction)

    def _spot(self, t_ns: int) -> Spot | None:
        T = self._motion.pose(t_ns / NS_PER_S)
        beam = self._beamed(T)
        if beam is None:
            return None
        point_scene = beam.origin_m + beam.length_m * beam.direction
        pupils = T.inverse().apply(np.stack([np.zeros(3), self.rig.T_left_right.t_m]))
        pixels: list[Pixel | None] = []
        for pupil, pixel in zip(pupils, self.rig.project(beam.point_left_m[None]), strict=True):
            faces = float((pupil - point_scene) @ beam.normal) > 0
            u, v = pixel[0]
            inside = 0 <= u <= self.rig.left.width - 1 and 0 <= v <= self.rig.left.height - 1
            pixels.append((float(u), float(v)) if faces and inside else None)
        return Spot(beam.on_target, beam.length_m, _vector(beam.point_left_m), pixels[0], pixels[1])

    def _read_laser(self, instant: Instant, rng: np.random.Generator) -> LaserRange | None:
        laser, part = self.rig.laser, self.scenario.laser
        assert laser is not None
        T = self._motion.pose(instant.t_ns / NS_PER_S)
        _, direction, hit = self._beam_hit(laser, T)
        beam = self._beamed(T)
        facing = 0.0 if beam is None else max(0.0, -float(beam.normal @ direction))
        reading = Rangefinder(laser, part, self._scene.optics.c[1]).read(hit, facing, rng)
        stamp_ns = instant.t_ns + round(part.clock_offset_s * NS_PER_S)
        truth = self.truth_at(instant.t_ns)
        detail = LaserTruth(instant.t_ns, stamp_ns, reading.kind, reading.length_m, truth.position_m, truth.range_m)
        self.details["laser"].append(asdict(detail))
        if reading.raw_m is None:
            return None
        return LaserRange(stamp_ns, reading.raw_m, reading.quality, instant.arrival_ns)

    def _sense_motion(self, instant: Instant, rng: np.random.Generator) -> VehicleMotion:
        part, (v, w) = self.scenario.vehicle, self._motion.twist(instant.t_ns / NS_PER_S)
        sigmas = part.velocity_sigma_m_s, part.rotation_sigma_rad_s
        velocity, rotation = (_vector(a + s * rng.standard_normal(3)) for a, s in zip((v, w), sigmas, strict=True))
        return VehicleMotion(instant.t_ns, velocity, rotation, *sigmas, instant.arrival_ns)


def _true_rig(scenario: Scenario, given: Rig | None) -> Rig:
    rig = given if given is not None else Rig.load(scenario.rig)
    rig = rig.scaled(scenario.camera.image_width_px / rig.left.width)
    if rig.laser is None:
        return rig
    part = scenario.laser
    laser = Beam(
        rig.laser.origin_m,
        rig.laser.direction,
        rig.laser.range_scale if part.scale is None else part.scale,
        rig.laser.range_offset_m if part.offset_m is None else part.offset_m,
        rig.laser.group_index,
        range_sigma_m=float(np.hypot(part.sigma_m, part.resolution_m / 12**0.5)),
    )
    return dataclasses.replace(rig, laser=laser)


def _words(seed: np.random.SeedSequence) -> tuple[int, ...]:
    return tuple(int(word) for word in seed.generate_state(4))


def _vector(values: Array) -> Vector:
    x, y, z = (float(v) for v in values)
    return x, y, z
