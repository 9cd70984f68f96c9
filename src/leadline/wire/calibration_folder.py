"""A calibration folder: images of a board, of one camera or of two, paired by what their names share.

``left*`` with ``right*`` files, or folders ``left/`` and ``right/``, paired by the rest of the name, else by order; or
``stereo*`` files, side by side, left half = left camera; all else is one camera's. A dive folder goes by its table.
Images are read when their turn comes.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path

from leadline.errors import InputError
from leadline.samples import Image
from leadline.wire.dive_folder import read_frames, split_side_by_side
from leadline.wire.images import SizeError, decode_image
from leadline.wire.notice import Notice, NoticeKind

SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"}


@dataclass(frozen=True, slots=True)
class ImagePair:
    """The files of one moment; ``right`` is None for one camera, ``left`` itself where both are side by side in it.

    ``name`` is the left file's, seen from the folder.
    """

    name: str
    left: Path
    right: Path | None = None

    def load(self) -> tuple[Image, Image | None]:
        """The images. InputError where one cannot be read or halved."""
        if self.right != self.left:
            return read_image(self.left), None if self.right is None else read_image(self.right)
        try:
            return split_side_by_side(read_image(self.left))
        except SizeError as error:
            raise InputError(
                str(error), str(self.left), "left half = left camera, right half = right camera"
            ) from error


@dataclass(frozen=True, slots=True)
class CalibrationFolder:
    """The pairs of a folder in order of their names, and what was strange about it."""

    path: Path
    pairs: tuple[ImagePair, ...]
    notices: tuple[Notice, ...] = ()

    @property
    def mono(self) -> bool:
        return all(pair.right is None for pair in self.pairs)

    def digest(self) -> str:
        """SHA-256 over the names and contents of all images, in order."""
        total = hashlib.sha256()
        for path in self.files():
            total.update(path.name.encode())
            total.update(path.read_bytes())
        return total.hexdigest()

    def files(self) -> list[Path]:
        return list(dict.fromkeys(path for pair in self.pairs for path in (pair.left, pair.right) if path is not None))


def read_calibration_folder(folder: Path) -> CalibrationFolder:
    """InputError where the folder is not there, has no images, or only one camera's of a pair."""
    if not folder.is_dir():
        raise InputError("there is no such folder", str(folder), "give a folder with images of the board")
    if (folder / "frames.csv").is_file():
        return _dive(folder)
    left, right = _sides(folder)
    if not left and not right:
        single = _images(folder)
        if not single:
            raise InputError("has no images", str(folder), f"give {', '.join(sorted(SUFFIXES))} files of the board")
        both = all(path.stem.lower().startswith("stereo") for path in single)
        return CalibrationFolder(folder, tuple(ImagePair(p.name, p, p if both else None) for p in single))
    if not left or not right:
        missing = "left" if right else "right"
        raise InputError(f"has no {missing} images", str(folder), "name them left* and right*, or use two folders")
    return _paired(folder, left, right)


def _dive(folder: Path) -> CalibrationFolder:
    notices: list[Notice] = []
    entries = read_frames(folder, notices.append)
    pairs = tuple(ImagePair(entry.name, entry.files[0], entry.files[-1]) for entry in entries)
    return CalibrationFolder(folder, pairs, tuple(notices))


def read_image(path: Path) -> Image:
    """The pixels of an image file. InputError where it cannot be read."""
    try:
        return decode_image(path.read_bytes())
    except (OSError, ValueError) as error:
        raise InputError(str(error), str(path), "take it out of the folder or replace it") from error


def _sides(folder: Path) -> tuple[dict[str, Path], dict[str, Path]]:
    """Files of both cameras by the rest of their names."""
    inside = {side: folder / side for side in ("left", "right")}
    if all(path.is_dir() for path in inside.values()):
        left, right = ({path.stem: path for path in _images(inside[side])} for side in ("left", "right"))
        return _without_side(left), _without_side(right)
    found: dict[str, dict[str, Path]] = {"left": {}, "right": {}}
    for path in _images(folder):
        match = re.match(r"(left|right)(.*)", path.stem, flags=re.IGNORECASE)
        if match:
            found[match[1].lower()][match[2]] = path
    return found["left"], found["right"]


def _without_side(files: dict[str, Path]) -> dict[str, Path]:
    """``left_01`` in the folder ``left`` goes with ``right_01``, or with plain ``01``."""
    return {re.sub(r"^(left|right)[ _-]?", "", stem, flags=re.IGNORECASE): path for stem, path in files.items()}


def _images(folder: Path) -> list[Path]:
    files = [p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and p.is_file() and not p.name.startswith(".")]
    return sorted(files, key=lambda path: _natural(path.name))


def _natural(name: str) -> list[tuple[int, str]]:
    """bc2 before bc10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name) if part]


def _paired(folder: Path, left: dict[str, Path], right: dict[str, Path]) -> CalibrationFolder:
    def name(path: Path) -> str:
        return str(path.relative_to(folder))

    shared = [key for key in left if key in right]
    if not shared:
        if len(left) != len(right):
            what = f"{len(left)} left and {len(right)} right images have no names in common"
            raise InputError(what, str(folder), "name the images of a pair alike, such as left01 and right01")
        couples = list(zip(left.values(), right.values(), strict=True))
        notice = Notice(NoticeKind.IGNORED, str(folder), "left and right names differ: paired by their order")
        return CalibrationFolder(folder, tuple(ImagePair(name(a), a, b) for a, b in couples), (notice,))
    alone = [path for key, path in left.items() if key not in right]
    alone += [path for key, path in right.items() if key not in left]
    notices = tuple(Notice(NoticeKind.SKIPPED, name(path), "has no partner of the other camera") for path in alone)
    return CalibrationFolder(folder, tuple(ImagePair(name(left[k]), left[k], right[k]) for k in shared), notices)
