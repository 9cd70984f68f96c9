"""One camera behind a port, as a file: what a calibration from one camera gives, in the rig file's own sections."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from leadline import rig_schema
from leadline.rig import Rig


def write_camera(path: Path, rig: Rig) -> None:
    """Write the left camera, the port, the index and their covariance. InputError where that cannot be done."""
    lens = rig.left
    data: dict[str, Any] = {
        "format": "leadline-camera",
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
    names = [name.replace("left.", "camera.") for name in rig.covariance.names]
    data["covariance"] = {"names": names, "matrix": rig.covariance.matrix.tolist()}
    data["provenance"] = dict(rig.provenance)
    rig_schema.write(path, data)
