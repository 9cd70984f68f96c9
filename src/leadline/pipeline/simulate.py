"""``leadline sim``: a simulated dive as a folder that ``leadline run`` takes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from leadline.pipeline.loop import Progress
from leadline.samples import Sample, StereoFrame
from leadline.simulation.dive import SimulatedDive
from leadline.wire.dive_writer import write_dive


def write_simulated_dive(
    scenario: str,
    out: Path,
    *,
    seed: int = 0,
    images: Literal["png", "jpeg"] = "png",
    progress: Progress = lambda done, total: None,
) -> int:
    """Write the dive with its rig and its truth; the number of frames. InputError for an unknown scenario or a full
    folder."""
    dive = SimulatedDive(scenario, seed)
    frames = 0

    def counted() -> Iterator[Sample]:
        nonlocal frames
        for sample in dive.samples():
            yield sample
            if isinstance(sample, StereoFrame):
                frames += 1
                progress(frames, dive.frame_count)

    write_dive(out, counted(), rig=dive.rig, truth=dive.truth, details=dive.details, images=images)
    return frames
