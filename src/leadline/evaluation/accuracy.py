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
SILENT_SIGMAS, SILENT_M = 5.0, 0.030  # an error beyond both, in a solution that calls itself valid, is a silent one
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


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a table of errors, metres. ``coverage``: the share of errors within two stated sigmas."""

    name: str
    count: int
    mean_m: float
    max_m: float
    rms_m: float
    sigma_m: float
    coverage: float
    silent: int


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
            )
        )
    columns = np.array(rows, dtype=np.float64).reshape(-1, 7).T
    return Errors(columns[0], columns[1].astype(np.int64), *columns[2:])


def by_stage(errors: Errors, *, own_point: bool = False) -> list[Row]:
    """A row for each stage that occurs, and one for all; none without truth."""
    groups = [(STAGE_NAMES[stage], errors.stage == stage) for stage in Stage]
    return _rows(errors, [*groups, ("all", np.full(len(errors.stage), True))], own_point)


def by_distance(errors: Errors, edges_m: Sequence[float] = DISTANCE_EDGES_M, *, own_point: bool = False) -> list[Row]:
    """A row for each bin of true range that occurs."""
    r = errors.truth_range_m
    bins = [(f"{low:g}-{high:g} m", (r >= low) & (r < high)) for low, high in pairwise(edges_m)]
    return _rows(errors, bins, own_point)


def _rows(errors: Errors, groups: Sequence[tuple[str, NDArray[np.bool_]]], own_point: bool) -> list[Row]:
    error = errors.own_point_m if own_point else errors.range_m
    return [_row(name, error[chosen], errors.sigma_m[chosen]) for name, chosen in groups if chosen.any()]


def _row(name: str, error_m: Array, sigma_m: Array) -> Row:
    size = np.abs(error_m)
    return Row(
        name=name,
        count=len(size),
        mean_m=float(size.mean()),
        max_m=float(size.max()),
        rms_m=float(np.sqrt((size**2).mean())),
        sigma_m=float(np.median(sigma_m)),
        coverage=float((size <= 2 * sigma_m).mean()),
        silent=int(((size > SILENT_SIGMAS * sigma_m) & (size > SILENT_M)).sum()),
    )


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
    if isinstance(target, Sphere):
        shape: Target = Sphere(2 * radius_m)
    elif isinstance(target, Plane):
        shape = Plane()
    elif isinstance(target, Cylinder):
        shape = Cylinder(2 * radius_m)
    else:
        return float("nan")
    x = np.concatenate([centre_m, [0.0]]) if isinstance(shape, Cylinder) else centre_m
    sight = point_m / np.linalg.norm(point_m)
    return float(shape.beam_length(x, np.zeros((1, 3)), sight[None])[0][0])
