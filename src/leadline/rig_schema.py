"""The rig file's schema, and reading and writing it whole. A fault is told by its path in the file.

Lengths are metres, pixels count from the centre of the top-left one, the frame is the left camera's optical frame
(x right, y down, z forward). See ``docs/conventions.md``.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from leadline.errors import InputError
from leadline.files import read_yaml, write_whole

HEADER = """\
# leadline rig file. Metres, pixels, degrees Celsius; frames: x right, y down, z forward; pixel (0, 0) is the centre of
# the top-left pixel; p_right = R p_left + t_m; raw reading = range_scale * group_index * length + range_offset_m.
"""

PARAMETER = re.compile(
    r"(left|right)\.(fx_px|fy_px|cx_px|cy_px|distortion\[\d+\])"
    r"|T_right_left\.(t_m|rotation_rad)\[[012]\]"
    r"|port\.(distance_m|normal\[[01]\]|layers\[\d+\]\.(thickness_m|index))"
    r"|water\.(index|group_index)"
    r"|laser\.((origin_m|direction)\[[012]\]|range_scale|range_offset_m)"
)
"""Names that a covariance may use. rotation_rad: a small turn put before R; normal[0], normal[1]: normal[2] follows."""


def _number(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError("must be a number")
    return value  # a string such as 1e-3, which YAML 1.1 does not take for a number, is left to pydantic


Number = Annotated[float, BeforeValidator(_number), Field(allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0)]
Length = Annotated[Number, Field(ge=0, le=2)]  # of a port: more is millimetres taken for metres
Index = Annotated[Number, Field(gt=1, lt=3)]
Size = Annotated[int, BeforeValidator(_number), Field(gt=0)]
Vector = tuple[Number, Number, Number]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class CameraSection(_Section):
    model: Literal["opencv"] = "opencv"
    fx_px: Positive
    fy_px: Positive
    cx_px: Number
    cy_px: Number
    distortion: tuple[Number, ...] = ()
    width_px: Size
    height_px: Size


class PoseSection(_Section):
    R: tuple[Vector, Vector, Vector]
    t_m: Vector


class LayerSection(_Section):
    thickness_m: Length
    index: Index


class PortSection(_Section):
    normal: Vector
    distance_m: Length
    layers: tuple[LayerSection, ...] = ()


class ChannelIndices(_Section):
    blue: Index
    green: Index
    red: Index

    @model_validator(mode="before")
    @classmethod
    def _one_for_all(cls, value: Any) -> Any:
        return value if isinstance(value, dict) else dict.fromkeys(("blue", "green", "red"), value)


class WaterSection(_Section):
    temperature_c: Number | None = None
    salinity: Number | None = None
    depth_m: Number | None = None
    index: ChannelIndices | None = None
    group_index: Index | None = None

    @model_validator(mode="after")
    def _known(self) -> WaterSection:
        if self.temperature_c is None and self.index is None:
            raise ValueError("give temperature_c (with salinity and depth_m) or the fitted index")
        if self.temperature_c is None and (self.salinity is not None or self.depth_m is not None):
            raise ValueError("salinity and depth_m need temperature_c")
        return self


class LaserSection(_Section):
    origin_m: Vector
    direction: Vector
    direction_medium: Literal["air", "water"] | None = None
    window_normal: Vector | None = None
    range_scale: Positive = 1.0
    range_offset_m: Number = 0.0
    range_sigma_m: Annotated[Number, Field(ge=0)] = 0.003
    wavelength_nm: Annotated[Number, Field(ge=400, le=700)] = 532.0


class FocalSection(_Section):
    fx: Positive
    fy: Positive


class PinholeSection(_Section):
    left: CameraSection
    right: CameraSection


class CovarianceSection(_Section):
    names: tuple[str, ...]
    matrix: tuple[tuple[Number, ...], ...]

    @model_validator(mode="after")
    def _sound(self) -> CovarianceSection:
        for i, name in enumerate(self.names):
            if not PARAMETER.fullmatch(name):
                raise ValueError(f"names[{i}]: {name!r} is not a parameter of a rig")
        if len(set(self.names)) < len(self.names):
            raise ValueError("names: one stands twice")
        count = len(self.names)
        if len(self.matrix) != count or any(len(row) != count for row in self.matrix):
            raise ValueError(f"matrix: must be {count}x{count}, as many as there are names")
        check_covariance(np.array(self.matrix, dtype=np.float64).reshape(count, count))
        return self


class RigFile(_Section):
    format: Literal["leadline-rig"]
    version: Literal[1]
    left: CameraSection
    right: CameraSection
    T_right_left: PoseSection
    port: PortSection | None = None
    water: WaterSection | None = None
    laser: LaserSection | None = None
    virtual_focal_px: FocalSection | None = None
    pinhole_water: PinholeSection | None = None
    T_body_left: PoseSection | None = None
    covariance: CovarianceSection | None = None
    provenance: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _fits_together(self) -> RigFile:
        baseline_m = float(np.linalg.norm(self.T_right_left.t_m))
        if not 0 < baseline_m < 10:
            raise ValueError(
                f"T_right_left.t_m: its length, the baseline, must be above 0 and below 10 m, not {baseline_m:g}"
            )
        if self.water is not None and self.port is None:
            raise ValueError("port: is missing, and a rig in water has one")
        if self.laser and self.water and self.water.temperature_c is None and self.water.group_index is None:
            raise ValueError("water.group_index: is missing, and the laser needs it where temperature_c is not given")
        return self


def check_covariance(matrix: np.ndarray[Any, np.dtype[np.float64]]) -> None:
    """ValueError unless symmetric and positive semidefinite, judged on the correlations: the units differ."""
    sigma = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    scale = np.outer(sigma, sigma)
    if (np.diag(matrix) < 0).any() or (matrix[scale == 0] != 0).any():
        raise ValueError("matrix: has a variance below 0, or a covariance without variances")
    correlation = np.divide(matrix, scale, out=np.zeros_like(matrix), where=scale > 0)
    if not np.allclose(correlation, correlation.T, atol=1e-9):
        raise ValueError("matrix: is not symmetric")
    if len(matrix) and np.linalg.eigvalsh(correlation)[0] < -1e-9:
        raise ValueError("matrix: is not positive semidefinite")


def read(path: Path) -> RigFile:
    """Parse and check a rig file; InputError names the first fault by its path in the file."""
    data = read_yaml(path)
    if not isinstance(data, dict) or data.get("format") != "leadline-rig":
        raise InputError("is not a rig file", str(path), "its first key must be `format: leadline-rig`")
    if data.get("version") != 1:
        raise InputError(f"version: {data.get('version')!r} is not known", str(path), "this program reads version 1")
    try:
        return RigFile.model_validate(data)
    except ValidationError as error:
        raise fault(path, _first_fault(error)) from error


def fault(path: Path, message: str) -> InputError:
    return InputError(message, str(path), "correct the rig file")


def _first_fault(error: ValidationError) -> str:
    first = error.errors()[0]
    where = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in first["loc"]).lstrip(".")
    what = first["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
    if where and re.match(r"[\w.\[\]]+: ", what):  # a section's own check has named the key inside it
        return f"{where}.{what}"
    match first["type"]:
        case "extra_forbidden":
            what = "this key is not known"
        case "missing":
            what = "is missing"
    return f"{where}: {what}" if where else what


def write(path: Path, data: dict[str, Any]) -> None:
    """Write a rig file whole or not at all. InputError where the folder cannot be written."""
    text = HEADER + yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True)
    write_whole(path, text)
