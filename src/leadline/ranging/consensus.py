"""A shape with no idea where it is: many candidates from few points each, the one that most points support.

The target may be a minority of the points: a pile before water and sand. A candidate is judged only by the points whose
rays meet it: those on it support it, those before or behind it speak against it. What two different shapes explain
equally well is told apart by nothing, and refused. Deterministic: which points make a candidate follows from their
number alone (Fischler and Bolles 1981, with a low-discrepancy sequence in place of chance).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from leadline.ranging.shape_fit import Mask, Points, across, descend, trim
from leadline.samples import Array
from leadline.target import Cylinder, Plane, Sphere, Target

SAMPLES = 400
ANGLES = 8  # of a cylinder's axis about the line of sight
MOST_FRONTS = 40
ROUNDS, STEPS = 6, 4
POLISHED = 12  # shapes through a part of the supporting points
SIZES = (0.5, 1.0, 1.6)  # radii tried, over the expected one
REFINED = 6  # candidates followed to their end
TOLERANCE = 0.15  # of the radius: how well a candidate made from one point knows its place
AGAINST = 0.3  # what a point before or behind a shape takes from its support
NEAR = 3.0  # sigmas within which a point is on a shape
SAME = 0.5  # share of points in common by which two shapes are rivals for the same thing
RIVAL = 0.9  # of the best support
NEARER = 0.7  # of the best support is enough for something nearer


@dataclass(frozen=True, slots=True)
class _Held:
    """A refined shape, what supports it, and the points (N,) on it."""

    x: Array
    support: float
    on_it: Mask


def start(target: Target, points: Points) -> tuple[Array, Mask] | None:
    """The nearest well supported shape and the points (N,) whose rays meet it; None where there is none, or not one."""
    if len(points.length_m) < 3 + len(target.shape_mean):
        return None
    candidates = _candidates(target, points)
    support, on_it = _support(target, points, candidates, _tolerance(target, points))
    held = [h for i in _distinct(support, on_it) if (h := _refine(target, points, candidates[i])) is not None]
    best = max(held, key=lambda h: h.support, default=None)
    if best is None or best.support <= 0:
        return None
    good = [h for h in held if h.support > NEARER * best.support]
    nearest = min(good, key=lambda h: target.range(h.x)[0])
    chosen = nearest if _common(nearest.on_it, best.on_it) < SAME else best
    if any(_contests(target, points, h, chosen) for h in held):
        return None
    chosen = _polish(target, points, chosen)
    if np.count_nonzero(chosen.on_it) < 2 * len(chosen.x) + 2:  # fewer may agree by chance
        return None
    return chosen.x, _apart(target, points, chosen.x[None], _tolerance(target, points))[1][0]


def _sequence(count: int, dimensions: int) -> Array:
    """(count, dimensions) in 0..1, evenly spread: the additive recurrence of the generalised golden ratio (Roberts)."""
    root = 2.0
    for _ in range(30):
        root = (1 + root) ** (1 / (dimensions + 1))
    return np.asarray((0.5 + np.arange(1, count + 1)[:, None] / root ** np.arange(1, dimensions + 1)) % 1.0)


def _candidates(target: Target, points: Points) -> Array:
    """(K, 3 + k) shapes through a few points each."""
    if isinstance(target, Plane):
        return _planes(points.p_m)
    if isinstance(target, Cylinder):
        fronts = _fronts(target, points)
        angles = np.linspace(-np.pi / 2, np.pi / 2, ANGLES, endpoint=False)
        turned = np.repeat(fronts, ANGLES, axis=0)
        turned[:, 3] = np.tile(angles, len(fronts))
        return turned
    fronts = _fronts(target, points)
    return fronts if len(target.shape_mean) == 0 else np.concatenate([fronts, _balls(points.p_m)])


def _fronts(target: Target, points: Points) -> Array:
    """Shapes whose nearest place is one of the points, of every size that is tried."""
    every = -(-len(points.length_m) // MOST_FRONTS)
    p, directions, k = points.p_m[::every], points.directions[::every], len(target.shape_mean)
    sized = target.shape_mean if k and not (isinstance(target, Cylinder) and target.diameter_m) else None
    found = []
    for size in SIZES if sized is not None else (1.0,):
        x = np.zeros((len(p), 3 + k))
        x[:, 3:] = target.shape_mean
        if sized is not None:
            x[:, -1] *= size
        x[:, :3] = p + directions * np.array([_radius(target, row) for row in x])[:, None]
        found.append(x)
    return np.concatenate(found)


def _radius(target: Target, x: Array) -> float:
    return target.radius_m(x) if isinstance(target, Sphere | Cylinder) else 0.0


def _planes(p_m: Array) -> Array:
    """Feet (K, 3) of planes through three points each: m.p = 1, foot = m / m^2."""
    picked = p_m[(_sequence(SAMPLES, 3) * len(p_m)).astype(int)]
    m = _solved(picked, np.ones(picked.shape[:2]))
    return np.asarray(m / np.einsum("ni,ni->n", m, m)[:, None])


def _balls(p_m: Array) -> Array:
    """Balls (K, 4) through four points each: p^2 - 2 p.c + (c^2 - r^2) = 0 is linear."""
    picked = p_m[(_sequence(SAMPLES, 4) * len(p_m)).astype(int)]
    rows = np.concatenate([2 * picked, np.ones((*picked.shape[:2], 1))], axis=2)
    solved = _solved(rows, np.einsum("nki,nki->nk", picked, picked))
    centre = solved[:, :3]
    square = solved[:, 3] + np.einsum("ni,ni->n", centre, centre)
    balls = np.column_stack([centre, np.sqrt(np.maximum(square, 0.0))])
    good = (balls[:, 3] > 0.02) & (balls[:, 3] < 2.0) & (np.linalg.norm(centre, axis=1) > balls[:, 3])
    return np.asarray(balls[good & (balls[:, 2] > 0)])


def _solved(rows: Array, values: Array) -> Array:
    """(K, n) solutions of K small systems; those of points that repeat or line up left out."""
    sound = np.linalg.cond(rows) < 1e6
    return np.asarray(np.linalg.solve(rows[sound], values[sound][:, :, None])[:, :, 0])


def _tolerance(target: Target, points: Points) -> Array:
    """(N,) how far from a candidate a point may lie: its own error, and the candidate's."""
    own = TOLERANCE * _radius(target, np.concatenate([np.zeros(3), target.shape_mean]))
    return np.hypot(points.sigma_m, own or 0.01 * points.length_m)


def _support(target: Target, points: Points, x: Array, sigma_m: Array) -> tuple[Array, Mask]:
    """Support (K,) of shapes by the points whose rays meet them, and which points (K, N) are on them."""
    distance, met = _apart(target, points, x, sigma_m)
    u2 = (distance / sigma_m) ** 2
    on_it = met & (u2 < NEAR**2)
    return np.where(on_it, 1 - u2 / NEAR**2, np.where(met, -AGAINST, 0.0)).sum(axis=1), on_it


def _apart(target: Target, points: Points, x: Array, sigma_m: Array) -> tuple[Array, Mask]:
    """Distances (K, N) of points from shapes, and whether their rays meet them."""
    p, d, centre = points.p_m, points.directions, x[:, :3]
    if isinstance(target, Plane):
        length = np.linalg.norm(x, axis=1, keepdims=True)
        distance = length - (x / length) @ p.T
        return distance, np.abs(distance) < NEAR * sigma_m  # beside a wall's end is water: nothing speaks against it
    square = (p**2).sum(axis=1) - 2 * centre @ p.T + (centre**2).sum(axis=1)[:, None]
    radius = np.array([_radius(target, row) for row in x])[:, None]
    if isinstance(target, Cylinder):
        axes = np.array([target.axis(row) for row in x])
        from_centre = np.cross(centre, axes) @ d.T + axes @ np.cross(p, d).T  # (p - c) . (d x a)
        passes = from_centre**2 < radius**2 * (1 - (axes @ d.T) ** 2)
        square -= (axes @ p.T - (axes * centre).sum(axis=1)[:, None]) ** 2
    else:
        along = (p * d).sum(axis=1) - centre @ d.T
        passes = square - along**2 < radius**2
    return np.sqrt(np.maximum(square, 0)) - radius, passes


def _distinct(support: Array, on_it: Mask) -> list[int]:
    """The best supported candidates, each by other points than the better ones or by another part of them."""
    chosen: list[int] = []
    for i in np.argsort(-support, kind="stable"):
        if support[i] <= 0 or len(chosen) == REFINED:
            break
        if all(_common(on_it[i], on_it[j]) < 0.8 for j in chosen):
            chosen.append(int(i))
    return chosen


def _common(a: Mask, b: Mask) -> float:
    """Share of the points of either that are points of both."""
    return float(np.count_nonzero(a & b) / (np.count_nonzero(a | b) + 1e-9))


def _refine(target: Target, points: Points, x: Array) -> _Held | None:
    """Follow a candidate to the points near it, ever nearer: those that are not its own fall behind."""
    sigma = _tolerance(target, points)
    for _ in range(ROUNDS):
        near = _support(target, points, x[None], sigma)[1][0]
        if np.count_nonzero(near) < 3 + len(target.shape_mean):
            return None
        found = descend(target, points.pick(near), x, iterations=STEPS)
        if found is None:
            return None
        x, sigma = found, np.maximum(sigma / 2, across(target, points, found, 0.0))
    return _judge(target, points, x)


def _judge(target: Target, points: Points, x: Array) -> _Held:
    """Support by the points' own errors alone."""
    support, on_it = _support(target, points, x[None], across(target, points, x, 0.0))
    return _Held(x, float(support[0]), on_it[0])


def _polish(target: Target, points: Points, held: _Held) -> _Held:
    """The best of shapes through a few of the supporting points: a wrong one among all of them can hold a fit aside."""
    own = np.flatnonzero(held.on_it)
    few = 2 * (3 + len(target.shape_mean))
    for row in (_sequence(POLISHED, few) * len(own)).astype(int):
        x = descend(target, points.pick(np.isin(np.arange(len(held.on_it)), own[row])), held.x, iterations=STEPS)
        if x is not None:
            held = max(held, _judge(target, points, x), key=lambda h: h.support)
    return held


def _contests(target: Target, points: Points, other: _Held, chosen: _Held) -> bool:
    """Whether another shape explains the same points about as well, and lies elsewhere."""
    if other.support < RIVAL * chosen.support or _common(other.on_it, chosen.on_it) < SAME:
        return False
    mine, theirs = (trim(target, points.pick(h.on_it), h.x) for h in (chosen, other))
    if mine is None or theirs is None:
        return False
    (a, gradient), (b, _) = (target.range(f.x) for f in (mine, theirs))
    return abs(a - b) > NEAR * float(np.sqrt(gradient @ (mine.cov + theirs.cov) @ gradient))
