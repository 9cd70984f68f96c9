"""The user's own detector: boxes from a file of COCO results, keyed by the left image's file name."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from leadline.errors import InputError
from leadline.samples import Detection, StereoFrame

FIX = "each entry needs image_id (the left image's file name), bbox [x, y, width, height] and score"
NO_FRAME = "no box belongs to any frame of this dive"
KEY = "image_id must be the left image's file name, such as left_05.jpg"
HALF_PX = 0.5  # COCO counts from the first pixel's outer corner, leadline from its centre


class Boxes:
    """The detections of a COCO results list, or of the ``annotations`` of a COCO file; same ``find`` as Detector.

    Raises InputError, naming the file and the entry, for what cannot be read.
    """

    def __init__(self, path: str | Path) -> None:
        self._found: dict[str, list[Detection]] = {}
        for number, entry in enumerate(_entries(Path(path))):
            name, detection = _read(entry, f"{path} entry {number}")
            self._found.setdefault(name, []).append(detection)
        for detections in self._found.values():
            detections.sort(key=lambda d: -d.score)
        self._met: set[str] = set()

    def find(self, frame: StereoFrame) -> list[Detection]:
        """The boxes of the frame's left image, best first; empty where the file has none."""
        name = Path(frame.name).name
        found = self._found.get(name, ())
        if found:
            self._met.add(name)
        return list(found)

    def belong_to(self, names: Iterable[str]) -> bool:
        """Whether there is a box for one of these images, or no box at all: then nothing can be said."""
        return not self._found or any(Path(name).name in self._found for name in names)

    def summary(self) -> dict[str, int]:
        """The images with boxes: how many in the file, and how many of them came by."""
        return {"images": len(self._found), "found": len(self._met)}


def _entries(path: Path) -> list[Any]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", str(path), "give a COCO results file") from error
    except ValueError as error:
        raise InputError(f"not JSON ({error})", str(path), "give a COCO results file") from error
    entries = data.get("annotations") if isinstance(data, dict) else data
    if not isinstance(entries, list):
        raise InputError("neither a list of results nor a file with annotations", str(path), FIX)
    return entries


def _read(entry: Any, where: str) -> tuple[str, Detection]:
    try:
        name = Path(str(entry["image_id"])).name
        x, y, width, height = (float(v) for v in entry["bbox"])
        score = float(entry.get("score", 1.0))
        label = str(entry.get("category_name", entry.get("category_id", "target")))
    except KeyError as error:
        raise InputError(f"no {error}", where, FIX) from error
    except (TypeError, ValueError, AttributeError) as error:
        raise InputError(f"not a detection ({error})", where, FIX) from error
    if not all(math.isfinite(v) for v in (x, y, width, height, score)) or width <= 0 or height <= 0:
        raise InputError(f"bad bbox or score {entry['bbox']}, {score}", where, FIX)
    return name, Detection((x - HALF_PX, y - HALF_PX, width, height), score, label)
