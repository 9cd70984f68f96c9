"""Errors against truth, on solutions whose errors are known beforehand."""

from __future__ import annotations

import numpy as np
import pytest

from leadline.evaluation.accuracy import Availability, Row, availability, by_distance, by_stage, compare
from leadline.samples import NS_PER_S, Solution, Stage, Status, Truth
from leadline.target import Cylinder, Plane, Sphere, Surface


def solution(t_s: float, point_m: tuple[float, float, float], sigma_m: float = 0.01, **changes: object) -> Solution:
    point = np.array(point_m)
    values = {"range_m": float(np.linalg.norm(point)), "status": Status.VALID, "stage": Stage.BINOCULAR} | changes
    values = {"cov_m2": np.eye(3) * sigma_m**2} | values
    return Solution(round(t_s * NS_PER_S), position_m=point, range_sigma_m=sigma_m, **values)


def station(t_s: float, centre_m: tuple[float, float, float], radius_m: float = 0.0) -> Truth:
    return Truth(round(t_s * NS_PER_S), centre_m, float(np.linalg.norm(centre_m)) - radius_m)


def test_error_is_measured_minus_true_and_position_is_a_distance() -> None:
    errors = compare([solution(1.0, (0.03, 0, 2.04), range_m=1.85)], [station(1.0, (0, 0, 2), 0.17)])
    assert errors.range_m == pytest.approx([0.02])
    assert errors.position_m == pytest.approx([0.05])
    assert errors.truth_range_m == pytest.approx([1.83])


def test_truth_between_stations_is_interpolated_but_not_over_a_gap() -> None:
    truth = [station(0.0, (0, 0, 2)), station(0.4, (0, 0, 1.6)), station(2.0, (0, 0, 1))]
    errors = compare([solution(t, (0, 0, 1.8)) for t in (-0.1, 0.1, 1.0, 2.1)], truth)
    assert errors.t_s == pytest.approx([0.1])
    assert errors.range_m == pytest.approx([-0.1])


def test_only_valid_solutions_with_known_truth_count() -> None:
    lost = Solution(0, Stage.SEARCHING, Status.LOST)
    coasting = solution(0.0, (0, 0, 2), status=Status.COASTING)
    assert len(compare([lost, coasting], [station(0.0, (0, 0, 2))]).t_s) == 0
    unknown = Truth(0, (float("nan"),) * 3, float("nan"))
    assert len(compare([solution(0.0, (0, 0, 2))], [unknown]).t_s) == 0
    assert by_stage(compare([], [])) == []


def test_own_point_is_where_the_line_of_sight_meets_the_true_surface() -> None:
    """The paper's D to a point 0.1 m off the axis of a ball is right, though the nearest surface is closer."""
    centre, radius = np.array([0.0, 0.0, 1.17]), 0.17
    hit = np.array([0.1, 0.0, 1.17 - np.sqrt(radius**2 - 0.01)])
    errors = compare([solution(0.0, tuple(hit * 1.01))], [station(0.0, tuple(centre), radius)], Sphere(0.34))
    assert errors.own_point_m == pytest.approx([0.01 * np.linalg.norm(hit)])
    assert errors.range_m[0] > 0.03


@pytest.mark.parametrize(
    ("target", "truth", "hit"),
    [
        (Plane(), station(0.0, (0, 0, 2)), (0.4, 0.3, 2.0)),
        (Cylinder(0.5), station(0.0, (0, 0, 2), 0.25), (0.0, 0.6, 1.75)),
    ],
)
def test_own_point_on_plane_and_upright_cylinder(target: object, truth: Truth, hit: tuple[float, float, float]) -> None:
    errors = compare([solution(0.0, hit)], [truth], target)  # type: ignore[arg-type]
    assert errors.own_point_m == pytest.approx([0.0], abs=1e-9)
    assert errors.range_m[0] > 0.01


def test_own_point_falls_back_to_the_nearest_surface() -> None:
    truth = [station(0.0, (0, 0, 2), 0.17)]
    past_the_ball, no_shape = solution(0.0, (1, 0, 2)), solution(0.0, (0, 0, 2))
    assert compare([past_the_ball], truth, Sphere()).own_point_m == pytest.approx([np.sqrt(5) - 1.83])
    assert compare([no_shape], truth, Surface()).own_point_m == pytest.approx([0.17])


def test_stage_rows() -> None:
    errors_m = [0.01, -0.029, 0.02, 0.2]
    stages = [Stage.BINOCULAR, Stage.BINOCULAR, Stage.BOTH, Stage.LASER]
    solutions = [solution(i, (0, 0, 2 + e), stage=s) for i, (e, s) in enumerate(zip(errors_m, stages, strict=True))]
    rows = {row.name: row for row in by_stage(compare(solutions, [station(i, (0, 0, 2)) for i in range(4)]))}
    assert list(rows) == ["1 binocular", "2 both", "3 laser", "all"]
    first = rows["1 binocular"]
    assert (first.count, first.silent) == (2, 0)
    assert (first.mean_m, first.max_m, first.bias_m) == pytest.approx((0.0195, 0.029, -0.0095))
    assert first.coverage == pytest.approx((0.5, 0.5, 1.0))
    assert first.rms_m == pytest.approx(np.sqrt(0.0004705))
    assert rows["3 laser"].silent == 1
    assert rows["all"].count == 4


@pytest.mark.parametrize(("sigma_m", "silent"), [(0.005, 1), (0.009, 0)])
def test_a_silent_error_is_beyond_five_sigmas_and_20_mm(sigma_m: float, silent: int) -> None:
    def row(error_m: float) -> Row:
        return by_stage(compare([solution(0, (0, 0, 2 + error_m), sigma_m)], [station(0, (0, 0, 2))]))[-1]

    assert row(0.04).silent == silent
    assert row(0.0191).silent == 0


def test_distance_rows() -> None:
    ranges = [0.3, 0.4, 1.2, 4.0]
    solutions = [solution(i, (0, 0, r + 0.01)) for i, r in enumerate(ranges)]
    rows = by_distance(compare(solutions, [station(i, (0, 0, r)) for i, r in enumerate(ranges)]))
    assert [(row.name, row.count) for row in rows] == [("0-0.5 m", 2), ("1-1.5 m", 1), ("3-5 m", 1)]
    assert all(row.mean_m == pytest.approx(0.01) for row in rows)


def test_nees_is_one_a_dimension_where_the_covariance_is_true() -> None:
    rng = np.random.default_rng(5)
    solutions = [solution(i, tuple(np.array([0, 0, 2.0]) + rng.normal(0, 0.01, 3))) for i in range(400)]
    truth = [station(i, (0, 0, 2)) for i in range(400)]
    (row,) = by_stage(compare(solutions, truth))[-1:]
    assert row.nees == pytest.approx(1.0, abs=3 * np.sqrt(2 / 1200))  # 3 sigma; half or twice the covariance fails
    doubtful = solution(0, (0, 0, 2), cov_m2=None)
    assert by_stage(compare([doubtful], truth))[-1].nees is None


def test_availability_counts_what_had_a_truth() -> None:
    solutions = [
        solution(0, (0, 0, 2)),
        solution(1, (0, 0, 2), status=Status.COASTING),
        Solution(2 * NS_PER_S, Stage.SEARCHING, Status.LOST),
        solution(9, (0, 0, 2)),
    ]
    rows = availability(solutions, [station(0, (0, 0, 2.1)), station(1, (0, 0, 2.1)), station(2, (0, 0, 0.4))])
    assert rows == [
        Availability("0-0.5 m", 1, 0, 0, 1),
        Availability("1.5-2.2 m", 2, 1, 1, 0),
        Availability("all", 3, 1, 1, 1),
    ]
    assert availability(solutions, []) == []
