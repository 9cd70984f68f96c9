"""Bundle adjustment: one rig, many boards. Levenberg-Marquardt with the boards' poses eliminated (Schur complement).

Least squares on the corners' pixels, Huber's loss beyond three standard deviations, and Gaussian priors. The noise of
the corners is estimated with the rest, so that priors and pixels weigh against each other as they should.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leadline.geometry import Pose
from leadline.rig import Rig, Side
from leadline.rig_derivatives import Medium, by_parameters, project
from leadline.rig_parameters import get, replaced, turn
from leadline.samples import Array

HUBER = 3.0  # standard deviations of a corner's coordinate; a clean corner is beyond it once in a hundred
_STEPS = 40
_SETTLED = 1e-7  # relative decrease of the cost
_ROUNDS = 6  # of the noise estimate
_SAME_NOISE = 0.01
_MAX_DAMPING = 1e10
_LOWEST = {"port.distance_m": 1e-4, "port.layers[0].thickness_m": 1e-5, "port.layers[0].index": 1.0, "water.index": 1.0}
"""A step that would leave what a port can be stops at its border, so that the other parameters still move."""

WARP_NAMES = ("board.warp_m[0]", "board.warp_m[1]")
"""How far the board's middle stands out of its plane, towards the paper's back, m: bent along its rows, its columns."""


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """A board's corners in one camera: ``points_m`` (n, 3) in the board's frame, ``pixels`` (n, 2), and ``bow`` (n, 2),
    how a bent board moves them (see ``Board.bow``)."""

    view: int
    side: Side
    medium: Medium
    points_m: Array
    pixels: Array
    bow: Array


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of a parameter before the images: mean and standard deviation."""

    mean: float
    sigma: float


@dataclass(frozen=True, eq=False)
class Fit:
    """A rig, the boards' poses T_left_board, and how well they explain the corners.

    names: the parameters estimated, of the rig and, last, WARP_NAMES where the board may be bent: by warp_m (2,).
    residuals: measured minus predicted pixels (n, 2) for each sight, in order. sigma_px: one coordinate's noise,
    estimated. covariance: of ``names``, priors included. cost: half the sum of squares in standard deviations.
    """

    rig: Rig
    poses: tuple[Pose, ...]
    names: tuple[str, ...]
    residuals: tuple[Array, ...]
    sigma_px: float
    cost: float
    covariance: Array
    warp_m: Array

    @property
    def rig_names(self) -> tuple[str, ...]:
        return tuple(name for name in self.names if name not in WARP_NAMES)

    def value(self, name: str) -> float:
        """A parameter's value."""
        return float(self.warp_m[WARP_NAMES.index(name)] if name in WARP_NAMES else get(self.rig, [name])[0])

    @property
    def rms_px(self) -> float:
        """Root mean square distance of a corner from its prediction, as OpenCV counts it."""
        r = np.concatenate(self.residuals)
        return float(np.sqrt((r**2).sum(axis=1).mean()))

    def sigma(self, name: str) -> float:
        """A parameter's standard deviation; 0 for one that was not estimated."""
        if name not in self.names:
            return 0.0
        i = self.names.index(name)
        return float(np.sqrt(self.covariance[i, i]))


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """Sights that one call can project, one after the other: ``places`` in the problem's order, ``views`` by point."""

    side: Side
    medium: Medium
    places: tuple[int, ...]
    ends: NDArray[np.int64]
    views: NDArray[np.int64]
    points_m: Array
    pixels: Array
    bow: Array


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """A rig, R (V, 3, 3) and t (V, 3) of T_left_board, the board's warp (2,); the residuals (n, 2) of each group."""

    rig: Rig
    R: Array
    t: Array
    warp_m: Array
    residuals: tuple[Array, ...] = ()
    cost: float = np.inf

    def on_board(self, group: _Group) -> Array:
        """The group's points (n, 3) turned to the left camera's axes, from their boards' origins."""
        return np.asarray(np.einsum("nij,nj->ni", self.R[group.views], group.points_m) + self.bent(group) @ self.warp_m)

    def bent(self, group: _Group) -> Array:
        """d(the group's points)/d(warp) (n, 3, 2)."""
        return self.R[group.views][:, :, 2, None] * group.bow[:, None, :]


class Problem:
    """Corners to be explained by ``names`` (parameters of the rig, then perhaps WARP_NAMES) and one pose a view."""

    def __init__(self, sights: Sequence[Sight], names: tuple[str, ...], priors: dict[str, Prior] | None = None) -> None:
        self.sights, self.names, self.priors = tuple(sights), names, priors or {}
        self._warped = names[-2:] == WARP_NAMES
        self._rig_names = names[:-2] if self._warped else names
        self._groups = _grouped(self.sights)
        self._lowest = np.array([_LOWEST.get(name, -np.inf) for name in names])

    def solve(self, rig: Rig, poses: Sequence[Pose], *, sigma_px: float | None = None, robust: bool = True) -> Fit:
        """The most likely rig and poses from a start. With ``sigma_px`` the corners' noise is taken as known."""
        state = self._start(rig, poses)
        sigma = sigma_px or _spread(state.residuals)
        for _ in range(_ROUNDS):
            before = sigma
            state = self._minimise(state, sigma, robust)
            if sigma_px is None:
                sigma = self._noise(state, sigma)
            if abs(sigma / before - 1) < _SAME_NOISE:
                break
        covariance = self._system(state, sigma, robust).covariance()
        final = tuple(Pose(R, t) for R, t in zip(state.R, state.t, strict=True))
        residuals = self._by_sight(state.residuals)
        return Fit(state.rig, final, self.names, residuals, sigma, state.cost, covariance, state.warp_m)

    def information(self, rig: Rig, poses: Sequence[Pose], sigma_px: float) -> Array:
        """What these sights would tell of the parameters (G, G), their poses unknown: the inverse of a covariance."""
        return self._system(self._start(rig, poses), sigma_px, False).information()

    def first_step(self, rig: Rig, poses: Sequence[Pose], sigma_px: float) -> tuple[Array, Array]:
        """Where ``names`` would go (G,) in one undamped step, and their covariance (G, G): a test of a wider model."""
        system = self._system(self._start(rig, poses), sigma_px, True)
        return system.step(0.0)[0], system.covariance()

    def _start(self, rig: Rig, poses: Sequence[Pose]) -> _State:
        R, t = np.array([pose.R for pose in poses]), np.array([pose.t_m for pose in poses])
        return self._seen(_State(rig, R, t, np.zeros(2)))

    def _seen(self, state: _State) -> _State:
        """With its residuals: measured minus predicted."""
        residuals = tuple(
            g.pixels - project(state.rig, g.side, g.medium, state.on_board(g) + state.t[g.views])[0]
            for g in self._groups
        )
        return dataclasses.replace(state, residuals=residuals)

    def _values(self, state: _State) -> Array:
        """Of ``names`` (G,)."""
        values = get(state.rig, self._rig_names)
        return np.concatenate([values, state.warp_m]) if self._warped else values

    def _minimise(self, state: _State, sigma: float, robust: bool) -> _State:
        damping = 1e-4
        state = dataclasses.replace(state, cost=self._cost(state, sigma, robust))
        for _ in range(_STEPS):
            system = self._system(state, sigma, robust)
            while damping < _MAX_DAMPING:
                trial = self._stepped(state, *system.step(damping), sigma, robust)
                if trial is not None and trial.cost < state.cost:
                    break
                damping *= 10
            else:
                return state
            gain, state, damping = state.cost - trial.cost, trial, max(damping / 10, 1e-9)
            if gain < _SETTLED * state.cost:
                break
        return state

    def _stepped(self, state: _State, globals_: Array, locals_: Array, sigma: float, robust: bool) -> _State | None:
        """The state after a step; None where there is no such rig (a port behind a pupil)."""
        values = np.maximum(self._values(state) + globals_, self._lowest)
        count = len(self._rig_names)
        try:
            rig = replaced(state.rig, self._rig_names, values[:count])
        except ValueError:
            return None
        R = np.array([turn(step[:3]) @ old for step, old in zip(locals_, state.R, strict=True)])
        warp_m = values[count:] if self._warped else state.warp_m
        trial = self._seen(_State(rig, R, state.t + locals_[:, 3:], warp_m))
        return dataclasses.replace(trial, cost=self._cost(trial, sigma, robust))

    def _by_sight(self, residuals: Sequence[Array]) -> tuple[Array, ...]:
        out: list[Array] = [np.zeros((0, 2))] * len(self.sights)
        for group, r in zip(self._groups, residuals, strict=True):
            for place, part in zip(group.places, np.split(r, group.ends[:-1]), strict=True):
                out[place] = part
        return tuple(out)

    def _cost(self, state: _State, sigma_px: float, robust: bool) -> float:
        e = np.linalg.norm(np.concatenate(state.residuals), axis=1) / sigma_px
        loss = np.where(e <= HUBER, 0.5 * e**2, HUBER * (e - 0.5 * HUBER)) if robust else 0.5 * e**2
        _, miss = self._prior_rows(state)
        total = float(loss.sum() + 0.5 * miss @ miss)
        return total if np.isfinite(total) else np.inf

    def _prior_rows(self, state: _State) -> tuple[Array, Array]:
        """Information (G,) of the priors and their misses (G,) in standard deviations; 0 without one."""
        values = self._values(state)
        weight = np.array([1.0 / self.priors[name].sigma if name in self.priors else 0.0 for name in self.names])
        mean = np.array([self.priors[name].mean if name in self.priors else 0.0 for name in self.names])
        return weight**2, weight * (values - mean)

    def _system(self, state: _State, sigma: float, robust: bool) -> _System:
        information, miss = self._prior_rows(state)
        system = _System(len(self.names), len(state.R))
        system.A += np.diag(information)
        system.a -= np.sqrt(information) * miss
        for group, residuals in zip(self._groups, state.residuals, strict=True):
            self._add_group(system, state, group, residuals, sigma, robust)
        return system

    def _add_group(
        self, system: _System, state: _State, group: _Group, residuals: Array, sigma: float, robust: bool
    ) -> None:
        turned_m = state.on_board(group)
        points = turned_m + state.t[group.views]
        pixels, by_point = project(state.rig, group.side, group.medium, points)
        by_globals = by_parameters(state.rig, group.side, group.medium, points, pixels, by_point, self._rig_names)
        if self._warped:
            by_globals = np.concatenate([by_globals, by_point @ state.bent(group)], axis=2)
        by_turn = np.cross(turned_m[:, None, :], by_point)  # J (w x p) = w . (p x J)
        e = np.linalg.norm(residuals, axis=1) / sigma
        root = np.sqrt(np.minimum(1.0, HUBER / np.maximum(e, 1e-12)) if robust else np.ones_like(e)) / sigma
        G = by_globals * root[:, None, None]
        P = np.concatenate([by_turn, by_point], axis=2) * root[:, None, None]
        r = residuals * root[:, None]
        starts = np.concatenate([[0], group.ends[:-1]]).astype(int)
        for place, start, end in zip(group.places, starts, group.ends.astype(int), strict=True):
            part = slice(start, end)
            width = len(self.names)
            system.add(
                self.sights[place].view,
                G[part].reshape(2 * (end - start), width),
                P[part].reshape(-1, 6),
                r[part].ravel(),
            )

    def _noise(self, state: _State, sigma: float) -> float:
        """One coordinate's standard deviation: from the corners within Huber's bound, for the parameters spent."""
        lengths = np.linalg.norm(np.concatenate(state.residuals), axis=1)
        for _ in range(_ROUNDS):  # the bound moves with the answer
            sigma = self._noise_within(lengths / sigma, len(state.R)) * sigma
        return sigma

    def _noise_within(self, e: Array, views: int) -> float:
        """The next estimate of the noise, relative to the one that the lengths (N,) are given in."""
        inside = e <= HUBER
        spent = len(self.names) + 6 * views
        freedom = max(2 * int(inside.sum()) - spent, 1)
        # a clean corner beyond the bound is left out of the sum: what that takes away is put back
        b2 = HUBER**2 / 2
        kept = 1 - b2 * np.exp(-b2) / (1 - np.exp(-b2))
        return float(np.sqrt((e[inside] ** 2).sum() / freedom / kept)) or 1e-6


def _grouped(sights: Sequence[Sight]) -> list[_Group]:
    groups: dict[tuple[Side, Medium], list[int]] = {}
    for i, sight in enumerate(sights):
        groups.setdefault((sight.side, sight.medium), []).append(i)
    out = []
    for (side, medium), places in groups.items():
        counts = [len(sights[i].pixels) for i in places]
        views = np.repeat([sights[i].view for i in places], counts)
        points = np.concatenate([sights[i].points_m for i in places])
        pixels = np.concatenate([sights[i].pixels for i in places])
        bow = np.concatenate([sights[i].bow for i in places])
        out.append(_Group(side, medium, tuple(places), np.cumsum(counts), views, points, pixels, bow))
    return out


def _spread(residuals: Sequence[Array]) -> float:
    """A start for the noise that bad corner sets do not move: the median distance is 1.177 standard deviations."""
    return max(float(np.median(np.linalg.norm(np.concatenate(residuals), axis=1))) / 1.177, 1e-9)


class _System:
    """Normal equations in blocks: A (G, G) globals, B[v] (6, 6) poses, C[v] (G, 6) between them; a, b right sides."""

    def __init__(self, width: int, views: int) -> None:
        self.A, self.a = np.zeros((width, width)), np.zeros(width)
        self.B, self.b = np.zeros((views, 6, 6)), np.zeros((views, 6))
        self.C = np.zeros((views, width, 6))

    def add(self, view: int, G: Array, P: Array, r: Array) -> None:
        self.A += G.T @ G
        self.a += G.T @ r
        self.B[view] += P.T @ P
        self.b[view] += P.T @ r
        self.C[view] += G.T @ P

    def step(self, damping: float) -> tuple[Array, Array]:
        """The damped step of the globals (G,) and of the poses (V, 6)."""
        B = self.B * (1 + damping * np.eye(6)) + 1e-12 * np.eye(6)
        solved = np.linalg.solve(B, np.concatenate([self.C.transpose(0, 2, 1), self.b[:, :, None]], axis=2))
        BC, Bb = solved[:, :, :-1], solved[:, :, -1]
        A = self.A + damping * np.diag(np.diag(self.A)) - np.einsum("vgk,vkh->gh", self.C, BC)
        a = self.a - np.einsum("vgk,vk->g", self.C, Bb)
        globals_ = _solve(A, a)
        return globals_, Bb - BC @ globals_

    def information(self) -> Array:
        """Of the globals, the poses marginalised."""
        BC = np.linalg.solve(self.B + 1e-12 * np.eye(6), self.C.transpose(0, 2, 1))
        out: Array = self.A - np.einsum("vgk,vkh->gh", self.C, BC)
        return out

    def covariance(self) -> Array:
        """Of the globals, the poses marginalised."""
        A = self.information()
        if not len(A):
            return A
        scale = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
        inverse = np.linalg.pinv(A * np.outer(scale, scale), rcond=1e-14, hermitian=True)
        out: Array = inverse * np.outer(scale, scale)
        return 0.5 * (out + out.T)


def _solve(A: Array, a: Array) -> Array:
    """Scaled to a unit diagonal first: the parameters' units differ by 1e6."""
    if not len(a):
        return a
    scale = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
    out: Array = scale * np.linalg.lstsq(A * np.outer(scale, scale), scale * a, rcond=1e-15)[0]
    return out
