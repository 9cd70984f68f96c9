"""Solutions against truth: errors by stage and by distance, and whether the stated uncertainty was honest.

Error = measured - true. A range error is against the nearest point of the surface. The paper's D is the distance to a
point of its own choice (box centre, spot), so its error is given against that point too: where the surface lies along
the same line of sight.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from leadline.samples import NS_PER_S, Array, Solution, Stage, Status, Truth
from leadline.target import Cylinder, Plane, Sphere, Target

MAX_GAP_S = 0.5  # truth is interpolated between stations no farther apart
SILENT_SIGMAS, SILENT_M = 5.0, 0.020  # an error beyond both, in a solution that calls itself valid, is a silent one
DISTANCE_EDGES_M = (0.0, 0.5, 1.0, 1.5, 2.2, 3.0, 5.0, float("inf"))
STAGE_NAMES = {
    Stage.SEARCHING: "0 searching",
    Stage.BINOCULAR: "1 binocular",
    Stage.BOTH: "2 both",
    Stage.LASER: "3 laser",
}


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Valid solutions whose truth is known, each array (N,): times, stages, true nearest range, errors, stated sigma.

    ``own_point_m``: range error against the surface along the solution's own line of sight (against the nearest point
    where that line misses the target). ``position_m``: distance from the true position.
    """

    t_s: Array
    stage: NDArray[np.int64]
    truth_range_m: Array
    range_m: Array
    own_point_m: Array
    position_m: Array
    sigma_m: Array
    nees: Array


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a table of errors, metres: mean, largest and RMS size, mean with its sign, median stated sigma.

    ``coverage``: the shares of errors within one, two and three stated sigmas (honest: 68, 95, 99.7 %). ``nees``: mean
    over the three dimensions (honest: 1), None without stated covariances.
    """

    name: str
    count: int
    mean_m: float
    max_m: float
    rms_m: float
    bias_m: float
    sigma_m: float
    coverage: tuple[float, float, float]
    nees: float | None
    silent: int


@dataclass(frozen=True, slots=True)
class Availability:
    """How many solutions at times of known truth were valid, coasting, lost."""

    name: str
    count: int
    valid: int
    coasting: int
    lost: int


def compare(solutions: Sequence[Solution], truth: Sequence[Truth], target: Target | None = None) -> Errors:
    """Join by time stamp; between two stations the truth is interpolated. Solutions that are not valid are left out."""
    times = [station.t_ns for station in truth]
    rows = []
    for solution in solutions:
        station = _truth_at(solution.t_ns, times, truth)
        if solution.status is not Status.VALID or station is None or not np.isfinite(station[3]):
            continue
        if solution.position_m is None or solution.range_m is None or solution.range_sigma_m is None:
            continue
        error = solution.range_m - station[3]
        along = _surface_along(solution.position_m, station, target)
        rows.append(
            (
                solution.t_s,
                int(solution.stage),
                station[3],
                error,
                solution.range_m - along if np.isfinite(along) else error,
                float(np.linalg.norm(solution.position_m - station[:3])),
                solution.range_sigma_m,
                _nees(solution.position_m - station[:3], solution.cov_m2),
            )
        )
    columns = np.array(rows, dtype=np.float64).reshape(-1, 8).T
    return Errors(columns[0], columns[1].astype(np.int64), *columns[2:])


def _nees(error_m: Array, cov_m2: Array | None) -> float:
    if cov_m2 is None or np.linalg.matrix_rank(cov_m2) < len(error_m):
        return float("nan")
    return float(error_m @ np.linalg.solve(cov_m2, error_m))


def by_stage(errors: Errors, *, own_point: bool = False) -> list[Row]:
    """A row for each stage that occurs, and one for all; none without truth."""
    groups = [(STAGE_NAMES[stage], errors.stage == stage) for stage in Stage]
    return _rows(errors, [*groups, ("all", np.full(len(errors.stage), True))], own_point)


def by_distance(errors: Errors, edges_m: Sequence[float] = DISTANCE_EDGES_M, *, own_point: bool = False) -> list[Row]:
    """A row for each bin of true range that occurs."""
    return _rows(errors, _bins(errors.truth_range_m, edges_m), own_point)


def availability(
    solutions: Sequence[Solution], truth: Sequence[Truth], edges_m: Sequence[float] = DISTANCE_EDGES_M
) -> list[Availability]:
    """A row for each bin of true range that occurs, and one for all; none without truth."""
    times = [station.t_ns for station in truth]
    stations = [_truth_at(solution.t_ns, times, truth) for solution in solutions]
    known = [(s.status, float(t[3])) for s, t in zip(solutions, stations, strict=True) if t is not None]
    status, range_m = np.array([s for s, _ in known], dtype=object), np.array([r for _, r in known], dtype=np.float64)
    groups = [*_bins(range_m, edges_m), ("all", np.isfinite(range_m))]
    return [
        Availability(name, int(chosen.sum()), *(int((status[chosen] == s).sum()) for s in Status))
        for name, chosen in groups
        if chosen.any()
    ]


def _bins(range_m: Array, edges_m: Sequence[float]) -> list[tuple[str, NDArray[np.bool_]]]:
    return [(f"{low:g}-{high:g} m", (range_m >= low) & (range_m < high)) for low, high in pairwise(edges_m)]


def _rows(errors: Errors, groups: Sequence[tuple[str, NDArray[np.bool_]]], own_point: bool) -> list[Row]:
    error = errors.own_point_m if own_point else errors.range_m
    return [
        _row(name, error[chosen], errors.sigma_m[chosen], errors.nees[chosen])
        for name, chosen in groups
        if chosen.any()
    ]


def _row(name: str, error_m: Array, sigma_m: Array, nees: Array) -> Row:
    size = np.abs(error_m)
    known = nees[np.isfinite(nees)]
    return Row(
        name=name,
        count=len(size),
        mean_m=float(size.mean()),
        max_m=float(size.max()),
        rms_m=float(np.sqrt((size**2).mean())),
        bias_m=float(error_m.mean()),
        sigma_m=float(np.median(sigma_m)),
        coverage=(_share(size, sigma_m), _share(size, 2 * sigma_m), _share(size, 3 * sigma_m)),
        nees=float(known.mean()) / 3 if len(known) else None,
        silent=int(((size > SILENT_SIGMAS * sigma_m) & (size > SILENT_M)).sum()),
    )


def _share(size_m: Array, limit_m: Array) -> float:
    return float((size_m <= limit_m).mean())


def _truth_at(t_ns: int, times: Sequence[int], truth: Sequence[Truth]) -> Array | None:
    """x, y, z, range (4,) at a time; None outside the stations, or where they are too far apart."""
    after = bisect_left(times, t_ns)
    if after == len(times):
        return None
    if times[after] == t_ns:
        return _numbers(truth[after])
    if after == 0 or times[after] - times[after - 1] > MAX_GAP_S * NS_PER_S:
        return None
    weight = (t_ns - times[after - 1]) / (times[after] - times[after - 1])
    between: Array = (1 - weight) * _numbers(truth[after - 1]) + weight * _numbers(truth[after])
    return between


def _numbers(station: Truth) -> Array:
    return np.array([*station.position_m, station.range_m])


def _surface_along(point_m: Array, station: Array, target: Target | None) -> float:
    """Distance from the left pupil to the true surface in a point's direction; NaN where it misses or is unknown.

    The true size follows from position and range. A cylinder's axis is not in the truth: it is taken as upright.
    """
    centre_m, radius_m = station[:3], float(np.linalg.norm(station[:3]) - station[3])
    if isinstance(target, Plane):
        shape: Target = Plane()
    elif isinstance(target, Sphere) and radius_m > 0:  # a truth that is none of a ball's has no radius
        shape = Sphere(2 * radius_m)
    elif isinstance(target, Cylinder) and radius_m > 0:
        shape = Cylinder(2 * radius_m)
    else:
        return float("nan")
    x = np.concatenate([centre_m, [0.0]]) if isinstance(shape, Cylinder) else centre_m
    sight = point_m / np.linalg.norm(point_m)
    return float(shape.beam_length(x, np.zeros((1, 3)), sight[None])[0][0])
