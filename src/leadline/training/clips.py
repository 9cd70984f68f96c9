"""Which images are from one and the same recording, and a split that keeps recordings whole.

Neighbouring frames of a clip are all but the same picture: tested on one whose neighbour was trained on, a detector
looks far better than it is.
"""

from __future__ import annotations

import csv
import re
from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from leadline.errors import InputError

GAP = 10  # a jump in the numbering of more than so many usual steps begins another clip
COLUMNS = "give a CSV file with the columns image,clip"
PARTS = ("train", "val", "test")


def clip_names(images: Sequence[Path], root: Path) -> list[str]:
    """A clip's name for each image: its folder and its name without the last number, cut where the numbering jumps.

    ``dive3/left_0007.png`` -> ``dive3/left_``; where the numbers jump, ``dive3/left_7-90`` and ``dive3/left_812-900``.
    A name without a number is a clip of its own.
    """
    series: dict[str, list[tuple[int, int]]] = defaultdict(list)  # name without number -> (number, which image)
    names = [""] * len(images)
    for k, image in enumerate(images):
        folder = image.parent.relative_to(root).as_posix() if image.is_relative_to(root) else image.parent.as_posix()
        head, number = _numbered(image.stem)
        where = f"{folder}/{head}" if folder != "." else head
        if number is None:
            names[k] = where
        else:
            series[where].append((number, k))
    for where, members in series.items():
        runs = _runs(sorted(members))
        for run in runs:
            label = where if len(runs) == 1 else f"{where}{run[0][0]}-{run[-1][0]}"
            for _, k in run:
                names[k] = label or "all"
    return names


def _numbered(stem: str) -> tuple[str, int | None]:
    """left_0007 -> left_, 7; also in the names that Roboflow gives its copies (left_0007_jpg.rf.1f3a...)."""
    plain = re.sub(r"(_(jpe?g|png|bmp|tiff?))?\.rf\.\w+$", "", stem)
    match = re.fullmatch(r"(.*?)(\d+)\D*", plain)
    return (match[1], int(match[2])) if match else (plain, None)


def _runs(members: list[tuple[int, int]]) -> list[list[tuple[int, int]]]:
    """Cut a sorted series where its number jumps by more than GAP usual steps."""
    numbers = np.array([number for number, _ in members], np.float64)
    steps = np.diff(numbers)
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    cuts = [0, *(int(k) + 1 for k in np.flatnonzero(steps > GAP * usual)), len(members)]
    return [members[a:b] for a, b in pairwise(cuts)]


def read_clips(file: Path) -> dict[str, tuple[str, str | None]]:
    """``image,clip[,part]`` rows: image file name -> its clip and, where given, its part."""
    try:
        with file.open(encoding="utf-8-sig", newline="") as stream:
            rows = list(csv.DictReader(stream))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read ({error})", str(file), "give a CSV file image,clip") from error
    given: dict[str, tuple[str, str | None]] = {}
    for number, row in enumerate(rows, 2):
        image, clip, part = (str(row.get(key) or "").strip() for key in ("image", "clip", "part"))
        if not image or not clip:
            raise InputError("no image or no clip", f"{file} row {number}", COLUMNS)
        if part and part not in PARTS:
            raise InputError(f"part {part!r}", f"{file} row {number}", "give train, val or test, or leave it empty")
        given[Path(image).name] = (clip, part or None)
    if not given:
        raise InputError("no rows", str(file), COLUMNS)
    return given
