"""`calibrate convert`: rigs between this program's file and those of others."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from leadline.errors import InputError
from leadline.rig import Rig, shipped_rigs
from leadline.wire.rig_formats import read_foreign, write_camera_info, write_opencv


def convert(files: Sequence[Path], out: Path, to: str, size: str | None = None) -> list[Path]:
    """Read one or two files, write ``leadline``, ``opencv`` or ``ros``; the files written. InputError for bad ones."""
    rig = _read(files, size)
    if to == "ros":
        return write_camera_info(out, rig)
    if to == "opencv":
        write_opencv(out, rig)
    else:
        rig.save(out)
    return [out]


def _read(files: Sequence[Path], size: str | None) -> Rig:
    if len(files) > 2:
        raise InputError(f"{len(files)} files are too many", "", "give one file, or the left and the right camera's")
    path = files[0]
    ours = str(path) in shipped_rigs() or (
        path.is_file() and "format: leadline-rig" in path.read_text(errors="replace")
    )
    if ours:
        return Rig.load(path)
    if size is None:
        return read_foreign(files)
    match = re.fullmatch(r"(\d+)[xX](\d+)", size)
    if match is None:
        raise InputError(f"{size!r} is no size", "--size", "give WIDTHxHEIGHT, such as 1920x1080")
    return read_foreign(files, (int(match[1]), int(match[2])))
