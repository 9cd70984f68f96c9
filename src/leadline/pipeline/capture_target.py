"""Guided capture of target images for training: sharp, unlike each other, the target at all sizes and places.

What is sharp, alike, and of which size is judged as `leadline dataset` judges it, and the folder is such a set.
"""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter, deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from leadline.config import Config
from leadline.errors import InputError
from leadline.pipeline.capture_files import CAPTURE, CaptureFolder
from leadline.pipeline.dataset_choice import BLURRED, EMPTY_PART, NEIGHBOURS, OCTAVES, Candidate, candidate
from leadline.pipeline.dataset_files import Item, write_set
from leadline.pipeline.dataset_labels import Labels, ModelLabeller
from leadline.pipeline.dataset_preview import write_preview
from leadline.samples import NS_PER_S, Detection, StereoFrame
from leadline.sinks.web_capture import Look, Status, Wanted
from leadline.wire.calibration_folder import read_image
from leadline.wire.images import SUFFIX, encode_jpeg, image_format

IMAGES, EACH_SIZE, EACH_PLACE = 60, 8, 3
EMPTY = round(EMPTY_PART * IMAGES)
DIFFERENT = 1.0
"""In the steps by which two pictures of a data set are compared."""
_SETTLED = 5  # looks, from which sharpness is compared with theirs
_GRID = 3
_PLACES = (("upper left", "top", "upper right"), ("left", "middle", "right"), ("lower left", "bottom", "lower right"))
_NEXT = {  # by OCTAVES
    0: "Turn away from the target: some pictures without it are wanted too",
    1: "Go far away, until the target is under a sixteenth of the picture",
    2: "Go away, until the target is about a tenth of the picture",
    3: "Come to where the target is about a fifth of the picture",
    4: "Come near, until the target is about a third of the picture",
    5: "Come so near that the target fills more than half of the picture",
}


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A picture as it is weighed; cell: row and column of the target's middle, of three by three, None without one."""

    weighed: Candidate
    size_px: tuple[int, int]
    cell: tuple[int, int] | None

    @property
    def size(self) -> int:
        return self.weighed.size


def _seen(number: int, frame: StereoFrame, labels: Labels) -> Seen:
    height, width = frame.left.shape[:2]
    best = max(labels.boxes, key=lambda d: d.score, default=None)
    cell = None
    if best is not None:
        x, y, w, h = best.box_px
        cell = _third((y + h / 2) / height), _third((x + w / 2) / width)
    return Seen(candidate(0, number, frame, labels), (width, height), cell)


class TargetCapture:
    """``Capture``: left images in ``out/images``, at the end with labels, preview and tables beside them.

    InputError where the folder holds something else, or labels that were corrected since.
    """

    what = "target"

    def __init__(self, out: Path, model: Path | None, config: Config, *, patient: bool = False) -> None:
        self.labeller = ModelLabeller(model, config)
        if (out / "labels").is_dir() and (out / CAPTURE).is_file() and _newer(out / "labels", out / CAPTURE):
            raise InputError("labels were changed since the capture", str(out), "capture into a new folder")
        self.folder = CaptureFolder(out, ("images",), {"what": self.what, "model": self.labeller.provenance})
        self._kept: dict[str, Seen] = {}
        self._sharpness: deque[float] = deque(maxlen=2 * NEIGHBOURS + 1)
        self._go_on()

    def _go_on(self) -> None:
        for name in self.folder.names:
            note = self.folder.notes.get(name)
            image = read_image(self.folder.files(name)[0])
            frame = StereoFrame(round(float((note or {}).get("t_s", 0)) * NS_PER_S), image, image, name=name)
            labels = self.labeller.labels(frame) if note is None else _labels_from(note)
            self._kept[name] = _seen(len(self._kept), frame, labels)

    # -- frames ------------------------------------------------------------------------------------------------------

    def take(self, frame: StereoFrame) -> Look:
        labels = self.labeller.labels(frame)
        seen = _seen(len(self._kept), frame, labels)
        state, words = self._judge(seen)
        self._sharpness.append(seen.weighed.sharpness)
        if state == "saved":
            words = self._save(frame, seen)
        boxes = [[round(v, 1) for v in box.box_px] for box in labels.boxes]
        return Look(state, words, boxes={"left": boxes, "right": []})

    def _judge(self, seen: Seen) -> tuple[str, str]:
        usual = float(np.median(self._sharpness)) if len(self._sharpness) >= _SETTLED else 0.0
        if seen.weighed.sharpness < BLURRED * usual:
            return "bad", "Blurred: slower, or more light."
        away = [float(np.linalg.norm(seen.weighed.look - other.weighed.look)) for other in self._kept.values()]
        if away and min(away) < DIFFERENT:
            return "same", f"Like picture {int(np.argmin(away)) + 1}, which is saved: move on."
        if seen.size == 0 and self._sizes[0] >= EMPTY:
            return "same", "The detector sees no target. If there is one, keep the picture with S: it is worth most."
        if seen.size and not self._brings(seen):
            return "same", "Seen well, but nothing that is missing: see what is next."
        return "saved", ""

    def _brings(self, seen: Seen) -> bool:
        short = self._sizes[seen.size] < EACH_SIZE or (seen.cell is not None and self._places[seen.cell] < EACH_PLACE)
        return short or len(self._kept) < IMAGES

    def _save(self, frame: StereoFrame, seen: Seen) -> str:
        data = frame.encoded[0] if frame.encoded else encode_jpeg(frame.left)
        note = {"t_s": frame.t_s, "size": OCTAVES[seen.size], **_note(seen.weighed.labels)}
        name = self.folder.save([(data, SUFFIX.get(image_format(data), ".jpg"))], note)
        self._kept[name] = seen
        self._write()
        return f"Saved: picture {len(self._kept)}."

    def keep(self, frame: StereoFrame) -> str:
        return self._save(frame, _seen(len(self._kept), frame, self.labeller.labels(frame)))

    def tales(self) -> list[str]:
        return []

    def undo(self) -> str:
        if not self._kept:
            return "There is nothing to take out."
        name, _ = self._kept.popitem()
        self.folder.set_aside(name, "taken out by hand")
        self._write()
        return f"Picture {len(self._kept) + 1} is taken out."

    # -- what there is -----------------------------------------------------------------------------------------------

    @property
    def _sizes(self) -> Counter[int]:
        return Counter(one.size for one in self._kept.values())

    @property
    def _places(self) -> Counter[tuple[int, int]]:
        return Counter(one.cell for one in self._kept.values() if one.cell is not None)

    @property
    def missing(self) -> tuple[str, ...]:
        sizes, places = self._sizes, self._places
        out = [
            f"{EACH_SIZE - sizes[k]} with the target {_size(k)}" for k in range(1, len(OCTAVES)) if sizes[k] < EACH_SIZE
        ]
        here = [
            name
            for row, names in enumerate(_PLACES)
            for column, name in enumerate(names)
            if places[row, column] < EACH_PLACE
        ]
        if here:
            out.append(f"the target {', '.join(here)} of the picture")
        if sizes[0] < EMPTY:
            out.append(f"{EMPTY - sizes[0]} without it")
        if len(self._kept) < IMAGES:
            out.append(f"{IMAGES - len(self._kept)} pictures more in all")
        if self._kept and sizes[0] == len(self._kept):
            out.append("the detector does not know this target, so its size and place cannot be judged")
        return tuple(out)

    @property
    def enough(self) -> bool:
        return not self.missing

    def status(self) -> Status:
        sizes, places = self._sizes, self._places
        wanted = [
            *(Wanted(OCTAVES[k], sizes[k], EACH_SIZE) for k in range(1, len(OCTAVES))),
            Wanted("no target", sizes[0], EMPTY),
        ]
        grid = [
            ["yes" if places[row, column] >= EACH_PLACE else "no" for column in range(_GRID)] for row in range(_GRID)
        ]
        parts = [min(one.have / one.want, 1.0) for one in wanted]
        parts += [min(places[row, column] / EACH_PLACE, 1.0) for row in range(_GRID) for column in range(_GRID)]
        return Status(
            count=len(self._kept),
            want=IMAGES,
            share=float(sum(parts) + min(len(self._kept) / IMAGES, 1.0)) / (len(parts) + 1),
            next=self._next(),
            cells={"left": grid},
            lists={"Size of the target": wanted},
            missing=self.missing,
            enough=self.enough,
        )

    def _next(self) -> str:
        if self.enough:
            return "Enough: a varied set."
        sizes, places = self._sizes, self._places
        short = [k for k in (5, 4, 3, 2, 1) if sizes[k] < EACH_SIZE]
        empty = [(row, column) for row in range(_GRID) for column in range(_GRID) if places[row, column] < EACH_PLACE]
        where = ""
        if empty:
            row, column = min(empty, key=lambda at: (places[at], at != (1, 1), at))
            at = "in the" if (row, column) == (1, 1) else "at the"
            where = f"with the target {at} {_PLACES[row][column]} of the picture"
        if short:
            size = min(short, key=lambda k: (sizes[k], -k))
            return f"{_NEXT[size]}{', ' + where if where and size < 5 else ''}."
        if where:
            return f"Now {where}."
        return f"{_NEXT[0]}." if sizes[0] < EMPTY else "Go on, from other sides and before other backgrounds."

    # -- the folder --------------------------------------------------------------------------------------------------

    def _write(self) -> None:
        self.folder.write({"enough": self.enough, "missing": list(self.missing)})

    def finish(self) -> list[str]:
        """Labels, preview and tables beside the images."""
        out = self.folder.out
        items = []
        for name, one in self._kept.items():
            file = self.folder.files(name)[0].name
            items.append(Item(file, one.size_px, "capture", one.weighed.t_ns, one.weighed.labels))
        with tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.name}.") as beside:
            made = Path(beside)
            (made / "images").symlink_to((out / "images").resolve())
            write_set(made, items, self.labeller.names, self.labeller.provenance)
            write_preview(made, items, self.labeller.provenance)
            (made / "images").unlink()
            for part in sorted(made.iterdir()):
                _replace(part, out / part.name)
        self._write()
        return [f"next: correct the labels ({out / 'README.md'}), then leadline train {out} --out MODEL_FOLDER"]


def _replace(made: Path, place: Path) -> None:
    if place.is_dir():
        shutil.rmtree(place)
    shutil.move(made, place)


def _newer(labels: Path, than: Path) -> bool:
    return any(path.stat().st_mtime > than.stat().st_mtime + 1 for path in labels.iterdir())


def _third(part: float) -> int:
    return int(np.clip(np.floor(_GRID * part), 0, _GRID - 1))


def _size(octave: int) -> str:
    return OCTAVES[octave] if "view" in OCTAVES[octave] else f"{OCTAVES[octave]} of the view"


def _note(labels: Labels) -> dict[str, Any]:
    boxes = [
        {"box_px": [round(v, 2) for v in b.box_px], "score": round(b.score, 4), "label": b.label} for b in labels.boxes
    ]
    return {"boxes": boxes, "doubts": list(labels.doubts)}


def _labels_from(note: dict[str, Any]) -> Labels:
    boxes = tuple(Detection(tuple(b["box_px"]), b["score"], b["label"]) for b in note.get("boxes", ()))
    return Labels(boxes, None, tuple(note.get("doubts", ())))
