"""Which frames of recordings are worth labelling: sharp ones, unlike each other, with the target at all sizes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from leadline.pipeline.dataset_labels import Labels
from leadline.samples import Array, Detection, Image, StereoFrame

THUMB = (16, 9)
GREY_STEP = 12.0  # grey levels (RMS over the thumbnail) that make two pictures as different as ...
PLACE_STEP = 0.1  # ... this part of the width that the target has moved, or ...
SIZE_STEP = 0.5  # ... so many octaves of its size
ALIKE = 0.12  # pictures nearer to each other than this are one picture
SHARP_LONG_SIDE_PX, SHARP_SIGMA_PX = 960, 1.2
NEIGHBOURS = 7  # frames on each side, to which a frame's sharpness is compared
FAR = 1e6
BLURRED = 0.5  # with less of its neighbours' detail a frame is left out
EMPTY_PART = 0.1  # of the set: frames in which nothing was found, they teach what is no target
OCTAVES = ("no target", "under 1/16", "1/16 to 1/8", "1/8 to 1/4", "1/4 to 1/2", "over 1/2 of the view")


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A frame that was looked at: the ``number``-th of its recording. ``look``: what it is compared by."""

    recording: int
    number: int
    t_ns: int
    name: str
    labels: Labels
    size: int  # which of OCTAVES the surest target's side is, as a part of the picture's
    sharpness: float
    look: Array


def candidate(recording: int, number: int, frame: StereoFrame, labels: Labels) -> Candidate:
    """A frame as it is weighed."""
    best = max(labels.boxes, key=lambda d: d.score, default=None)
    part = 0.0 if best is None else _part(best, frame.left)
    size = 0 if best is None else int(np.clip(5 + np.floor(np.log2(max(part, 1e-6)) + 1), 1, 5))
    return Candidate(
        recording, number, frame.t_ns, frame.name, labels, size, sharpness(frame.left), look(frame.left, best)
    )


def sharpness(image: Image) -> float:
    """Energy of the fine detail (a Laplacian of Gaussian's variance), to be compared with that of like pictures."""
    grey = image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
    scale = SHARP_LONG_SIDE_PX / max(grey.shape)
    if scale < 1:
        grey = np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), SHARP_SIGMA_PX)
    return float(cv2.Laplacian(smooth, cv2.CV_32F).var())


def look(image: Image, target: Detection | None) -> Array:
    """A vector whose Euclidean distance tells how unlike pictures are: a thumbnail, and the target's place and size."""
    colour = image if image.ndim == 3 else np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
    thumb = cv2.resize(colour, THUMB, interpolation=cv2.INTER_AREA).astype(np.float64).ravel()
    place = np.zeros(3)
    if target is not None:
        x, y, w, h = target.box_px
        width = image.shape[1]
        octaves = np.log2(max(_part(target, image), 1e-6)) / SIZE_STEP
        place = np.array([(x + w / 2) / width / PLACE_STEP, (y + h / 2) / width / PLACE_STEP, octaves])
    return np.concatenate([thumb / (GREY_STEP * np.sqrt(thumb.size)), place])


def _part(target: Detection, image: Image) -> float:
    """The target's side as a part of the picture's."""
    return float(np.sqrt(target.box_px[2] * target.box_px[3] / (image.shape[0] * image.shape[1])))


def choose_frames(candidates: Sequence[Candidate], count: int) -> list[Candidate]:
    """At most ``count`` of them, in order of recording and time: fewer where the others are blurred or alike.

    Sizes take turns; within one, the frame that is farthest from all chosen ones comes next, a sharper one sooner.
    Deterministic: of equals the first.
    """
    if not candidates:
        return []
    sharp = _relative_sharpness(candidates)
    looks, sizes = np.array([c.look for c in candidates]), np.array([c.size for c in candidates])
    away = np.full(len(candidates), FAR)  # from the nearest chosen one
    weight = np.minimum(sharp, 1.5) ** 0.5
    chosen: list[int] = []
    while len(chosen) < count and (left := (sharp >= BLURRED) & (away >= ALIKE)).any():
        size = _next_size(Counter(sizes[chosen].tolist()), set(sizes[left].tolist()), count)
        best = int(np.argmax(np.where(left & (sizes == size), away * weight, -1.0)))
        chosen.append(best)
        away = np.minimum(away, np.linalg.norm(looks - looks[best], axis=1))
    return [candidates[k] for k in sorted(chosen, key=lambda k: (candidates[k].recording, candidates[k].number))]


def _next_size(taken: Counter[int], left: set[int], count: int) -> int:
    """The size of which there are fewest so far; empty pictures only up to their part, or when nothing else is left."""
    full = taken[0] >= max(1, round(EMPTY_PART * count))
    wanted = left - {0} if full and left != {0} else left
    return min(wanted, key=lambda size: (taken[size], size))


def _relative_sharpness(candidates: Sequence[Candidate]) -> Array:
    """Each frame's sharpness over the median of its neighbours in the recording: 1 is as sharp as they are."""
    out = np.ones(len(candidates))
    for recording in {c.recording for c in candidates}:
        members = [k for k, c in enumerate(candidates) if c.recording == recording]
        values = np.array([candidates[k].sharpness for k in members])
        for i, k in enumerate(members):
            near = values[max(0, i - NEIGHBOURS) : i + NEIGHBOURS + 1]
            out[k] = values[i] / max(float(np.median(near)), 1e-9)
    return out
