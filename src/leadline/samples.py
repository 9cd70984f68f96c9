"""What flows: sensor samples, detections, measurements and solutions.

Everything here is a frozen, slotted value. Time is an integer count of nanoseconds (``t_ns``), so that a stamp goes
through a recording and back unchanged; ``t_s`` is derived from it. World = the left camera's optical frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

NS_PER_S = 1_000_000_000
LARGEST_BOX = 1.2  # of the picture's width or height


@dataclass(frozen=True, slots=True)
class StereoFrame:
    """One exposure of both cameras.

    ``t_ns`` is the middle of the exposure, ``arrival_ns`` when the frame reached us (None: at ``t_ns``). ``left_t_ns``
    and ``right_t_ns`` are set where the two exposures are known to differ; what is measured is then measured at
    ``left_t_ns``, while ``t_ns`` names the frame and its solution. Images: (H, W, 3) uint8 BGR or (H, W) uint8.
    ``encoded`` holds the source's own compressed bytes (left, right), so that a recording is bit for bit the source.
    ``laser_on``: whether the laser shone (a pulsed one, switched from frame to frame); None: nobody says.
    """

    t_ns: int
    left: Image
    right: Image
    arrival_ns: int | None = None
    left_t_ns: int | None = None
    right_t_ns: int | None = None
    name: str = ""  # the left image's file name, the key of `--boxes`
    encoded: tuple[bytes, bytes] | None = None
    laser_on: bool | None = None

    @property
    def t_s(self) -> float:
        return self.t_ns / NS_PER_S


@dataclass(frozen=True, slots=True)
class LaserRange:
    """One raw reading of the rangefinder, before any correction (metres as the device says)."""

    t_ns: int
    range_m: float
    quality: float | None = None
    arrival_ns: int | None = None

    @property
    def t_s(self) -> float:
        return self.t_ns / NS_PER_S


@dataclass(frozen=True, slots=True)
class VehicleMotion:
    """How the vehicle moves (a DVL, a gyroscope), in the LEFT CAMERA's frame; None: not measured.

    velocity_m_s: of the camera over ground (x, y, z). rotation_rad_s: the camera's (x, y, z), right-handed. A point p
    that stands still thus moves by -velocity - rotation x p. The sigmas are of each component.
    """

    t_ns: int
    velocity_m_s: tuple[float, float, float] | None = None
    rotation_rad_s: tuple[float, float, float] | None = None
    velocity_sigma_m_s: float = 0.02
    rotation_sigma_rad_s: float = 0.005
    arrival_ns: int | None = None

    @property
    def t_s(self) -> float:
        return self.t_ns / NS_PER_S

    @property
    def is_finite(self) -> bool:
        return bool(np.isfinite([*(self.velocity_m_s or ()), *(self.rotation_rad_s or ())]).all())


Sample = StereoFrame | LaserRange | VehicleMotion


@dataclass(frozen=True, slots=True)
class Detection:
    """A box around a target in one image: ``box_px`` = x, y, width, height (left, top of the box; COCO)."""

    box_px: tuple[float, float, float, float]
    score: float
    label: str = "target"

    def is_in(self, columns: int, rows: int) -> bool:
        """Whether it can be of a picture so large: it lies in it, at least in part, and is hardly larger; not NaN."""
        x, y, width, height = self.box_px
        large = 0 < width <= LARGEST_BOX * columns and 0 < height <= LARGEST_BOX * rows
        return bool(large and -width < x < columns and -height < y < rows)


@dataclass(frozen=True, slots=True)
class Truth:
    """What really was, where it is known (simulation, measured stations). See the dive folder's ``truth.csv``."""

    t_ns: int
    position_m: tuple[float, float, float]
    range_m: float


class Kind(StrEnum):
    """Where a measurement came from; the names of ``used`` and ``rejected`` in ``solutions.csv``."""

    STEREO = "stereo"
    SPOT = "spot"
    LASER = "laser"
    SIZE = "size"
    HELD = "held"  # none of a sensor: an unseen target has not gone far sideways; never told as used


@dataclass(frozen=True, slots=True)
class Measurement:
    """A measurement of the target's state: z = h(x) + noise.

    ``predict`` takes the target's vector x = (position (3,), shape (k,)) and gives h(x) (m,) and its Jacobian
    (m, 3 + k), or None where x cannot give this measurement at all (the beam misses the target). ``common`` (m,): that
    part of ``cov`` which all measurements of an outline share, one sigma of it (all edges are found a little inside).
    ``cameras``: those whose picture it hangs on; a spot or an outline that both show alike hangs on neither.
    """

    kind: Kind
    t_ns: int
    z: Array
    cov: Array
    predict: Callable[[Array], tuple[Array, Array] | None]
    common: Array | None = None
    cameras: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Rejected:
    """A measurement that was turned away, and why; ``nis``: its normalised innovation squared, if one was formed.

    ``camera``: whose picture it is, where the other's was taken.
    """

    kind: Kind
    t_ns: int
    reason: str
    nis: float | None = None
    camera: str = ""


class Stage(IntEnum):
    SEARCHING = 0
    BINOCULAR = 1
    BOTH = 2
    LASER = 3


class Status(StrEnum):
    VALID = "valid"
    COASTING = "coasting"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class Solution:
    """Where the target is at ``t_ns``. Arrays are None only when ``status`` is lost; the velocity also where the method
    has none: the paper's, and every frame alone."""

    t_ns: int
    stage: Stage
    status: Status
    position_m: Array | None = None  # (3,)
    cov_m2: Array | None = None  # (3, 3)
    range_m: float | None = None
    range_sigma_m: float | None = None
    velocity_m_s: Array | None = None  # (3,)
    used: tuple[Kind, ...] = ()
    rejected: tuple[Rejected, ...] = field(default=())

    @property
    def t_s(self) -> float:
        return self.t_ns / NS_PER_S
