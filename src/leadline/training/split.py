"""Training, validation and test parts of a set, whole clips in each."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leadline.errors import InputError
from leadline.training.dataset import UNSURE, Example, Floats, Ints
from leadline.training.formats import natural_key

SHARE = 0.1  # of validation and of test; the rest is for training: the paper's 8:1:1
LEAST, MOST = 0.04, 0.2  # what validation and test may have before clips are cut
TRIALS = 400
LEAST_IMAGES = 10

Clips = dict[str, list[Example]]


@dataclass(frozen=True, slots=True)
class Split:
    train: tuple[Example, ...]
    val: tuple[Example, ...]
    test: tuple[Example, ...]  # empty where the set's own split has none
    notices: tuple[str, ...] = ()


def split_by_clip(examples: Sequence[Example], seed: int = 0) -> Split:
    """8:1:1 by whole clips; the set's own split is kept. Deterministic for a seed.

    The clips are drawn so that validation and test come near a tenth of the images, of the boxes and of each class.
    Where that cannot be done, the longest clips are cut into runs of neighbouring frames, which is told.
    Raises InputError for fewer than ten images, or a part without a target.
    """
    if len(examples) < LEAST_IMAGES:
        raise InputError(f"{len(examples)} labelled image(s)", "the set", f"label at least {LEAST_IMAGES}, better 200")
    if {"train", "val"} <= {e.part for e in examples} or {"train", "test"} <= {e.part for e in examples}:
        return _own_split(examples, seed)
    clips: Clips = defaultdict(list)
    for example in examples:
        clips[example.clip].append(example)
    return _drawn(clips, ("val", "test"), seed)


def _own_split(examples: Sequence[Example], seed: int) -> Split:
    parts = {part: tuple(e for e in examples if e.part == part) for part in ("train", "val", "test")}
    notices = ["the set's own split is kept"]
    outside = sum(e.part is None for e in examples)
    if outside:
        notices.append(f"{outside} images stand in no part of it and are left out")
    if not parts["val"]:
        clips: Clips = defaultdict(list)
        for example in parts["train"]:
            clips[example.clip].append(example)
        drawn = _drawn(clips, ("val",), seed)
        parts |= {"train": drawn.train, "val": drawn.val}
        notices += ["it has no validation part: a tenth of its training part is taken, by clip", *drawn.notices]
    if not parts["test"]:
        notices.append("it has no test part: the figures are of the validation part, a little optimistic")
    shared = {e.clip for e in parts["train"]} & {e.clip for e in (*parts["val"], *parts["test"])}
    if shared:
        notices.append(f"clip {min(shared)} and others stand in several parts: the figures are optimistic")
    return _checked(Split(parts["train"], parts["val"], parts["test"], tuple(notices)))


def _drawn(clips: Clips, wanted: tuple[str, ...], seed: int) -> Split:
    """Draw whole clips; while no draw is good enough, cut the longest clip in two and draw again."""
    clips = {name: sorted(them, key=lambda e: natural_key(str(e.image))) for name, them in clips.items()}
    given = {name: len(them) for name, them in clips.items()}
    while True:
        names = sorted(clips, key=natural_key)
        chosen, good = _best_draw([clips[name] for name in names], len(wanted), seed)
        longest = max(clips, key=lambda name: (len(clips[name]), name))
        if good or len(clips[longest]) < 4:
            break
        run = clips.pop(longest)
        half = len(run) // 2
        clips |= {f"{longest} a": run[:half], f"{longest} b": run[half:]}
    parts: dict[str, list[Example]] = {"train": [], "val": [], "test": []}
    for name, number in zip(names, chosen, strict=True):
        part = "train" if number == 0 else wanted[number - 1]
        parts[part] += [replace(e, clip=name, part=part) for e in clips[name]]
    cut = [name for name in given if name not in clips]
    notices = [f"{len(given)} clips: " + _list(given)]
    if cut:
        notices.append(
            f"too few clips to keep them whole: {', '.join(cut[:3])} cut into runs of neighbouring frames; "
            "frames at a cut are alike, so the figures are a little optimistic"
        )
    return _checked(Split(tuple(parts["train"]), tuple(parts["val"]), tuple(parts["test"]), tuple(notices)))


def _list(clips: dict[str, int]) -> str:
    """The clips with their number of images, the longest first."""
    longest = sorted(clips.items(), key=lambda item: (-item[1], natural_key(item[0])))
    shown = ", ".join(f"{name} ({count})" for name, count in longest[:8])
    return shown + (f" and {len(clips) - 8} more" if len(clips) > 8 else "")


def _best_draw(clips: list[list[Example]], parts: int, seed: int) -> tuple[Ints, bool]:
    """Of many random orders of the clips, the best: each clip's part (0 training), and whether the shares are good."""
    counts = np.array([_counts(clip, clips) for clip in clips], np.float64)  # (clips, images + boxes of each class)
    share = counts / np.maximum(counts.sum(0), 1)
    rng = np.random.default_rng(seed)
    best_cost, best, good = np.inf, np.zeros(len(clips), np.int64), False
    for _ in range(TRIALS):
        chosen = _draw(rng.permutation(len(clips)), share[:, 0], parts)
        has = np.stack([share[chosen == part].sum(0) for part in range(parts + 1)])  # (parts, images + classes)
        usable = bool((has[:, 1:].max(1) > 0).all())
        off = np.abs(has[1:] - SHARE)
        missing = np.count_nonzero(has[:, 1:] == 0)  # classes that a part does not show
        cost = float(off.max(0).mean() + off[:, 0].max()) + missing + (not usable)
        if cost < best_cost:
            best_cost, best = cost, chosen
            good = usable and bool(((has[1:, 0] >= LEAST) & (has[1:, 0] <= MOST)).all())
    return best, good


def _draw(order: Ints, share: Floats, parts: int) -> Ints:
    """The first clips of ``order`` fill part 1 to about its share, the next part 2; the rest is training, 0."""
    chosen = np.zeros(len(order), np.int64)
    start = 0
    for part in range(1, parts + 1):
        if start < len(order):
            end = start + 1 + int(np.abs(np.cumsum(share[order[start:]]) - SHARE).argmin())
            chosen[order[start:end]] = part
            start = end
    return chosen


def _counts(clip: list[Example], clips: list[list[Example]]) -> list[int]:
    most = max((int(e.classes.max(initial=UNSURE)) for them in clips for e in them), default=0)
    classes = np.concatenate([e.classes for e in clip])
    return [len(clip), *(int((classes == number).sum()) for number in range(most + 1))]


def _checked(split: Split) -> Split:
    for part, examples in (("training", split.train), ("validation", split.val)):
        if not any((e.classes >= 0).any() for e in examples):
            raise InputError(
                f"the {part} part ({len(examples)} images) shows no target", "the set", "label more clips, or --clips"
            )
    return split
