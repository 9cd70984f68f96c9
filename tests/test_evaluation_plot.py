"""The picture and the summary of runs that have little to show."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from leadline.evaluation.accuracy import compare
from leadline.evaluation.plot import Curve, Picture, plot_run
from leadline.evaluation.running import Stamps, Tally
from leadline.evaluation.summary import accuracy, pixel_cost_m
from leadline.rig import Rig
from leadline.samples import NS_PER_S, Kind, Rejected, Solution, Stage, Status, Truth

TRUTH = [Truth(i * NS_PER_S, (0.0, 0.0, 2.0 - 0.1 * i), 2.0 - 0.1 * i) for i in range(10)]
NOWHERE = [Truth(0, (float("nan"),) * 3, float("nan"))]


def lost(i: int) -> Solution:
    return Solution(i * NS_PER_S, Stage.SEARCHING, Status.LOST, rejected=(Rejected(Kind.STEREO, 0, "no match"),))


def found(i: int, error_m: float = 0.001) -> Solution:
    point = np.array([0, 0, 2.0 - 0.1 * i + error_m])
    stage = Stage(1 + i % 3)
    return Solution(i * NS_PER_S, stage, Status.VALID, point, np.eye(3) * 1e-6, point[2], 0.001, used=(Kind.LASER,))


@pytest.mark.parametrize(
    ("solutions", "truth"),
    [
        ([], []),
        ([lost(0)], []),
        ([lost(0), lost(1)], TRUTH),
        ([found(0)], NOWHERE),
        ([lost(0), found(1), lost(2), found(3, 5.0)], TRUTH),
        ([found(i) for i in range(10)], TRUTH),
    ],
)
def test_every_run_has_a_picture(tmp_path: Path, solutions: Sequence[Solution], truth: Sequence[Truth]) -> None:
    curve = Curve("fused", solutions, compare(solutions, truth))
    other = Curve("paper", solutions[:1], compare(solutions[:1], truth), own_point=True)
    for picture in (Picture("alone", curve, truth), Picture("two", curve, truth, np.array([[0.5, 1.9]]), other)):
        plot_run(tmp_path / "run.png", picture)
        image = cv2.imread(str(tmp_path / "run.png"))
        assert image is not None
        assert image.shape[1] > 1000


def test_wall_clock_stamps_are_counted_from_the_start(tmp_path: Path) -> None:
    """With 1.7e9 on the axis nobody could read it; matplotlib would also lose the milliseconds."""
    t_ns = 1_700_000_000 * NS_PER_S
    solutions = [Solution(t_ns + i * NS_PER_S // 20, Stage.SEARCHING, Status.LOST) for i in range(3)]
    plot_run(tmp_path / "late.png", Picture("", Curve("fused", solutions, compare(solutions, []))))
    early = [Solution(i * NS_PER_S // 20, Stage.SEARCHING, Status.LOST) for i in range(3)]
    plot_run(tmp_path / "early.png", Picture("", Curve("fused", early, compare(early, []))))
    late_px, early_px = (cv2.imread(str(tmp_path / name)) for name in ("late.png", "early.png"))
    rows = slice(0, int(0.94 * late_px.shape[0]))  # all but the axis' name
    assert np.array_equal(late_px[rows], early_px[rows])


def test_summary_counts() -> None:
    counted = Tally([lost(0), found(1), found(2, 0.01)]).summary()
    assert counted["status"] == {"valid": 2, "coasting": 0, "lost": 1}
    assert counted["stages"] == {"0": 1, "1": 0, "2": 1, "3": 1}
    assert counted["used"] == {"laser": 2}
    assert counted["rejected"] == {"stereo: no match": 1}
    assert counted["range_m"]["max"] == pytest.approx(1.901)
    assert Tally().summary()["range_sigma_m"] is None


def test_rates_and_accuracy_of_nothing() -> None:
    assert Stamps([0, NS_PER_S // 2, NS_PER_S]).rate_hz == pytest.approx(2.0)
    assert Stamps([5]).rate_hz is None
    assert Stamps([]).rate_hz is None
    assert accuracy(compare([found(1)], [])) is None


def test_a_pixel_costs_what_the_pinhole_formula_says() -> None:
    """Z^2 / (f b) in water, to the few per cent that the port changes."""
    cost = pixel_cost_m(Rig.load("rendered"), 2.2)
    assert cost == pytest.approx(2.2**2 / (1.335 * 1400 * 0.063), rel=0.02)
    assert pixel_cost_m(Rig.load("rendered"), 0.005) is None  # inside the port
