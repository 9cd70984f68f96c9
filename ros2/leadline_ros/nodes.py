"""Console scripts: each node as a process of its own, or the paper's three in one."""

import sys

from leadline.errors import InputError
from leadline.pipeline.ros2 import spin


def camera() -> int:
    return _main("camera")


def laser() -> int:
    return _main("laser")


def sensors() -> int:
    """Camera and laser from one source: a dive, or devices joined by ``+``."""
    return _main("sensors")


def localizer() -> int:
    return _main("localizer")


def together() -> int:
    return _main("camera", "laser", "localizer")


def _main(*names: str) -> int:
    try:
        spin(names, sys.argv[1:])
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0
