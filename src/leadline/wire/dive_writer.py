"""Write samples as a dive folder (the counterpart of ``dive_folder``)."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from leadline.errors import InputError
from leadline.files import make_folder
from leadline.samples import Image, LaserRange, Sample, StereoFrame, Truth, VehicleMotion
from leadline.wire.dive_folder import MOTION_SIGMAS, ROTATION, VELOCITY
from leadline.wire.images import SUFFIX, encode_jpeg, encode_png, image_format
from leadline.wire.stamps import format_stamp
from leadline.wire.table import write_table
from leadline.wire.truth import write_truth

if TYPE_CHECKING:
    from leadline.rig import Rig

_FRAME_TIMES = ("t_arrival_s", "t_left_s", "t_right_s")


def write_dive(
    folder: Path | str,
    samples: Iterable[Sample],
    *,
    rig: Rig | None = None,
    truth: Sequence[Truth] = (),
    details: Mapping[str, Any] | None = None,
    images: Literal["png", "jpeg"] = "png",
) -> None:
    """Write ``samples`` (in any order) to a new or empty folder, then ``truth`` and ``details``.

    A frame's own compressed bytes are written as they are; other images as lossless PNG, so that the folder gives the
    same solutions as ``samples``, or as smaller JPEG. ``details`` goes to ``truth.json``. Optional columns appear where
    a sample has such a value. Raises InputError where the folder holds something.
    """
    folder = new_folder(Path(folder))
    frames: list[list[str]] = []
    readings: list[list[str]] = []
    motions: list[list[str]] = []
    for sample in samples:
        if isinstance(sample, LaserRange):
            quality = "" if sample.quality is None else repr(float(sample.quality))
            times = [format_stamp(sample.t_ns), repr(float(sample.range_m)), _stamp(sample.arrival_ns)]
            readings.append([*times, quality])
        elif isinstance(sample, VehicleMotion):
            motions.append(_motion_cells(sample))
        else:
            names = _write_images(folder, len(frames), sample, images)
            times = [_stamp(t_ns) for t_ns in (sample.arrival_ns, sample.left_t_ns, sample.right_t_ns)]
            switch = "" if sample.laser_on is None else str(int(sample.laser_on))
            frames.append([format_stamp(sample.t_ns), *names, *times, switch])
    header = ("t_s", "left", "right", *_FRAME_TIMES, "laser_on")
    _write_full_columns(folder / "frames.csv", header, frames, required=3)
    if readings:
        _write_full_columns(folder / "laser.csv", ("t_s", "range_m", "t_arrival_s", "quality"), readings, required=2)
    if motions:
        columns = ("t_s", *VELOCITY, *ROTATION, *MOTION_SIGMAS, "t_arrival_s")
        _write_full_columns(folder / "motion.csv", columns, motions, required=1)
    if truth:
        write_truth(folder / "truth.csv", truth)
    if details:
        (folder / "truth.json").write_text(json.dumps(details, indent=1) + "\n", encoding="utf-8")
    if rig is not None:
        rig.save(folder / "rig.yaml")


def new_folder(folder: Path) -> Path:
    """Make the folder; InputError if it holds something already."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError("there is something already", str(folder), "give a new or an empty folder")
    return make_folder(folder)


def _motion_cells(motion: VehicleMotion) -> list[str]:
    vectors = [
        [""] * 3 if v is None else [repr(float(x)) for x in v] for v in (motion.velocity_m_s, motion.rotation_rad_s)
    ]
    sigmas = [repr(float(sigma)) for sigma in (motion.velocity_sigma_m_s, motion.rotation_sigma_rad_s)]
    return [format_stamp(motion.t_ns), *vectors[0], *vectors[1], *sigmas, _stamp(motion.arrival_ns)]


def _stamp(t_ns: int | None) -> str:
    return "" if t_ns is None else format_stamp(t_ns)


def _write_images(folder: Path, index: int, frame: StereoFrame, images: Literal["png", "jpeg"]) -> tuple[str, str]:
    """Write both images; return their names. The left one keeps the frame's name, the key of its boxes."""
    contents = frame.encoded or (_encode(frame.left, images), _encode(frame.right, images))
    left_suffix, right_suffix = (SUFFIX.get(image_format(data), ".img") for data in contents)
    stem = _stem(frame.name)
    if not stem or (folder / (stem + left_suffix)).exists():
        stem = f"left_{index:04d}"
    left, right = stem + left_suffix, _right_of(stem) + right_suffix
    for name, data in ((left, contents[0]), (right, contents[1])):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return left, right


def _stem(name: str) -> str:
    """The name without its suffix; "" for a name that would lead out of the folder (a recording can say anything)."""
    path = Path(name)
    return "" if path.is_absolute() or ".." in path.parts or not path.name else path.with_suffix("").as_posix()


def _right_of(stem: str) -> str:
    if "left" in stem:
        return stem.replace("left", "right")
    path = Path(stem)
    return (path.parent / f"right_{path.name}").as_posix()


def _encode(image: Image, images: Literal["png", "jpeg"]) -> bytes:
    return encode_png(image) if images == "png" else encode_jpeg(image)


def _write_full_columns(path: Path, header: Sequence[str], rows: list[list[str]], required: int) -> None:
    """Leave out the optional columns in which no row has a value."""
    kept = [i for i in range(len(header)) if i < required or any(row[i] for row in rows)]
    write_table(path, [header[i] for i in kept], ([row[i] for i in kept] for row in rows))
