"""`leadline detect`: images, a folder, a video or a dive -> detections.json (COCO results) and drawn images."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from leadline.errors import InputError
from leadline.evaluation.drawing import draw_detections
from leadline.files import make_folder, write_whole
from leadline.samples import Detection, Image
from leadline.wire.dive_folder import read_frames, split_side_by_side
from leadline.wire.images import decode_image, quiet
from leadline.wire.notice import Notice

IMAGE_SUFFIXES = {".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff"}
VIDEO_SUFFIXES = {".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v"}
RESULTS_NAME = "detections.json"
CORNER_PX = 0.5  # COCO counts from the first pixel's outer corner, leadline from its centre

Named = tuple[str, Image | str]  # a file's name, and its image or why there is none


class Finder(Protocol):
    def detect(self, image: Image) -> list[Detection]: ...


@dataclass(slots=True)
class DetectReport:
    """What was done: ``images`` looked at, ``detections`` found in ``with_target`` of them; ``skipped`` (name, why)."""

    results: Path
    images: int = 0
    with_target: int = 0
    detections: int = 0
    skipped: list[tuple[str, str]] = field(default_factory=list)


def detect_images(
    input_path: Path,
    out_dir: Path,
    detector: Finder,
    progress: Callable[[int, int | None], None] = lambda done, total: None,
) -> DetectReport:
    """Detect in every image of ``input_path``; write ``detections.json`` and the drawn images into ``out_dir``.

    ``progress(done, total)``, total None where unknown. Images that cannot be read are counted in ``skipped``.
    Raises InputError where there is no image at all, or none that can be read.
    """
    skipped: list[tuple[str, str]] = []
    total, images = _open(input_path, skipped)
    make_folder(out_dir)
    report = DetectReport(out_dir / RESULTS_NAME, skipped=skipped)
    results: list[dict[str, object]] = []
    for done, (name, image) in enumerate(images, 1):
        if isinstance(image, str):
            report.skipped.append((name, image))
        else:
            found = detector.detect(image)
            results += coco_results(name, found)
            cv2.imwrite(str(out_dir / drawn_name(name)), draw_detections(image, found))
            report.images += 1
            report.with_target += bool(found)
        progress(done, total)
    if report.images == 0:
        raise InputError(f"no image can be read ({_first(report.skipped)})", str(input_path), "check the files")
    report.detections = len(results)
    write_whole(report.results, json.dumps(results, indent=1) + "\n")
    return report


def coco_results(name: str, found: Sequence[Detection]) -> list[dict[str, object]]:
    """One image's detections as COCO results; ``image_id`` is the file's name."""
    return [
        {
            "image_id": name,
            "category_id": 1,
            "category_name": d.label,
            "bbox": [round(v, 3) for v in (d.box_px[0] + CORNER_PX, d.box_px[1] + CORNER_PX, *d.box_px[2:])],
            "score": round(d.score, 5),
        }
        for d in found
    ]


def drawn_name(name: str) -> str:
    """frame.png -> frame_detected.jpg"""
    return f"{Path(name).stem}_detected.jpg"


def _open(path: Path, skipped: list[tuple[str, str]]) -> tuple[int | None, Iterator[Named]]:
    """The number of images, if known, and the images."""
    if path.is_dir() and (path / "frames.csv").is_file():
        return _dive(path, skipped)
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES)
        if not files:
            raise InputError("no images in this folder", str(path), "give PNG, JPEG, BMP or TIFF files")
        return len(files), ((file.name, _load(file)) for file in files)
    if not path.is_file():
        raise InputError("no such file or folder", str(path), "give an image, a folder, a video or a dive")
    if path.suffix.lower() in VIDEO_SUFFIXES:
        return _video(path)
    if path.suffix.lower() in IMAGE_SUFFIXES:
        return 1, iter([(path.name, _load(path))])
    raise InputError(
        f"unknown kind of file {path.suffix or '(no ending)'}", str(path), "give images, a video or a dive"
    )


def _load(file: Path) -> Image | str:
    try:
        return decode_image(file.read_bytes())
    except (OSError, ValueError) as error:
        return str(error)


def _dive(folder: Path, skipped: list[tuple[str, str]]) -> tuple[int, Iterator[Named]]:
    """The left images of a dive, under the names of the table."""

    def tell(notice: Notice) -> None:
        skipped.append((notice.where, notice.why))

    entries = read_frames(folder, tell)

    def images() -> Iterator[Named]:
        for entry in entries:
            image = _load(entry.files[0])
            if not isinstance(image, str) and len(entry.files) == 1:
                image = split_side_by_side(image)[0]
            yield Path(entry.name).name, image

    return len(entries), images()


def _video(path: Path) -> tuple[int | None, Iterator[Named]]:
    """Every frame of a video, named clip_000000.jpg and so on."""
    quiet()
    capture = cv2.VideoCapture(str(path))
    if not capture.isOpened():
        raise InputError("not a readable video", str(path), "convert it, e.g. to MP4")
    total = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))

    def images() -> Iterator[Named]:
        number = 0
        while True:
            good, image = capture.read()
            if not good:
                break
            yield f"{path.stem}_{number:06d}.jpg", np.asarray(image, np.uint8)
            number += 1
        capture.release()

    return (total if total > 0 else None), images()


def _first(skipped: Sequence[tuple[str, str]]) -> str:
    return ": ".join(skipped[0]) if skipped else "the video is empty"
