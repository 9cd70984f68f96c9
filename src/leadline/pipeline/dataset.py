"""`leadline dataset`: a varied set of pre-labelled frames out of recordings.

Recordings are gone through twice: every frame is looked at and forgotten, then the chosen ones are written. A long dive
thus needs no more memory than a short one.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from leadline.errors import InputError
from leadline.pipeline.dataset_choice import OCTAVES, Candidate, candidate, choose_frames
from leadline.pipeline.dataset_files import Item, write_set
from leadline.pipeline.dataset_labels import Labeller
from leadline.pipeline.dataset_preview import write_preview
from leadline.samples import StereoFrame
from leadline.sources import Source, count_notices
from leadline.wire.dive_writer import new_folder
from leadline.wire.images import SUFFIX, encode_jpeg, image_format

Progress = Callable[[int, int | None], None]


@dataclass(frozen=True, slots=True)
class DatasetReport:
    """What was drawn. ``sizes``: (name, frames looked at, frames chosen) by the target's size; ``first``: how many
    frames ought to be looked at first; ``notices`` a line each."""

    out: Path
    looked_at: int
    items: list[Item]
    sizes: list[tuple[str, int, int]]
    first: int
    notices: list[str] = field(default_factory=list)


def draw_dataset(
    recordings: Sequence[str],
    out: Path,
    labeller: Labeller,
    *,
    count: int = 200,
    progress: Progress = lambda done, total: None,
) -> DatasetReport:
    """Draw at most ``count`` frames (left images) from recordings into a new folder, with labels by ``labeller``.

    InputError where a recording cannot be used, no frame is in it, or ``out`` holds something.
    """
    opened = [labeller.open(spec) for spec in recordings]
    sources = [source for source, _ in opened]
    for source in sources:
        if source.live:
            raise InputError("this is live, not a recording", source.name, "record it: leadline run ... --record")
    new_folder(out)
    candidates: list[Candidate] = []
    notices: list[str] = []
    total = 0
    for number, (source, frames) in enumerate(opened):
        looked_at = unknown = 0
        for frame, labels in frames:
            if labels.known:
                candidates.append(candidate(number, looked_at, frame, labels))
            unknown += not labels.known
            looked_at += 1
            progress(looked_at, source.frame_count)
        if not looked_at:
            raise InputError("no frame can be read", source.name, "give a recording with images")
        if unknown == looked_at:
            raise InputError("the target's range is known in no frame", source.name, "label by a model: --label model")
        if unknown:
            notices.append(f"{source.name}: {unknown} frames left out, as the target's range is not known there")
        notices += [f"{source.name}: {n} {kind}" for kind, n in count_notices(source.notices).items() if kind != "late"]
        total += looked_at
    chosen = choose_frames(candidates, count)
    if len(chosen) < count:
        notices.append(f"{len(chosen)} frames, not {count}: the others are blurred or look like one of these")
    names = _names(recordings)
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.name}.") as beside:
        folder = Path(beside) / "set"
        items = _write_images(folder, sources, chosen, names)
        write_set(folder, items, labeller.names, labeller.provenance)
        write_preview(folder, items, labeller.provenance)
        for made in folder.iterdir():  # whole or not at all: an interrupted one leaves an empty folder
            shutil.move(made, out / made.name)
    seen, kept = (Counter(c.size for c in some) for some in (candidates, chosen))
    sizes = [(name, seen[k], kept[k]) for k, name in enumerate(OCTAVES) if seen[k]]
    return DatasetReport(out, total, items, sizes, sum(bool(i.labels.doubts) for i in items), notices)


def _names(recordings: Sequence[str]) -> list[str]:
    """A short name for each recording, told apart: the folder's or the file's."""
    paths = [Path(spec.replace("sim:", "sim_")).resolve() for spec in recordings]
    plain = [re.sub(r"[^\w-]+", "_", path.stem).strip("_") or "recording" for path in paths]
    return [name if plain.count(name) == 1 else f"{name}_{chr(97 + k)}" for k, name in enumerate(plain)]


def _write_images(
    folder: Path, sources: Sequence[Source], chosen: Sequence[Candidate], names: Sequence[str]
) -> list[Item]:
    """Each source once more, up to its last chosen frame. A name's number counts the chosen frames: to `leadline train`
    a jump in the numbers would be another clip."""
    (folder / "images").mkdir(parents=True)
    items: list[Item] = []
    for recording, source in enumerate(sources):
        wanted = {c.number: c for c in chosen if c.recording == recording}
        if not wanted:
            continue
        frames = (s for s in source if isinstance(s, StereoFrame))
        for number, frame in zip(range(max(wanted) + 1), frames, strict=False):
            if number not in wanted:
                continue
            data = frame.encoded[0] if frame.encoded else encode_jpeg(frame.left)
            order = sum(item.recording == names[recording] for item in items)
            file = f"{names[recording]}_{order:04d}{SUFFIX.get(image_format(data), '.jpg')}"
            (folder / "images" / file).write_bytes(data)
            size = (frame.left.shape[1], frame.left.shape[0])
            items.append(Item(file, size, names[recording], frame.t_ns, wanted[number].labels))
    return items
