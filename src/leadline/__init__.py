"""Where is the target? Underwater ranging with a stereo camera behind a flat port and a laser rangefinder.

The public names are imported when they are first used: ``import leadline`` alone costs next to nothing.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from leadline import geometry, water
    from leadline.errors import InputError
    from leadline.localizer import Localizer
    from leadline.recognition.detector import Detector
    from leadline.rig import Rig
    from leadline.samples import LaserRange, Solution, StereoFrame, VehicleMotion
    from leadline.sources import open_source
    from leadline.target import Cylinder, Plane, Sphere, Surface

try:
    __version__ = version("leadline")
except PackageNotFoundError:  # run from a source tree that was never installed
    __version__ = "0"

_HOMES = {
    "Cylinder": "leadline.target",
    "Detector": "leadline.recognition.detector",
    "InputError": "leadline.errors",
    "LaserRange": "leadline.samples",
    "Localizer": "leadline.localizer",
    "Plane": "leadline.target",
    "Rig": "leadline.rig",
    "Solution": "leadline.samples",
    "Sphere": "leadline.target",
    "StereoFrame": "leadline.samples",
    "Surface": "leadline.target",
    "VehicleMotion": "leadline.samples",
    "open_source": "leadline.sources",
}
_ROOMS = ("geometry", "water")

__all__ = [
    "Cylinder",
    "Detector",
    "InputError",
    "LaserRange",
    "Localizer",
    "Plane",
    "Rig",
    "Solution",
    "Sphere",
    "StereoFrame",
    "Surface",
    "VehicleMotion",
    "__version__",
    "geometry",
    "open_source",
    "water",
]


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return import_module(f"leadline.{name}")
    if name in _HOMES:
        value = getattr(import_module(_HOMES[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'leadline' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
