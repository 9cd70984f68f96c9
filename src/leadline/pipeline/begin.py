"""Does a source begin? Until it has, nothing is written and nothing of an earlier run is taken away."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

from leadline.errors import InputError
from leadline.rig import Rig
from leadline.samples import NS_PER_S, Sample, StereoFrame
from leadline.sources import Source, frame_size
from leadline.sources.sync import arrival_ns

FIRST_FRAME_S = 1.0  # readings wait so long for a frame beside them: one of another size is a mistake in the call
OPENING_S = 15.0  # and so long for a device that is being opened: two streams that do not answer take 10 s


def begun(source: Source, rig: Rig) -> Iterator[Sample]:
    """All samples of a source that has begun. InputError where it cannot, or where its images are not the rig's."""
    samples = _of_size(source, rig)
    first: list[Sample] = []
    for sample in samples:
        first.append(sample)
        waited_s = (arrival_ns(sample) - arrival_ns(first[0])) / NS_PER_S
        if isinstance(sample, StereoFrame) or waited_s > (FIRST_FRAME_S if source.opened else OPENING_S):
            break
    return chain(first, samples)


def _of_size(source: Source, rig: Rig) -> Iterator[Sample]:
    """A source checks what it knows beforehand; a frame of another size must not slip through to the geometry."""
    wanted = (rig.left.width, rig.left.height)
    for sample in source:
        if isinstance(sample, StereoFrame) and frame_size(sample) != wanted:
            size = frame_size(sample)
            raise InputError(
                f"the image is {size[0]}x{size[1]}, the rig's left camera is {wanted[0]}x{wanted[1]}",
                f"frame {sample.name or sample.t_s}", "give the rig that was calibrated at this image size",
            )  # fmt: skip
        yield sample
