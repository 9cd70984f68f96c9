"""What a simulated dive is made of: a readable, validated description (YAML), and those that ship with the package."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from leadline.errors import InputError
from leadline.files import read_yaml
from leadline.simulation.faults import Fault
from leadline.simulation.optics import WATERS, WaterOptics

_SHIPPED = Path(__file__).parent / "scenarios"

Fraction = Annotated[float, Field(ge=0, le=1)]
Length = Annotated[float, Field(gt=0, le=1000)]
Duration = Annotated[float, Field(ge=0, le=60)]
Colour = tuple[Fraction, Fraction, Fraction]
Rate3 = tuple[Annotated[float, Field(ge=0, le=50)], Annotated[float, Field(ge=0, le=50)], Annotated[float, Field(ge=0)]]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class TargetPart(_Part):
    """What is approached. The scene's origin is its centre, for a plane a point on it."""

    shape: Literal["sphere", "plane", "cylinder", "lump"] = "sphere"
    diameter_m: Length = 0.34
    bumps: float = Field(default=0.12, ge=0, le=0.3, description="a lump's hills, as a fraction of its radius")
    tilt_deg: tuple[float, float] = Field(
        default=(0.0, 0.0), description="turn of a plane or an axis about x (down) and y"
    )
    colour: Colour = Field(default=(0.75, 0.24, 0.04), description="reflectance: red, green, blue")
    contrast: float = Field(default=0.8, ge=0, le=2, description="0 featureless, 1 a ball after a year in the sea")
    detail: float = Field(default=0.8, ge=0, le=2, description="the finest grain, seen at close range")


class WaterPart(_Part):
    """Coefficients by channel red, green, blue: see ``optics.WaterOptics``."""

    c: Rate3
    B: Colour
    k: Rate3
    forward: float = Field(ge=0, le=5)
    snow_per_m3: float = Field(ge=0, le=5000)

    def optics(self) -> WaterOptics:
        return WaterOptics(self.c, self.B, self.k, self.forward, self.snow_per_m3)


class BackdropPart(_Part):
    kind: Literal["pool", "floor", "open"] = "pool"
    wall_m: Length = Field(default=1.6, description="from the target's centre to the pool's wall behind it")
    floor_m: Length = Field(default=1.3, description="from the target's centre down to the floor")
    colour: Colour = (0.35, 0.60, 0.62)
    contrast: float = Field(default=0.9, ge=0, le=2)


class LightPart(_Part):
    ambient: float = Field(default=1.0, ge=0, le=10, description="daylight")
    lamps: float = Field(
        default=0.6, ge=0, le=10, description="two lamps beside the cameras: light at 1 m, against daylight"
    )
    caustics: Fraction = 0.25
    exposure: float = Field(
        default=0.28, gt=0, le=1, description="linear brightness to which the camera exposes the target"
    )


class PathPart(_Part):
    """The vehicle: an even approach on which it sways and turns a little."""

    start_m: Length = 5.0
    end_m: Length = 0.2
    speed_m_s: float = Field(default=0.25, gt=0, le=3)
    dwell_s: Duration = Field(default=1.0, description="stay at the end")
    offset_m: tuple[float, float] = Field(
        default=(-0.05, 0.03), description="the target beside the left camera's axis, at the end"
    )
    sway_m: tuple[float, float, float] = Field(default=(0.02, 0.015, 0.004), description="amplitude along x, y, z")
    sway_s: float = Field(default=6.0, gt=0, le=100, description="period of the slowest part")
    attitude_deg: float = Field(default=0.7, ge=0, le=20, description="amplitude of pitch, yaw and roll")

    @model_validator(mode="after")
    def _goes_nearer(self) -> PathPart:
        if self.end_m > self.start_m:
            raise ValueError("end_m must not exceed start_m")
        return self


class CameraPart(_Part):
    image_width_px: int = Field(default=640, ge=64, le=8192)
    rate_hz: float = Field(default=10.0, gt=0, le=120)
    exposure_s: float = Field(default=0.006, ge=0, le=0.2)
    latency_s: Duration = 0.08
    jitter_s: float = Field(default=0.01, ge=0, le=1, description="mean of the exponential part of the latency")
    skew_s: float = Field(default=0.0, ge=-0.1, le=0.1, description="the right exposure after the left one")
    skew_known: bool = Field(default=True, description="whether the frame carries both times")
    focus_m: Length = 0.8
    aperture_m: float = Field(default=0.0014, ge=0, le=0.05)
    shot_noise: float = Field(default=2.5e-4, ge=0, le=0.1)
    read_noise: float = Field(default=0.002, ge=0, le=0.2)
    vignetting: Fraction = 0.12


class LaserPart(_Part):
    rate_hz: float = Field(default=3.0, gt=0, le=1000)
    sigma_m: float = Field(default=0.003, ge=0, le=1)
    resolution_m: float = Field(default=0.001, gt=0, le=1)
    scale: float | None = Field(default=None, gt=0.5, lt=2, description="instead of the rig's")
    offset_m: float | None = Field(default=None, ge=-1, le=1, description="instead of the rig's")
    min_m: float = Field(default=0.05, ge=0)
    max_m: Length = 5.0
    latency_s: Duration = 0.03
    clock_offset_s: float = Field(default=0.0, ge=-10, le=10, description="the laser's stamps are late by this")
    dropouts: Fraction = 0.02
    outliers: Fraction = 0.0
    early_returns: float = Field(
        default=0.0, ge=0, le=5, description="rate of false returns from the water, 1/m at c = 1/m"
    )
    spot_diameter_m: float = Field(default=0.006, gt=0, le=0.1, description="where the light falls to 1/e^2")
    alternates: bool = Field(default=False, description="shines in every second frame only, from the first on")
    power: float = Field(default=20.0, ge=0, le=1000, description="light in the spot's middle, against daylight")


class VehiclePart(_Part):
    """What measures the vehicle's own motion (a DVL, a gyroscope); none at a rate of 0."""

    rate_hz: float = Field(default=0.0, ge=0, le=1000)
    velocity_sigma_m_s: float = Field(default=0.01, gt=0, le=1)
    rotation_sigma_rad_s: float = Field(default=0.002, gt=0, le=1)
    latency_s: Duration = 0.02


class Scenario(_Part):
    """A whole dive. ``rig`` is an example's name or a file; its images are resized to ``camera.image_width_px``."""

    name: str = "dive"
    description: str = ""
    rig: str = "paper"
    target: TargetPart = TargetPart()
    water: Literal["clear", "green", "turbid"] | WaterPart = "clear"
    backdrop: BackdropPart = BackdropPart()
    light: LightPart = LightPart()
    path: PathPart = PathPart()
    camera: CameraPart = CameraPart()
    laser: LaserPart = LaserPart()
    vehicle: VehiclePart = VehiclePart()
    snow_bursts_s: tuple[float, ...] = Field(default=(), description="times at which clouds of particles pass")
    faults: tuple[Fault, ...] = ()

    @property
    def optics(self) -> WaterOptics:
        return WATERS[self.water] if isinstance(self.water, str) else self.water.optics()

    @property
    def duration_s(self) -> float:
        return (self.path.start_m - self.path.end_m) / self.path.speed_m_s + self.path.dwell_s

    @classmethod
    def load(cls, source: str | Path) -> Scenario:
        """A shipped scenario by its name, or a YAML file. InputError names the key that is wrong."""
        path = Path(source)
        if str(source) in shipped_scenarios():
            path = _SHIPPED / f"{source}.yaml"
        elif not path.is_file():
            names = ", ".join(shipped_scenarios())
            raise InputError("no such scenario", str(source), f"use one of {names}, or a YAML file")
        content = read_yaml(path)
        try:
            return cls.model_validate({} if content is None else content)
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(str(part) for part in first["loc"]) or "the file"
            raise InputError(f"{key}: {first['msg']}", str(path), "compare a shipped scenario") from error


def shipped_scenarios() -> list[str]:
    """Names that ``Scenario.load`` takes in place of a path."""
    return sorted(path.stem for path in _SHIPPED.glob("*.yaml"))
