"""Between the rig file's sections and the objects of a rig; both ways, so that a saved rig reads back the same."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from leadline import rig_schema
from leadline.geometry import Beam, Camera, LayeredPort, Pose, refract_direction
from leadline.rig_covariance import RigCovariance
from leadline.rig_schema import CameraSection, LaserSection, PortSection, PoseSection, RigFile, WaterSection
from leadline.water import Water, WaterState

if TYPE_CHECKING:
    from leadline.rig import Rig


def read(path: Path) -> dict[str, Any]:
    """The arguments of ``Rig`` from a file; InputError names the first fault by its path in the file."""
    file = rig_schema.read(path)
    try:
        return _parts(file)
    except ValueError as error:
        raise rig_schema.fault(path, str(error)) from error


def write(path: Path, rig: Rig) -> None:
    """Write the rig file whole or not at all; InputError where that cannot be done."""
    rig_schema.write(path, _data(rig))


@contextmanager
def _section(name: str) -> Iterator[None]:
    """Put the section's name before the argument that a geometry class complains of."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{name}.{error}") from error


def _parts(file: RigFile) -> dict[str, Any]:
    water = None if file.water is None else _water(file.water, file.laser.wavelength_nm if file.laser else 532.0)
    T_right_left = _pose(file.T_right_left, "T_right_left")
    port = None if file.port is None else _port(file.port, water)
    if port is not None:
        with _section("port (seen from the right camera)"):
            port.seen_from(T_right_left)
    covariance = file.covariance
    return {
        "left": _camera(file.left, "left"),
        "right": _camera(file.right, "right"),
        "T_right_left": T_right_left,
        "port": port,
        "water": water,
        "laser": None if file.laser is None else _beam(file.laser, water),
        "laser_wavelength_nm": file.laser.wavelength_nm if file.laser else 532.0,
        "pinhole_water": file.pinhole_water
        and (
            _camera(file.pinhole_water.left, "pinhole_water.left"),
            _camera(file.pinhole_water.right, "pinhole_water.right"),
        ),
        "virtual_focal_px": file.virtual_focal_px and (file.virtual_focal_px.fx, file.virtual_focal_px.fy),
        "T_body_left": _pose(file.T_body_left, "T_body_left") if file.T_body_left else Pose.identity(),
        "covariance": RigCovariance(covariance.names, np.array(covariance.matrix)) if covariance else RigCovariance(),
        "provenance": dict(file.provenance),
    }


def _camera(section: CameraSection, name: str) -> Camera:
    s = section
    with _section(name):
        return Camera(s.fx_px, s.fy_px, s.cx_px, s.cy_px, s.width_px, s.height_px, s.distortion)


def _pose(section: PoseSection, name: str) -> Pose:
    with _section(name):
        return Pose(section.R, section.t_m)


def _port(section: PortSection, water: Water | None) -> LayeredPort:
    layers = tuple((layer.thickness_m, layer.index) for layer in section.layers)
    with _section("port"):
        if section.normal[2] <= 0:
            raise ValueError("normal: must point away from the cameras, towards the water (its third number above 0)")
        return LayeredPort(section.normal, section.distance_m, layers, 1.0 if water is None else water.index)


def _water(section: WaterSection, laser_nm: float) -> Water:
    computed = None
    if section.temperature_c is not None:
        with _section("water"):
            state = WaterState(section.temperature_c, section.salinity or 0.0, section.depth_m or 0.0)
            computed = Water.from_state(state, laser_nm)
    fitted = section.index
    if fitted is None and section.group_index is None and computed is not None:
        return computed
    group = section.group_index or (computed.group_index if computed else float("nan"))
    state_or_none = computed.state if computed else None
    if fitted is None:
        if computed is None:
            raise ValueError("water.index: is missing")
        return Water(computed.blue, computed.green, computed.red, group, state_or_none)
    return Water(fitted.blue, fitted.green, fitted.red, group, state_or_none)


def _beam(section: LaserSection, water: Water | None) -> Beam:
    """A direction measured in air bends at the device's window; without a window_normal the beam is square to it."""
    direction: Any = section.direction
    with _section("laser"):
        if water is not None and section.direction_medium == "air" and section.window_normal is not None:
            with _section("window_normal: with the"):
                direction = refract_direction(direction, section.window_normal, 1.0, water.index)
        group = 1.0 if water is None else water.group_index
        scale, offset, sigma = section.range_scale, section.range_offset_m, section.range_sigma_m
        return Beam(section.origin_m, direction, scale, offset, group, range_sigma_m=sigma)


def _data(rig: Rig) -> dict[str, Any]:
    data: dict[str, Any] = {
        "format": "leadline-rig",
        "version": 1,
        "left": _camera_data(rig.left),
        "right": _camera_data(rig.right),
        "T_right_left": _pose_data(rig.T_right_left),
    }
    if rig.port is not None:
        layers = [{"thickness_m": thickness, "index": index} for thickness, index in rig.port.layers]
        data["port"] = {"normal": rig.port.normal.tolist(), "distance_m": rig.port.distance_m, "layers": layers}
    if rig.water is not None:
        data["water"] = _water_data(rig.water, rig.laser_wavelength_nm)
    if rig.laser is not None:
        data["laser"] = _laser_data(rig)
    if rig.virtual_focal_px is not None:
        data["virtual_focal_px"] = dict(zip(("fx", "fy"), rig.virtual_focal_px, strict=True))
    if rig.pinhole_water is not None:
        data["pinhole_water"] = dict(zip(("left", "right"), map(_camera_data, rig.pinhole_water), strict=True))
    data["T_body_left"] = _pose_data(rig.T_body_left)
    if rig.covariance.names:
        data["covariance"] = {"names": list(rig.covariance.names), "matrix": rig.covariance.matrix.tolist()}
    if rig.provenance:
        data["provenance"] = dict(rig.provenance)
    return data


def _camera_data(camera: Camera) -> dict[str, Any]:
    intrinsics = {"fx_px": camera.fx, "fy_px": camera.fy, "cx_px": camera.cx, "cy_px": camera.cy}
    size = {"width_px": camera.width, "height_px": camera.height}
    return {
        "model": "opencv",
        **{name: float(value) for name, value in intrinsics.items()},
        "distortion": list(camera.distortion),
        **size,
    }


def _pose_data(pose: Pose) -> dict[str, Any]:
    return {"R": pose.R.tolist(), "t_m": pose.t_m.tolist()}


def _water_data(water: Water, laser_nm: float) -> dict[str, Any]:
    data: dict[str, Any] = {}
    if water.state is not None:
        state = water.state
        data = {"temperature_c": state.temperature_c, "salinity": state.salinity, "depth_m": state.depth_m}
        if water == Water.from_state(state, laser_nm):
            return data
    data["index"] = {"blue": water.blue, "green": water.green, "red": water.red}
    if not np.isnan(water.group_index):
        data["group_index"] = water.group_index
    return data


def _laser_data(rig: Rig) -> dict[str, Any]:
    beam = rig.laser
    if beam is None:
        return {}
    return {
        "origin_m": beam.origin_m.tolist(),
        "direction": beam.direction.tolist(),
        "direction_medium": "air" if rig.water is None else "water",
        "range_scale": beam.range_scale,
        "range_offset_m": beam.range_offset_m,
        "range_sigma_m": beam.range_sigma_m,
        "wavelength_nm": rig.laser_wavelength_nm,
    }
