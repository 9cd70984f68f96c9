"""Spots in the dirtiest simulated water: caustics, snow, blur, glowing beams; and such pictures with a dark laser."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from leadline.ranging.beam import BeamRanger
from leadline.recognition.spot import NoSpot, Spot, find_spot
from leadline.rig import Side
from leadline.samples import Image, StereoFrame
from leadline.simulation.dive import SimulatedDive
from leadline.simulation.scenario import Scenario
from leadline.target import Sphere

TARGET = Sphere(0.34)
NEARER, ASIDE_PX = (0.85, 1.0, 1.15), (-14.0, 0.0, 14.0)


def dive(seed: int, rate_hz: float, power: float) -> SimulatedDive:
    stress = Scenario.load("stress")
    parts = {
        "laser": stress.laser.model_copy(update={"power": power}),
        "camera": stress.camera.model_copy(update={"rate_hz": rate_hz}),
        "faults": (),
    }
    return SimulatedDive(stress.model_copy(update=parts), seed)


def pictures(shown: SimulatedDive) -> Iterator[tuple[StereoFrame, dict[str, Any]]]:
    """Every frame with its truth."""
    for sample in shown.samples():
        if isinstance(sample, StereoFrame):
            yield sample, next(one for one in reversed(shown.details["frames"]) if one["name"] == sample.name)


def claimed(shown: SimulatedDive) -> Iterator[Spot | NoSpot]:
    """What is found in every picture, looked for at three distances and where two shifted beams would be, too."""
    ranger = BeamRanger(shown.rig, TARGET)
    for frame, truth in pictures(shown):
        sides: tuple[tuple[Side, Image], ...] = (("left", frame.left), ("right", frame.right))
        for scale in NEARER:
            sought = ranger.sought(scale * np.array(truth["position_m"]))
            for side, image in sides if sought is not None else ():
                assert sought is not None
                one = sought[side]
                for aside in ASIDE_PX:
                    found = find_spot(image, one.curve_px + np.array([0.0, aside]), one.shape_px2, one.beam_px_m)
                    if isinstance(found, Spot) or "out of the picture" not in found.reason:
                        yield found


def test_a_dark_laser_has_no_spot() -> None:
    found = list(claimed(dive(11, 0.7, 0.0)))
    assert len(found) > 100
    assert not [one for one in found if isinstance(one, Spot)]


@pytest.mark.long
def test_a_thousand_pictures_of_a_dark_laser() -> None:
    """False spots in at most one of a thousand places looked at; 1,134 pictures, over 6,000 places."""
    found = [one for seed in range(11, 18) for one in claimed(dive(seed, 5.0, 0.0))]
    assert len(found) > 6000
    assert sum(isinstance(one, Spot) for one in found) <= 0.001 * len(found)


def test_a_spot_that_can_be_seen_is_found() -> None:
    """Left pictures (the truth is of their time) with the spot on the ball at 0.3 to 1.8 m: none missed."""
    shown = dive(1, 1.5, Scenario.load("stress").laser.power)
    ranger, seen = BeamRanger(shown.rig, TARGET), 0
    for frame, truth in pictures(shown):
        spot = truth["spot"]
        if not spot or not spot["on_target"] or not spot["left_px"] or not 0.3 < spot["length_m"] < 1.8:
            continue
        truth_px = np.array(spot["left_px"])
        if (truth_px < 8).any() or (truth_px > np.array([frame.left.shape[1], frame.left.shape[0]]) - 9).any():
            continue
        sought = ranger.sought(np.array(truth["position_m"]))
        assert sought is not None
        one = sought["left"]
        found = find_spot(frame.left, one.curve_px, one.shape_px2, one.beam_px_m)
        assert isinstance(found, Spot), f"{frame.name}: {found}"
        assert np.linalg.norm(one.middle(found.q_px, found.spread) - truth_px) < 1.0
        seen += 1
    assert seen > 6
