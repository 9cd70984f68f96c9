"""What a detector found, missed and made up at one score, by box size, by water, by class and by clip."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from leadline.evaluation.detection import Box, DetectionQuality, Pair, evaluate_detections
from leadline.samples import Detection

SIDES_PX = (0.0, 16.0, 32.0, 64.0, 128.0, 256.0, 512.0, float("inf"))  # a side: the root of the box's area
COCO_SIDES_PX = (0.0, 32.0, 96.0, float("inf"))  # COCO's small, medium, large
MISSED, NOTHING = "missed", "nothing there"
SCORES = tuple(round(0.05 * k, 2) for k in range(1, 20))


@dataclass(frozen=True, slots=True)
class Picture:
    """A labelled image and what was found in it; ``unsure`` boxes may be targets and count neither way."""

    name: str
    clip: str
    contrast: float
    truths: tuple[tuple[Box, str], ...]
    unsure: tuple[Box, ...]
    found: tuple[Detection, ...]


@dataclass(frozen=True, slots=True)
class Seen:
    """A true box, and the detection that found it, if one did."""

    picture: Picture
    box_px: Box
    label: str
    detection: Detection | None

    @property
    def centre_error_px(self) -> float:
        assert self.detection is not None
        (x, y, w, h), (a, b, c, d) = self.box_px, self.detection.box_px
        return float(np.hypot(a + c / 2 - x - w / 2, b + d / 2 - y - h / 2))


@dataclass(frozen=True, slots=True)
class FalseBox:
    """A detection where no target (of its class) is."""

    picture: Picture
    detection: Detection


@dataclass(frozen=True, slots=True)
class Centres:
    """Distance of found boxes' centres from the true ones, px."""

    mean_px: float
    rms_px: float
    p95_px: float


@dataclass(frozen=True, slots=True)
class Row:
    """A group of boxes: true ones, how many of them were found, and false boxes."""

    name: str
    truths: int
    found: int
    false: int
    centres: Centres | None

    @property
    def recall(self) -> float | None:
        return self.found / self.truths if self.truths else None

    @property
    def precision(self) -> float | None:
        return self.found / (self.found + self.false) if self.found + self.false else None


class Outcome:
    """Pictures with the detector's answers, judged class by class at IoU 0.5 and ``score``."""

    def __init__(self, pictures: Sequence[Picture], names: Sequence[str], score: float) -> None:
        self.pictures, self.names, self.score = list(pictures), list(names), score

    @cached_property
    def by_class(self) -> dict[str, DetectionQuality]:
        """The quality for each class that has true boxes or was claimed."""
        present = [n for n in self.names if any(_has(p, n) for p in self.pictures)] or self.names[:1]
        return {name: _quality(self.pictures, name) for name in present}

    def ap(self, images: Iterable[Picture] | None = None) -> tuple[float, float, float]:
        """AP50, AP75, AP50-95: the mean over the classes with true boxes; NaN where there are none."""
        if images is None:
            every = [quality for quality in self.by_class.values() if quality.truths]
        else:
            every = [q for name in self.by_class if (q := _quality(list(images), name)).truths]
        if not every:
            return (np.nan, np.nan, np.nan)
        parts = np.mean([(q.ap50, q.ap75, q.ap50_95) for q in every], axis=0)
        return float(parts[0]), float(parts[1]), float(parts[2])

    @cached_property
    def seen(self) -> list[Seen]:
        """Every true box."""
        found = {
            (pair.image, name, pair.truth): pair.detection
            for name, quality in self.by_class.items()
            for pair in quality.pairs
            if pair.truth is not None and pair.detection.score >= self.score
        }
        return [
            Seen(picture, box, name, found.get((picture.name, name, number)))
            for picture in self.pictures
            for name in self.by_class
            for number, box in enumerate(_boxes(picture, name))
        ]

    @cached_property
    def false(self) -> list[FalseBox]:
        """Every false box, the surest first."""
        named = {picture.name: picture for picture in self.pictures}
        pairs = [pair for quality in self.by_class.values() for pair in quality.pairs if self._is_false(pair)]
        pairs.sort(key=lambda pair: -pair.detection.score)
        return [FalseBox(named[pair.image], pair.detection) for pair in pairs]

    def _is_false(self, pair: Pair) -> bool:
        return pair.truth is None and pair.detection.score >= self.score

    def row(
        self, name: str, among: Collection[str] | None = None, sides_px: tuple[float, float] = (0.0, float("inf"))
    ) -> Row:
        """Boxes with a side within ``sides_px`` (a false one's own) in the pictures of these names (None: in all)."""
        seen = [s for s in self.seen if _among(s.picture, among) and _within(s.box_px, sides_px)]
        false = [f for f in self.false if _among(f.picture, among) and _within(f.detection.box_px, sides_px)]
        hits = [s.centre_error_px for s in seen if s.detection is not None]
        return Row(name, len(seen), len(hits), len(false), _centres(hits))

    def by_size(self) -> list[Row]:
        """By octaves of the box's side, those without any box left out."""
        rows = [self.row(size_name(*sides), sides_px=sides) for sides in pairwise(SIDES_PX)]
        return [row for row in rows if row.truths or row.false]

    def by_clip(self) -> list[Row]:
        """By clip, in order of name."""
        clips = sorted({picture.clip for picture in self.pictures})
        return [self.row(clip, {p.name for p in self.pictures if p.clip == clip}) for clip in clips]

    def confusion(self) -> tuple[list[str], list[list[int]]]:
        """Which class was taken for which: true classes down, and nothing; claimed classes across, and missed."""
        names = list(self.by_class)
        quality = evaluate_detections(
            {p.name: [d for d in p.found if d.label in names] for p in self.pictures},
            {p.name: [box for box, _ in p.truths] for p in self.pictures},
            {p.name: p.unsure for p in self.pictures},
        )
        label = {(p.name, k): name for p in self.pictures for k, (_, name) in enumerate(p.truths)}
        counts: Counter[tuple[str, str]] = Counter((name, MISSED) for name in label.values())
        for pair in quality.pairs:
            if pair.detection.score < self.score:
                continue
            true = NOTHING if pair.truth is None else label[pair.image, pair.truth]
            counts[true, pair.detection.label] += 1
            counts[true, MISSED] -= pair.truth is not None
        return names, [[counts[true, claimed] for claimed in (*names, MISSED)] for true in (*names, NOTHING)]

    def by_score(self) -> list[tuple[float, float, float]]:
        """Score, precision, recall over all classes."""
        truths = sum(q.truths for q in self.by_class.values())
        pairs = [pair for q in self.by_class.values() for pair in q.pairs]
        out = []
        for score in SCORES:
            claimed = [pair for pair in pairs if pair.detection.score >= score]
            hits = sum(pair.truth is not None for pair in claimed)
            out.append((score, hits / len(claimed) if claimed else 1.0, hits / max(truths, 1)))
        return out


def side_px(box_px: Box) -> float:
    """The side of the square of the box's area."""
    return float(np.sqrt(max(box_px[2] * box_px[3], 0.0)))


def size_name(low_px: float, high_px: float) -> str:
    if low_px <= 0:
        return f"under {high_px:g} px"
    return f"{low_px:g} px and more" if np.isinf(high_px) else f"{low_px:g} to {high_px:g} px"


def _within(box_px: Box, sides_px: tuple[float, float]) -> bool:
    return sides_px[0] <= side_px(box_px) < sides_px[1]


def _among(picture: Picture, names: Collection[str] | None) -> bool:
    return names is None or picture.name in names


def _has(picture: Picture, name: str) -> bool:
    return bool(_boxes(picture, name)) or any(d.label == name for d in picture.found)


def _boxes(picture: Picture, name: str) -> list[Box]:
    return [box for box, label in picture.truths if label == name]


def _quality(pictures: Sequence[Picture], name: str) -> DetectionQuality:
    found: Mapping[str, list[Detection]] = {p.name: [d for d in p.found if d.label == name] for p in pictures}
    return evaluate_detections(found, {p.name: _boxes(p, name) for p in pictures}, {p.name: p.unsure for p in pictures})


def _centres(errors_px: Sequence[float]) -> Centres | None:
    if not errors_px:
        return None
    errors = np.array(errors_px)
    return Centres(float(errors.mean()), float(np.sqrt(np.mean(errors**2))), float(np.percentile(errors, 95)))
