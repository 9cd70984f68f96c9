"""Bundle adjustment: one rig, many boards. Levenberg-Marquardt with the boards' poses eliminated (Schur complement).

Least squares on the corners' pixels, Huber's loss beyond three standard deviations, and Gaussian priors. The noise of
the corners is estimated with the rest, so that priors and pixels weigh against each other as they should.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from leadline.calibration.derivatives import Medium, by_parameters, project
from leadline.geometry import Pose
from leadline.rig import Rig, Side
from leadline.rig_parameters import get, replaced, turn
from leadline.samples import Array

HUBER = 3.0  # standard deviations of a corner's coordinate; a clean corner is beyond it once in a hundred
_STEPS = 40
_SETTLED = 1e-7  # relative decrease of the cost
_ROUNDS = 6  # of the noise estimate
_MAX_DAMPING = 1e10


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """A board's corners in one camera: ``points_m`` (n, 3) in the board's frame, ``pixels`` (n, 2)."""

    view: int
    side: Side
    medium: Medium
    points_m: Array
    pixels: Array


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of a parameter before the images: mean and standard deviation."""

    mean: float
    sigma: float


@dataclass(frozen=True, eq=False)
class Fit:
    """A rig, the boards' poses T_left_board, and how well they explain the corners.

    residuals: measured minus predicted pixels (n, 2) for each sight, in order. sigma_px: one coordinate's noise,
    estimated. covariance: of ``names``, priors included. cost: half the sum of squares in standard deviations.
    """

    rig: Rig
    poses: tuple[Pose, ...]
    names: tuple[str, ...]
    residuals: tuple[Array, ...]
    sigma_px: float
    cost: float
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))

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


@dataclass(frozen=True, eq=False)
class Problem:
    """Corners to be explained by ``names`` (parameters of the rig) and one pose a view."""

    sights: Sequence[Sight]
    names: tuple[str, ...]
    priors: dict[str, Prior] = field(default_factory=dict)

    def solve(self, rig: Rig, poses: Sequence[Pose], *, sigma_px: float | None = None, robust: bool = True) -> Fit:
        """The most likely rig and poses from a start. With ``sigma_px`` the corners' noise is taken as known."""
        residuals = self._residuals(rig, poses)
        fit = Fit(rig, tuple(poses), self.names, residuals, sigma_px or _spread(residuals), np.inf)
        for _ in range(_ROUNDS):
            before = fit.sigma_px
            fit = self._minimise(fit, robust)
            if sigma_px is None:
                fit = dataclasses.replace(fit, sigma_px=self._noise(fit))
            if abs(fit.sigma_px / before - 1) < 0.01:
                break
        return dataclasses.replace(fit, covariance=self._covariance(fit, robust))

    def _minimise(self, fit: Fit, robust: bool) -> Fit:
        damping, sigma = 1e-4, fit.sigma_px
        fit = dataclasses.replace(fit, cost=self._cost(fit.rig, fit.residuals, sigma, robust))
        for _ in range(_STEPS):
            system = self._system(fit, robust)
            while damping < _MAX_DAMPING:
                trial = self._stepped(fit, *system.step(damping), robust)
                if trial is not None and trial.cost < fit.cost:
                    break
                damping *= 10
            else:
                return fit
            gain, fit, damping = fit.cost - trial.cost, trial, max(damping / 10, 1e-9)
            if gain < _SETTLED * fit.cost:
                break
        return fit

    def _stepped(self, fit: Fit, globals_: Array, locals_: Array, robust: bool) -> Fit | None:
        """The fit after a step; None where there is no such rig (a port behind a pupil) or a corner cannot be seen."""
        try:
            rig = replaced(fit.rig, self.names, get(fit.rig, self.names) + globals_)
        except ValueError:
            return None
        poses = tuple(
            Pose(turn(step[:3]) @ pose.R, pose.t_m + step[3:]) for pose, step in zip(fit.poses, locals_, strict=True)
        )
        residuals = self._residuals(rig, poses)
        cost = self._cost(rig, residuals, fit.sigma_px, robust)
        return dataclasses.replace(fit, rig=rig, poses=poses, residuals=residuals, cost=cost)

    def _residuals(self, rig: Rig, poses: Sequence[Pose]) -> tuple[Array, ...]:
        out: list[Array] = [np.zeros((0, 2))] * len(self.sights)
        for side, medium, members in self._groups():
            points = [poses[self.sights[i].view].apply(self.sights[i].points_m) for i in members]
            predicted, _ = project(rig, side, medium, np.concatenate(points))
            ends = np.cumsum([len(p) for p in points])[:-1]
            for i, q in zip(members, np.split(predicted, ends), strict=True):
                out[i] = self.sights[i].pixels - q
        return tuple(out)

    def _groups(self) -> list[tuple[Side, Medium, list[int]]]:
        """Sights that one call can project."""
        groups: dict[tuple[Side, Medium], list[int]] = {}
        for i, sight in enumerate(self.sights):
            groups.setdefault((sight.side, sight.medium), []).append(i)
        return [(side, medium, members) for (side, medium), members in groups.items()]

    def _cost(self, rig: Rig, residuals: Sequence[Array], sigma_px: float, robust: bool) -> float:
        e = np.linalg.norm(np.concatenate(residuals), axis=1) / sigma_px
        loss = np.where(e <= HUBER, 0.5 * e**2, HUBER * (e - 0.5 * HUBER)) if robust else 0.5 * e**2
        _, miss = self._prior_rows(rig)
        total = float(loss.sum() + 0.5 * miss @ miss)
        return total if np.isfinite(total) else np.inf

    def _prior_rows(self, rig: Rig) -> tuple[Array, Array]:
        """Information (G,) of the priors and their misses (G,) in standard deviations; 0 without one."""
        values = get(rig, self.names)
        weight = np.array([1.0 / self.priors[name].sigma if name in self.priors else 0.0 for name in self.names])
        mean = np.array([self.priors[name].mean if name in self.priors else 0.0 for name in self.names])
        return weight**2, weight * (values - mean)

    def _system(self, fit: Fit, robust: bool) -> _System:
        information, miss = self._prior_rows(fit.rig)
        system = _System(len(self.names), len(fit.poses))
        system.A += np.diag(information)
        system.a -= np.sqrt(information) * miss
        for side, medium, members in self._groups():
            self._add_group(system, fit, side, medium, members, robust)
        return system

    def _add_group(
        self, system: _System, fit: Fit, side: Side, medium: Medium, members: list[int], robust: bool
    ) -> None:
        turned_m = [self.sights[i].points_m @ fit.poses[self.sights[i].view].R.T for i in members]
        points = [p + fit.poses[self.sights[i].view].t_m for p, i in zip(turned_m, members, strict=True)]
        counts = [len(p) for p in points]
        stacked = np.concatenate(points)
        pixels, by_point = project(fit.rig, side, medium, stacked)
        by_globals = by_parameters(fit.rig, side, medium, stacked, pixels, by_point, self.names)
        by_turn = np.cross(np.concatenate(turned_m)[:, None, :], by_point)  # J (w x p) = w . (p x J)
        by_pose = np.concatenate([by_turn, by_point], axis=2)
        residuals = np.concatenate([fit.residuals[i] for i in members])
        e = np.linalg.norm(residuals, axis=1) / fit.sigma_px
        root = np.sqrt(np.minimum(1.0, HUBER / np.maximum(e, 1e-12)) if robust else np.ones_like(e)) / fit.sigma_px
        G, P, r = by_globals * root[:, None, None], by_pose * root[:, None, None], residuals * root[:, None]
        start = 0
        for i, count in zip(members, counts, strict=True):
            part = slice(start, start + count)
            width = len(self.names)
            system.add(self.sights[i].view, G[part].reshape(-1, width), P[part].reshape(-1, 6), r[part].ravel())
            start += count

    def _noise(self, fit: Fit) -> float:
        """One coordinate's standard deviation: from the corners within Huber's bound, for the parameters spent."""
        e = np.linalg.norm(np.concatenate(fit.residuals), axis=1) / fit.sigma_px
        inside = e <= HUBER
        spent = len(self.names) + 6 * len(fit.poses)
        freedom = max(2 * int(inside.sum()) - spent, 1)
        # a clean corner beyond the bound is left out of the sum: what that takes away is put back
        b2 = HUBER**2 / 2
        kept = 1 - b2 * np.exp(-b2) / (1 - np.exp(-b2))
        return float(fit.sigma_px * np.sqrt((e[inside] ** 2).sum() / freedom / kept)) or 1e-12

    def _covariance(self, fit: Fit, robust: bool) -> Array:
        return self._system(fit, robust).covariance()


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

    def covariance(self) -> Array:
        """Of the globals, the poses marginalised."""
        BC = np.linalg.solve(self.B + 1e-12 * np.eye(6), self.C.transpose(0, 2, 1))
        A = self.A - np.einsum("vgk,vkh->gh", self.C, BC)
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
