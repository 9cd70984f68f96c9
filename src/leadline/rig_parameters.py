"""A rig's parameters as a vector, by the names that they have in the rig file's covariance.

What a covariance is used for: read the numbers, put others in their place, see what changes.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from leadline.geometry import Camera, Pose
from leadline.rig import Rig
from leadline.samples import Array

_CAMERA_KEYS = {"fx_px": "fx", "fy_px": "fy", "cx_px": "cx", "cy_px": "cy"}
_DISTORTION_COUNTS = (4, 5, 8, 12)


def get(rig: Rig, names: Sequence[str]) -> Array:
    """The parameters' values (k,). ``rotation_rad`` is a turn put before R, so it reads 0. ValueError for a name that
    the rig does not have."""
    return np.array([_value(rig, *_split(name)) for name in names], dtype=np.float64)


def replaced(rig: Rig, names: Sequence[str], values: ArrayLike) -> Rig:
    """The same rig with these values (k,) in place. Directions stay unit vectors; covariance and pinholes are kept.

    ValueError for a name that the rig does not have, or a value that its part does not take.
    """
    by_part: dict[str, dict[tuple[str, int], float]] = {}
    for name, value in zip(names, np.asarray(values, dtype=np.float64), strict=True):
        part, key, index = _split(name)
        _value(rig, part, key, index)
        by_part.setdefault(part, {})[key, index] = float(value)
    changes: dict[str, Any] = {part: _PARTS[part](rig, given) for part, given in by_part.items() if part != "water"}
    return _with_water(dataclasses.replace(rig, **changes), by_part.get("water", {}))


def turn(rotation_rad: ArrayLike) -> Array:
    """Rotation matrix (3, 3) of a rotation vector (3,), radians (Rodrigues)."""
    w = np.asarray(rotation_rad, dtype=np.float64)
    angle = float(np.linalg.norm(w))
    W = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    sine, versine = (1.0, 0.5) if angle < 1e-8 else (np.sin(angle) / angle, (1 - np.cos(angle)) / angle**2)
    R: Array = np.eye(3) + sine * W + versine * (W @ W)
    return R


def _split(name: str) -> tuple[str, str, int]:
    """part, key, index (0 where the name has none): ``port.layers[0].index`` -> port, layers.index, 0."""
    part, _, rest = name.partition(".")
    index = re.search(r"\[(\d+)\]", rest)
    return part, re.sub(r"\[\d+\]", "", rest), int(index[1]) if index else 0


def _value(rig: Rig, part: str, key: str, i: int) -> float:
    try:
        section: Any = _section(rig, part)
        match part, key:
            case (("left" | "right"), "distortion"):
                value = section.distortion[i] if i < len(section.distortion) else 0.0
            case (("left" | "right"), _):
                value = getattr(section, _CAMERA_KEYS[key])
            case "T_right_left", "rotation_rad":
                value = 0.0
            case "port", ("layers.thickness_m" | "layers.index"):
                value = section.layers[i][key == "layers.index"]
            case _:
                value = np.atleast_1d(getattr(section, key))[i]
        return float(value)
    except (KeyError, IndexError, AttributeError):
        raise ValueError(f"{part}.{key}: the rig has no such parameter") from None


def _section(rig: Rig, part: str) -> Any:
    """The object that holds a part's numbers, None where the rig has none; KeyError for a part that no rig has."""
    if part == "water":  # what the geometry uses
        indices = {} if rig.port is None else {"index": rig.port.outside_index}
        return SimpleNamespace(**indices, **({} if rig.laser is None else {"group_index": rig.laser.group_index}))
    return {
        "left": rig.left,
        "right": rig.right,
        "T_right_left": rig.T_right_left,
        "port": rig.port,
        "laser": rig.laser,
    }[part]


_Given = dict[tuple[str, int], float]


def _camera(side: str) -> Callable[[Rig, _Given], Camera]:
    def change(rig: Rig, given: _Given) -> Camera:
        camera: Camera = getattr(rig, side)
        k = {i: value for (key, i), value in given.items() if key == "distortion"}
        count = max(len(camera.distortion), max(k, default=-1) + 1)
        count = next((c for c in _DISTORTION_COUNTS if c >= count), count) if count else 0
        old = camera.distortion + (0.0,) * (count - len(camera.distortion))
        plain: Any = {_CAMERA_KEYS[key]: value for (key, _), value in given.items() if key != "distortion"}
        return dataclasses.replace(camera, **plain, distortion=tuple(k.get(i, old[i]) for i in range(count)))

    return change


def _vector(old: Array, key: str, given: _Given) -> Array:
    return np.array([given.get((key, i), old[i]) for i in range(3)])


def _pose(rig: Rig, given: _Given) -> Pose:
    pose = rig.T_right_left
    return Pose(turn(_vector(np.zeros(3), "rotation_rad", given)) @ pose.R, _vector(pose.t_m, "t_m", given))


def _port(rig: Rig, given: _Given) -> Any:
    port = rig.port
    if port is None:
        raise ValueError("port: the rig has none")
    across = _vector(port.normal, "normal", given)[:2]
    length2 = float(across @ across)
    if length2 >= 1:
        raise ValueError("port.normal: must be a unit vector")
    layers = tuple(
        (given.get(("layers.thickness_m", i), t), given.get(("layers.index", i), m))
        for i, (t, m) in enumerate(port.layers)
    )
    distance_m = given.get(("distance_m", 0), port.distance_m)
    return dataclasses.replace(
        port, normal=np.array([*across, np.sqrt(1 - length2)]), distance_m=distance_m, layers=layers
    )


def _laser(rig: Rig, given: _Given) -> Any:
    beam = rig.laser
    if beam is None:
        raise ValueError("laser: the rig has none")
    direction = _vector(beam.direction, "direction", given)
    plain: Any = {key: value for (key, _), value in given.items() if key in ("range_scale", "range_offset_m")}
    direction = direction / np.linalg.norm(direction)
    return dataclasses.replace(beam, origin_m=_vector(beam.origin_m, "origin_m", given), direction=direction, **plain)


def _with_water(rig: Rig, given: _Given) -> Rig:
    """The colours' indices move together with the one that the geometry uses."""
    if not given:
        return rig
    changes: dict[str, Any] = {}
    shift, group = 0.0, given.get(("group_index", 0))
    if ("index", 0) in given and rig.port is not None:
        shift = given["index", 0] - rig.port.outside_index
        changes["port"] = dataclasses.replace(rig.port, outside_index=given["index", 0])
    if group is not None and rig.laser is not None:
        changes["laser"] = dataclasses.replace(rig.laser, group_index=group)
    if rig.water is not None:
        w = rig.water
        kept = w.group_index if group is None else group
        colours: Any = {"blue": w.blue + shift, "green": w.green + shift, "red": w.red + shift}
        changes["water"] = dataclasses.replace(w, **colours, group_index=kept)
    return dataclasses.replace(rig, **changes)


_PARTS: dict[str, Callable[[Rig, _Given], Any]] = {
    "left": _camera("left"),
    "right": _camera("right"),
    "T_right_left": _pose,
    "port": _port,
    "laser": _laser,
    "water": lambda rig, _: rig.water,
}
