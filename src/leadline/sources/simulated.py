"""``sim:SCENARIO``: a simulated dive as a source."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from leadline.samples import Sample
from leadline.simulation.dive import SimulatedDive
from leadline.simulation.scenario import Scenario
from leadline.sources.base import Source


class SimulatedSource(Source):
    """A shipped scenario's name or a YAML file. InputError where it is neither, or names the key that is wrong."""

    def __init__(self, scenario: Scenario | str | Path, *, seed: int = 0, real_time: bool = False) -> None:
        self.dive = SimulatedDive(scenario, seed)
        rig = self.dive.rig
        super().__init__(
            f"sim:{self.dive.scenario.name}",
            rig=rig,
            truth=self.dive.truth,
            frame_count=self.dive.frame_count,
            image_size=(rig.left.width, rig.left.height),
            real_time=real_time,
        )

    @property
    def details(self) -> dict[str, Any]:
        """Boxes, spots, readings' kinds: complete when an iteration has ended."""
        return self.dive.details

    def read(self) -> Iterator[Sample]:
        return self.dive.samples()
