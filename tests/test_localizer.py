"""The localizer on simulated dives: right on every shape, honest, and suspicious of a rig that is wrong.

Small pictures (640 x 360), a few seconds from 0.9 to 0.4 m at 0.1 m/s.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest

from leadline.config import Config
from leadline.localizer import Localizer
from leadline.localizer.sight import Sight
from leadline.rig import Rig
from leadline.rig_parameters import get, replaced
from leadline.samples import Kind, Sample, Solution, Stage
from leadline.simulation.dive import SimulatedDive
from leadline.target import Cylinder, Plane, Sphere, Surface, Target
from short_dives import TrueBoxes, cut, range_errors, samples

CASES: list[tuple[str, Target, float]] = [  # scenario, target, bound of the mean error, m
    ("hull", Plane(), 0.003),
    ("pile", Cylinder(0.5), 0.003),
    ("lump", Surface(), 0.015),
    ("demo", Sphere(0.34), 0.003),
    ("demo", Sphere(), 0.003),
]


def dive_of(scene: str) -> SimulatedDive:
    return cut(scene, 0.9, 0.4, 2.5, 0.1)


def solve(
    dive: SimulatedDive, target: Target, *, rig: Rig | None = None, inputs: Sequence[Sample] = (), filtered: bool = True
) -> list[Solution]:
    """A hull and a pile are the whole view; what stands free is boxed."""
    finder = None if isinstance(target, Plane | Cylinder) else TrueBoxes(dive)
    localizer = Localizer(rig or dive.rig, target, finder, filtered=filtered)
    solutions = [localizer.step(sample) for sample in inputs or samples(dive)]
    return [solution for solution in solutions if solution is not None]


def turned_away(solutions: Sequence[Solution], *kinds: Kind) -> int:
    return sum(one.kind in kinds for solution in solutions for one in solution.rejected)


@pytest.mark.parametrize(("scene", "target", "mean_m"), CASES, ids=lambda v: v.name if hasattr(v, "name") else str(v))
def test_every_shape_is_ranged_and_no_error_is_silent(scene: str, target: Target, mean_m: float) -> None:
    dive = dive_of(scene)
    solutions = solve(dive, target)
    error, sigma = range_errors(solutions, dive)
    assert len(error) == len(samples(dive))
    assert np.abs(error).mean() < mean_m
    assert not ((np.abs(error) > 5 * sigma) & (np.abs(error) > 0.020)).any()
    assert np.median(sigma) < 0.010
    assert {kind for solution in solutions for kind in solution.used} >= {Kind.STEREO, Kind.SPOT, Kind.LASER}
    assert all(solution.stage is Stage.BOTH for solution in solutions[3:])


@pytest.mark.parametrize("filtered", [True, False])
def test_with_the_right_rig_nothing_is_turned_away(filtered: bool) -> None:
    solutions = solve(dive_of("demo"), Sphere(0.34), filtered=filtered)
    assert turned_away(solutions, *Kind) == 0


def wrong_index(rig: Rig) -> Rig:
    return replaced(rig, ["water.index"], get(rig, ["water.index"]) - 0.02)


def tilted(rig: Rig, axis: int) -> Rig:
    """The port turned by 3 degrees, towards x or y."""
    assert rig.port is not None
    normal = np.array([0.0, 0.0, np.cos(np.deg2rad(3))])
    normal[axis] = np.sin(np.deg2rad(3))
    return dataclasses.replace(rig, port=dataclasses.replace(rig.port, normal=normal))


@pytest.mark.parametrize("filtered", [True, False])
@pytest.mark.parametrize("fault", ["index", "tilt-x", "tilt-y"])
def test_a_wrong_rig_is_noticed(fault: str, filtered: bool) -> None:
    """Spot, laser and stereo do not fit together any more: on the right rig none is turned away."""
    dive = dive_of("demo")
    rig = wrong_index(dive.rig) if fault == "index" else tilted(dive.rig, int(fault == "tilt-y"))
    solutions = solve(dive, Sphere(0.34), rig=rig, filtered=filtered)
    assert turned_away(solutions, Kind.SPOT, Kind.LASER, Kind.STEREO) >= 5


def test_a_small_box_of_a_known_ball_tells_how_far_off_it_is() -> None:
    """At 5 m a ball of 0.34 m is seen under four degrees: nothing may hold its first idea nearer than that."""
    rig, ball, radius_m = Rig.load("rendered"), Sphere(0.34), 0.17
    centre = np.array([0.1, 0.05, 5.0])
    rim = [centre + radius_m * np.array(way) for way in ([1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0])]
    q_px = rig.project(np.array(rim))[0]
    (x, y), (width, height) = q_px.min(axis=0), np.ptp(q_px, axis=0)
    idea = Sight(rig, ball, Config(), None)._idea((float(x), float(y), float(width), float(height)))
    assert np.linalg.norm(idea - centre) < 0.05


def test_a_target_in_words_is_refused_when_the_localizer_is_made() -> None:
    with pytest.raises(TypeError, match=r"Sphere\(0\.34\), or leadline\.target\.parse_target\('sphere:0\.34'\)"):
        Localizer(Rig.load("rendered"), "sphere:0.34")  # type: ignore[arg-type]
