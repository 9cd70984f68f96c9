"""One camera behind a port, as a file: what a calibration from one camera gives, in the rig file's own sections."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import ValidationError

from leadline import rig_schema
from leadline.errors import InputError
from leadline.geometry import Camera, Pose
from leadline.rig import Rig
from leadline.rig_covariance import RigCovariance

FORMAT = "leadline-camera"


def write_camera(path: Path, rig: Rig) -> None:
    """Write the left camera, the port, the index and their covariance. InputError where that cannot be done."""
    lens = rig.left
    data: dict[str, Any] = {
        "format": FORMAT,
        "version": 1,
        "camera": {
            "model": "opencv",
            "fx_px": lens.fx,
            "fy_px": lens.fy,
            "cx_px": lens.cx,
            "cy_px": lens.cy,
            "distortion": list(lens.distortion),
            "width_px": lens.width,
            "height_px": lens.height,
        },
    }
    if rig.port is not None:
        layers = [{"thickness_m": t, "index": m} for t, m in rig.port.layers]
        data["port"] = {"normal": rig.port.normal.tolist(), "distance_m": rig.port.distance_m, "layers": layers}
        data["water"] = {"index": rig.port.outside_index}
    if rig.laser is not None:
        data["laser"] = {
            "origin_m": rig.laser.origin_m.tolist(),
            "direction": rig.laser.direction.tolist(),
            "direction_medium": "air" if rig.water is None else "water",
            "range_scale": rig.laser.range_scale,
            "range_offset_m": rig.laser.range_offset_m,
            "range_sigma_m": rig.laser.range_sigma_m,
        }
    names = [name.replace("left.", "camera.") for name in rig.covariance.names]
    data["covariance"] = {"names": names, "matrix": rig.covariance.matrix.tolist()}
    data["provenance"] = dict(rig.provenance)
    rig_schema.write(path, data)


def is_camera_file(path: Path) -> bool:
    try:
        return f"format: {FORMAT}" in path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return False


def read_camera(path: Path) -> Rig:
    """The camera as the left one of a rig in air whose right camera is a copy at the same place (its port is not read).

    InputError where the file is no good.
    """
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    try:
        section = rig_schema.CameraSection.model_validate(data["camera"])
        cov = rig_schema.CovarianceSection.model_validate(_named_left(data.get("covariance")))
    except (KeyError, TypeError, ValidationError) as error:
        raise InputError("is not a camera file", str(path), "write it with `leadline calibrate cameras`") from error
    s = section
    lens = Camera(s.fx_px, s.fy_px, s.cx_px, s.cy_px, s.width_px, s.height_px, s.distortion)
    kept = tuple(name for name in cov.names if name.startswith("left."))
    matrix = RigCovariance(cov.names, np.array(cov.matrix)).of(kept)
    provenance = dict(data.get("provenance") or {})
    return Rig(lens, lens, Pose.identity(), covariance=RigCovariance(kept, matrix), provenance=provenance)


def _named_left(covariance: Any) -> dict[str, Any]:
    covariance = covariance or {"names": [], "matrix": []}
    return {**covariance, "names": [name.replace("camera.", "left.") for name in covariance["names"]]}
