"""What lies in a folder of labelled images: YOLO, COCO or Pascal VOC, told from the files themselves.

Each format yields ``Entry``: an image, the part of the set's own split it stands in, and a reader of its labels. Boxes
are converted by globox; files, their faults and the split are looked after here, because a fault must cost one image,
not the set.
"""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import yaml
from globox import BoundingBox, BoxFormat, ParsingError  # type: ignore[import-untyped]

from leadline.errors import InputError

IMAGE_SUFFIXES = {".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff"}
PARTS = {"train": "train", "training": "train", "val": "val", "valid": "val", "validation": "val", "test": "test"}
NAME_LISTS = ("classes.txt", "obj.names", "predefined_classes.txt")
CROWD = "\0crowd"  # a COCO box around many targets: nothing is taught there

Labelled = tuple[str, tuple[float, float, float, float]]  # class name, x0 y0 x1 y1
Reader = Callable[[tuple[int, int]], list[Labelled]]  # image size (w, h) -> labels; ValueError says what is wrong


@dataclass(frozen=True, slots=True)
class Entry:
    image: Path
    part: str | None  # train, val, test; None where the set does not say
    read: Reader


@dataclass(slots=True)
class Found:
    """A set as its files tell it; ``troubles`` (file, why) what could not be used."""

    format: str
    entries: list[Entry]
    names: list[str] | None = None  # in the set's own order; None: in that of the alphabet
    troubles: list[tuple[str, str]] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)


def find_labels(path: Path) -> Found:
    """Look through a folder (or a data.yaml, or a COCO file). InputError where nothing is recognised."""
    if not path.exists():
        raise InputError("no such folder or file", str(path), "give a folder of labelled images")
    root = path if path.is_dir() else path.parent
    images = Images(root)
    if (file := _data_yaml(path)) is not None:
        return _yolo(file.parent, images, _load_yaml(file))
    if files := _coco_files(path):
        return _coco(files, images)
    if notes := sorted(root.rglob("*.xml"), key=lambda p: natural_key(str(p))):
        return _voc(root, notes, images)
    if any(_label_file(image).is_file() for image in images):
        return _yolo(root, images, {"names": _listed_names(root)})
    raise InputError(
        "no labels found",
        str(path),
        "give a YOLO (data.yaml, images/, labels/), COCO (.json) or Pascal VOC (Annotations/*.xml) set",
    )


def natural_key(name: str) -> tuple[tuple[int, str], ...]:
    """Sorts frame9 before frame10."""
    return tuple((int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name) if part)


class Images:
    """The image files under a folder, in natural order, found again by name."""

    def __init__(self, root: Path) -> None:
        self.root = root
        files = (p for p in root.rglob("*") if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith("."))
        self._files = sorted(files, key=lambda p: natural_key(str(p)))
        self._by_name: dict[str, list[Path]] = defaultdict(list)
        for file in self._files:
            self._by_name[file.name].append(file)
            self._by_name[file.stem].append(file)

    def __iter__(self) -> Iterator[Path]:
        return iter(self._files)

    def named(self, name: str, near: Path) -> Path | None:
        """The image ``name`` (with or without suffix, folders); of several, the one nearest to ``near``."""
        beside = near.parent / name
        if beside.is_file() and beside.suffix.lower() in IMAGE_SUFFIXES:
            return beside
        wanted = Path(name.replace("\\", "/"))
        found = self._by_name.get(wanted.name) or self._by_name.get(wanted.stem) or []
        agrees = [p for p in found if p.parts[-len(wanted.parts) :] == wanted.parts]
        return min(agrees or found, key=partial(_steps, near), default=None)

    def part(self, file: Path) -> str | None:
        """The part of a split that a folder's name says: train/, valid/ or images/test/."""
        folders = file.relative_to(self.root).parts[:-1] if file.is_relative_to(self.root) else ()
        return next((PARTS[name.lower()] for name in reversed(folders) if name.lower() in PARTS), None)


def _steps(a: Path, b: Path) -> int:
    """How many folders lie between two files."""
    shared = sum(1 for _ in _same_start(a.parts, b.parts))
    return len(a.parts) + len(b.parts) - 2 * shared


def _same_start(a: Iterable[str], b: Iterable[str]) -> Iterator[str]:
    for x, y in zip(a, b, strict=False):
        if x != y:
            return
        yield x


# YOLO


def _data_yaml(path: Path) -> Path | None:
    """The file that names the classes: the path itself, data.yaml, or the only other one that has ``names``."""
    if path.is_file():
        return path if path.suffix.lower() in {".yaml", ".yml"} else None
    files = sorted([*path.glob("*.yaml"), *path.glob("*.yml")], key=lambda p: (p.stem != "data", p.name))
    return next((file for file in files if "names" in _load_yaml(file)), None)


def _load_yaml(file: Path) -> dict[str, Any]:
    try:
        data = yaml.safe_load(file.read_text(encoding="utf-8", errors="replace"))
    except yaml.YAMLError as error:
        raise InputError("is not YAML", str(file), str(error)) from error
    return data if isinstance(data, dict) else {}


def _yolo(root: Path, images: Images, data: dict[str, Any]) -> Found:
    given = data.get("names")
    pairs = given.items() if isinstance(given, dict) else enumerate(given or ())
    names = {str(number): str(name) for number, name in pairs}
    found = Found("YOLO", [], list(names.values()) if names else None)
    base = root / str(data.get("path") or "")
    listed: dict[Path, str] = {}
    for key in ("train", "val", "test"):
        for image in _listed_images(data.get(key), base if base.is_dir() else root, images):
            if listed.setdefault(image, key) != key:
                listed[image] = ""  # the same image in two parts: the set has no real split
    twice = [image for image, part in listed.items() if not part]
    if twice:
        found.remarks.append(f"the set's own split is not kept: {twice[0].name} and others stand in two of its parts")
    for image in listed or images:
        part = listed.get(image) if listed else images.part(image)
        found.entries.append(Entry(image, None if twice else part, partial(_read_yolo, _label_file(image), names)))
    unlabelled = sum(not _label_file(entry.image).is_file() for entry in found.entries)
    if unlabelled:
        found.remarks.append(f"{unlabelled} images have no label file: taken as images without a target")
    with_image = {_label_file(image) for image in images}
    for file in sorted(root.rglob("labels/**/*.txt")):
        if file not in with_image and file.name not in NAME_LISTS:
            found.troubles.append((str(file), "there is no image of that name"))
    return found


def _listed_images(given: Any, base: Path, images: Images) -> Iterator[Path]:
    """The images of a ``train:``, ``val:`` or ``test:`` entry: folders, or text files that list images."""
    for item in given if isinstance(given, list) else [given] if given else []:
        place = _place(str(item), base)
        if place is None:
            continue
        if place.is_file():
            lines = place.read_text(encoding="utf-8", errors="replace").split("\n")
            found = (images.named(line.strip(), place) for line in lines if line.strip())
            yield from (image for image in found if image)
        else:
            yield from Images(place)


def _place(item: str, base: Path) -> Path | None:
    """A path of a data.yaml, which is often written for another machine: its longest end that exists here."""
    parts = Path(item.replace("\\", "/")).parts
    for start in range(len(parts)):
        place = base.joinpath(*parts[start:])
        if place.exists():
            return place.resolve() if ".." in parts[start:] else place
    return None


def _label_file(image: Path) -> Path:
    """images/a/1.jpg -> labels/a/1.txt; beside the image where there is no folder images/."""
    parts = list(image.parts)
    for k in range(len(parts) - 2, -1, -1):
        if parts[k] == "images":
            parts[k] = "labels"
            return Path(*parts).with_suffix(".txt")
    beside = image.with_suffix(".txt")
    sibling = image.parent.parent / "labels" / beside.name
    return sibling if sibling.is_file() and not beside.is_file() else beside


def _listed_names(root: Path) -> list[str] | None:
    files = (file for name in NAME_LISTS for file in sorted(root.rglob(name)))
    first = next(files, None)
    return [line.strip() for line in first.read_text().splitlines() if line.strip()] if first else None


def _read_yolo(file: Path, names: dict[str, str], size: tuple[int, int]) -> list[Labelled]:
    if not file.is_file():
        return []
    labels = []
    for row, line in enumerate(file.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        if not line.strip():
            continue
        count = len(line.split())
        read = BoundingBox.from_yolo_seg if count > 6 and count % 2 else BoundingBox.from_yolo_v5
        try:
            box = read(line, image_size=size)
        except (ParsingError, ValueError, AssertionError) as error:
            raise ValueError(f"{file.name} row {row}: not `class x y width height` ({line[:40]!r})") from error
        if names and box.label not in names:
            raise ValueError(f"{file.name} row {row}: class {box.label}, but the set names {len(names)} classes")
        labels.append((names.get(box.label, box.label), box.ltrb))
    return labels


# COCO


def _coco_files(path: Path) -> list[Path]:
    """JSON files with images, annotations and categories: the path itself, or those within three folders."""
    if path.is_file():
        return [path] if path.suffix.lower() == ".json" else []
    files = [file for pattern in ("*.json", "*/*.json", "*/*/*.json") for file in sorted(path.glob(pattern))]
    return [file for file in files if {"images", "annotations"} <= _load_json(file).keys()]


def _load_json(file: Path) -> dict[str, Any]:
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except (ValueError, OSError) as error:
        raise InputError(f"is not JSON ({error})", str(file), "export it again, or move it away") from error
    return data if isinstance(data, dict) else {}


def _coco(files: list[Path], images: Images) -> Found:
    found = Found("COCO", [], [])
    assert found.names is not None
    for file in files:
        data = _load_json(file)
        try:
            names = {c["id"]: str(c["name"]) for c in sorted(data["categories"], key=lambda c: c["id"])}
            notes: dict[Any, list[Any]] = {image["id"]: [] for image in data["images"]}
            for note in data["annotations"]:
                notes[note["image_id"]].append(note)
            listed = [(str(image["file_name"]), image["id"]) for image in data["images"]]
        except (KeyError, TypeError) as error:
            raise InputError(f"not a COCO annotation file ({error!r})", str(file), "export it again as COCO") from error
        found.names += [name for name in names.values() if name not in found.names]
        for name, number in listed:
            image = images.named(name, file)
            if image is None:
                found.troubles.append((f"{file.name}: {name}", "there is no image of that name"))
            else:
                part = _part_of_file(file) or images.part(file) or images.part(image)
                found.entries.append(Entry(image, part, partial(_read_coco, notes[number], names)))
    return found


def _part_of_file(file: Path) -> str | None:
    """instances_train2017.json -> train"""
    words = re.findall(r"[a-z]+", file.stem.lower())
    return next((PARTS[word] for word in words if word in PARTS), None)


def _read_coco(notes: list[Any], names: dict[int, str], size: tuple[int, int]) -> list[Labelled]:
    labels = []
    for note in notes:
        try:
            left, top, width, height = (float(v) for v in note["bbox"])
            box = BoundingBox.create(
                label=names[note["category_id"]], coords=(left, top, width, height), box_format=BoxFormat.LTWH
            )
        except KeyError as error:
            raise ValueError(f"annotation {note.get('id')}: no {error}") from error
        except (TypeError, ValueError, AssertionError) as error:
            raise ValueError(f"annotation {note.get('id')}: bbox {note['bbox']} is no x, y, width, height") from error
        labels.append((CROWD if note.get("iscrowd") else box.label, box.ltrb))
    return labels


# Pascal VOC


def _voc(root: Path, notes: list[Path], images: Images) -> Found:
    found = Found("Pascal VOC", [])
    parts = _voc_parts(root)
    labelled = set()
    for note in notes:
        image = images.named(note.stem, note)
        if image is None:
            found.troubles.append((str(note), "there is no image of that name"))
            continue
        labelled.add(image)
        part = parts.get(note.stem) if parts else images.part(image)
        found.entries.append(Entry(image, part, partial(_read_voc, note)))
    unlabelled = [image for image in images if image not in labelled]
    if unlabelled:
        found.remarks.append(f"{len(unlabelled)} images have no annotation: left out, the first {unlabelled[0].name}")
    return found


def _voc_parts(root: Path) -> dict[str, str]:
    """ImageSets/Main/train.txt and so on: file stem -> part."""
    parts: dict[str, str] = {}
    for key in ("train", "val", "test"):
        for file in root.rglob(f"ImageSets/*/{key}.txt"):
            parts |= {line.split()[0]: key for line in file.read_text().splitlines() if line.strip()}
    return parts


def _read_voc(note: Path, size: tuple[int, int]) -> list[Labelled]:
    try:
        root = ET.parse(note).getroot()
        boxes = [BoundingBox.from_xml(node) for node in root.iter("object")]
        stated = int(root.findtext("size/width") or 0), int(root.findtext("size/height") or 0)
    except (ET.ParseError, ParsingError, ValueError, AssertionError, OSError) as error:
        raise ValueError(f"{note.name}: not a Pascal VOC annotation ({error})") from error
    if all(stated) and stated != size:
        raise ValueError(f"{note.name}: says {stated[0]}x{stated[1]} pixels, but the image has {size[0]}x{size[1]}")
    return [(box.label, box.ltrb) for box in boxes]
