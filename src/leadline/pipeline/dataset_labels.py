"""Labels before anybody has labelled: by a detector, or by the laser's spot and the stereo range."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Protocol

import numpy as np

from leadline.config import Config
from leadline.errors import InputError
from leadline.evaluation.plan_sight import box_of, vector_at
from leadline.localizer import Localizer
from leadline.pipeline.build import build_job
from leadline.recognition.detector import Detector
from leadline.recognition.track import iou
from leadline.rig import Rig
from leadline.samples import NS_PER_S, Detection, Kind, LaserRange, Solution, Status, StereoFrame
from leadline.sources import Source, open_source
from leadline.target import Sphere, Target

READING_AGE_S = 0.5
DOUBTFUL = 0.6  # a label that scores less is looked at first
OVERLAP = 0.2  # two boxes with this IoU may be one target
FAINT = 0.1  # what a detector sees below its threshold is a hint at a missed target
OUTLINED, PLACED = 0.9, 0.5  # scores of a ball whose outline was traced, and of one of which only the place is known


@dataclass(frozen=True, slots=True)
class Labels:
    """What is in a frame before anybody looked: boxes, the target's distance where known, what is doubtful about it.

    Not ``known``: nobody can say whether a target is there. Such a frame is not to be taken for an empty one.
    """

    boxes: tuple[Detection, ...] = ()
    range_m: float | None = None
    doubts: tuple[str, ...] = field(default=())
    known: bool = True


UNKNOWN = Labels(known=False)


Labelled = tuple[StereoFrame, Labels]


class Labeller(Protocol):
    """``provenance`` says who made the labels; ``names`` the classes."""

    provenance: str
    names: list[str]

    def open(self, spec: str) -> tuple[Source, Iterator[Labelled]]:
        """A recording and its frames with their labels, in order."""
        ...


class ModelLabeller:
    """By a detector (``model`` None: the shipped one)."""

    def __init__(self, model: Path | None, config: Config, seed: int = 0) -> None:
        self._score, self._seed = config.detector.score, seed
        self._detector = Detector(model, **(config.detector.model_dump() | {"score": min(FAINT, self._score)}))
        self.provenance = Path(self._detector.path).name
        self.names = list(self._detector.names)

    def open(self, spec: str) -> tuple[Source, Iterator[Labelled]]:
        source = open_source(spec, seed=self._seed)
        return source, ((s, self.labels(s)) for s in source if isinstance(s, StereoFrame))

    def labels(self, frame: StereoFrame) -> Labels:
        """What the detector sees in a frame's left image."""
        found = self._detector.find(frame)
        kept = tuple(d for d in found if d.score >= self._score)
        self.names += [d.label for d in kept if d.label not in self.names]  # of a model that does not name its classes
        doubts = []
        if any(d.score < DOUBTFUL for d in kept):
            doubts.append(f"score {min(d.score for d in kept):.2f}")
        if any(iou(a.box_px, b.box_px) > OVERLAP for a, b in combinations(kept, 2)):
            doubts.append("boxes overlap")
        if not kept:
            doubts.append(f"perhaps missed (score {found[0].score:.2f})" if found else "nothing found")
        return Labels(kept, None, tuple(doubts))


class RangeLabeller:
    """By the laser's reading, which says where to look, and by the localizer's solution there: a ball's outline."""

    def __init__(self, target: str | None, rig: str | None, config: Config, name: str, seed: int = 0) -> None:
        if target is not None and not target.startswith("sphere"):  # told before a simulation is set up
            raise _no_box(target)
        self._target, self._rig, self._config, self._seed = target, rig, config, seed
        self.provenance, self.names = "laser and stereo range", [name]

    def open(self, spec: str) -> tuple[Source, Iterator[Labelled]]:
        job = build_job(spec, rig_file=self._rig, target=self._target, config=self._config, seed=self._seed)
        if job.rig.laser is None:
            raise InputError("the rig has no laser", job.source.name, "label by a model: --label model")
        if not isinstance(job.target, Sphere):  # what the simulated scene has, or nothing was said
            raise _no_box(job.target.name)
        return job.source, self._frames(job.source, job.rig, job.target)

    def _frames(self, source: Source, rig: Rig, target: Sphere) -> Iterator[Labelled]:
        beam = BeamFinder(rig, target)
        localizer = Localizer(rig, target, beam, self._config)
        for sample in source:
            if isinstance(sample, LaserRange):
                beam.reading = sample
            solution = localizer.step(sample)
            if isinstance(sample, StereoFrame) and solution is not None:
                yield sample, self._labels(rig, target, solution)

    def _labels(self, rig: Rig, target: Sphere, solution: Solution) -> Labels:
        """The ball's box where it was seen in this very frame."""
        seen = {Kind.STEREO, Kind.SIZE} & set(solution.used)
        if not seen or solution.status is not Status.VALID or solution.position_m is None or solution.range_m is None:
            return UNKNOWN
        radius_m = float(np.linalg.norm(solution.position_m)) - solution.range_m
        box = box_of(rig, Sphere(2 * radius_m), solution.position_m) if radius_m > 0 else None
        if box is None:
            return UNKNOWN
        traced = Kind.SIZE in seen
        label = Detection(box, OUTLINED if traced else PLACED, self.names[0])
        return Labels((label,), solution.range_m, () if traced else ("its outline was not traced",))


def _no_box(target: str) -> InputError:
    return InputError(
        f"a {target.partition(':')[0]} has no box of its own",
        "--target",
        "give sphere:DIAMETER of about the target's size, or --label model",
    )


class BeamFinder:
    """Takes what the laser hits for the target: the box that a target of this kind would have there."""

    def __init__(self, rig: Rig, target: Target) -> None:
        self._rig, self._target = rig, target
        self.reading: LaserRange | None = None

    def find(self, frame: StereoFrame) -> list[Detection]:
        reading = self.reading
        if reading is None or abs(reading.t_ns - frame.t_ns) > READING_AGE_S * NS_PER_S:
            return []
        assert self._rig.laser is not None
        lit_m = self._rig.laser.point_m(reading.range_m)
        box = box_of(self._rig, self._target, vector_at(self._target, lit_m)) if lit_m[2] > 0 else None
        return [] if box is None else [Detection(box, PLACED, "beam")]
