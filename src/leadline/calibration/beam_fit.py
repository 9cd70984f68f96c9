"""Fit of a rig's parameters to stations of a laser's spot: maximum a posteriori, with what stays uncertain.

Each station has four pixel coordinates and a mean reading, and one unknown of its own, the length L along the beam;
and, where asked for, matches of other texture, each one number without an unknown. Parameters are either free
(estimated, from a prior) or merely considered: held, but their uncertainty goes into the result (Schmidt, 1966). With K
the gain of the free ones and H = dz/dparameters (whitened, L eliminated), errors go as

    e+ = [[I - K H_free, -K H_held], [0, I]] e + [K, 0] v

so one formula gives the covariance of a laser calibrated with an uncertain rig and of a rig refined by its laser.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from leadline.calibration.beam_model import by_length, by_names, expected
from leadline.calibration.matches import misses_by_names, misses_px
from leadline.calibration.spots import Station
from leadline.rig import Rig
from leadline.rig_covariance import RigCovariance
from leadline.rig_parameters import get, replaced
from leadline.samples import Array

DIRECTION = tuple(f"laser.direction[{i}]" for i in range(3))
ORIGIN = tuple(f"laser.origin_m[{i}]" for i in range(3))
SUSPECT_SIGMAS = 2.5
FITS_BETTER = 0.5  # a station is left out if the others then fit at least twice as well (chi2 over its freedom)
_STATED = 5.0
MATCH_SIGMA_PX = 0.1
LEAST_MATCH = 0.5  # of that: matches of one texture are wrong alike
_JITTER = 1e-10  # of correlations: parameters of a joint fit can be all but one
ROUNDING_M = 0.001 / np.sqrt(12)  # devices give millimetres; a static mean cannot be trusted far below


@dataclass(frozen=True, slots=True, eq=False)
class BeamFit:
    """The rig after the fit, with its covariance; what was used, left out (name, why), and how well it fits."""

    rig: Rig
    stations: tuple[Station, ...]
    left_out: tuple[tuple[str, str], ...]
    pixel_residuals_px: Array  # (N, 4): left u, v, right u, v
    range_residuals_m: Array  # (N,)
    range_sigmas_m: Array  # (N,), of the mean readings, as the residuals showed them
    lengths_m: Array  # (N,)
    chi2: float
    dof: int

    @property
    def pixel_rms(self) -> float:
        return float(np.sqrt(np.mean(self.pixel_residuals_px**2)))

    @property
    def range_rms_m(self) -> float:
        return float(np.sqrt(np.mean(self.range_residuals_m**2)))

    def sigma(self, name: str) -> float:
        return float(np.sqrt(self.rig.covariance.of((name,))[0, 0]))


def fit_beam(rig: Rig, stations: Sequence[Station], free: tuple[str, ...], prior: RigCovariance) -> BeamFit:
    """Fit ``free`` parameters of a rig with a laser, starting at and drawn to its values as ``prior`` says.

    prior: the covariance of all that is uncertain, free or not; a free parameter must have one. Stations that do not
    fit are left out, one at a time; then the noise is taken as large as the residuals of the rest show it.
    """
    used, left_out = list(stations), []
    problem = _Problem(rig, used, free, prior, Noise())
    x, lengths = problem.solve()
    while len(used) > 3:
        misfit = problem.misfit(x, lengths)
        worst = int(np.argmax(misfit))
        if misfit[worst] < SUSPECT_SIGMAS:
            break
        others = _Problem(rig, used[:worst] + used[worst + 1 :], free, prior, Noise())
        there = others.solve()
        if others.reduced_chi2(*there) > FITS_BETTER * problem.reduced_chi2(x, lengths):
            break
        left_out.append((used[worst].name, f"{misfit[worst]:.0f} sigma off the beam that the others agree on"))
        del used[worst]
        problem, (x, lengths) = others, there
    for _ in range(2):
        problem = _Problem(rig, used, free, prior, problem.noise(x, lengths))
        x, lengths = problem.solve(x, lengths)
    chi2, dof = problem.chi2(x, lengths)
    pixels, ranges = problem.residuals(x, lengths)
    result = problem.result(x, lengths)
    return BeamFit(result, tuple(used), tuple(left_out), pixels, ranges, problem.range_sigmas_m, lengths, chi2, dof)


@dataclass(frozen=True, slots=True)
class Noise:
    """Factors on the stated sigmas of a spot's pixels and of a mean reading."""

    pixel: float = 1.0
    range: float = 1.0
    match: float = 1.0


class _Problem:
    def __init__(
        self, rig: Rig, stations: Sequence[Station], free: tuple[str, ...], prior: RigCovariance, noise: Noise
    ) -> None:
        self._rig, self._free, self._prior, self._noise = rig, free, prior, noise
        self._held = tuple(name for name in prior.names if name not in free)
        self._start, self._basis = get(rig, free), _basis(rig, free)
        self._measured = np.array([[*s.left.q_px, *s.right.q_px, s.raw_m] for s in stations])
        self._matches = np.concatenate([s.matches_px for s in stations])
        self._match_sigma = noise.match * MATCH_SIGMA_PX
        pixel_sigma = noise.pixel * np.array([_pixel_sigmas(s) for s in stations])
        assert rig.laser is not None
        alone = max(rig.laser.range_sigma_m, 1e-4)
        counts = np.array([s.readings for s in stations])
        self._sigma = np.column_stack([pixel_sigma, noise.range * np.hypot(alone / np.sqrt(counts), ROUNDING_M)])
        within = self._basis.T @ prior.of(free) @ self._basis
        scale = np.sqrt(np.diag(within))
        self._prior_x = within
        self._to_x = scale  # the fit runs in units of the prior's sigmas
        correlation = within / np.outer(scale, scale) + _JITTER * np.eye(len(scale))
        self._whiten = np.linalg.inv(np.linalg.cholesky(correlation))
        self._count = len(scale)

    @property
    def range_sigmas_m(self) -> Array:
        """Of the stations' mean readings (N,)."""
        return self._sigma[:, 4]

    def solve(self, x: Array | None = None, lengths_m: Array | None = None) -> tuple[Array, Array]:
        """Free parameters (k,) in their own coordinates, and lengths (N,), m; from where they are known roughly."""
        first = np.zeros(self._count) if x is None else x / self._to_x
        lengths = self._first_lengths() if lengths_m is None else lengths_m
        start = np.concatenate([first, lengths])
        fit = least_squares(self._vector, start, self._jacobian, x_scale="jac", ftol=1e-7, xtol=1e-7)
        return fit.x[: self._count] * self._to_x, fit.x[self._count :]

    def rig(self, x: Array) -> Rig:
        return replaced(self._rig, self._free, self._start + self._basis @ x)

    def residuals(self, x: Array, lengths_m: Array) -> tuple[Array, Array]:
        off = self._off(self.rig(x), lengths_m)
        return off[:, :4], off[:, 4]

    def misfit(self, x: Array, lengths_m: Array) -> Array:
        """Each station's root of chi2 over its degrees of freedom (N,)."""
        return np.asarray(np.sqrt(np.sum(self._white(self.rig(x), lengths_m) ** 2, axis=1) / 4))

    def chi2(self, x: Array, lengths_m: Array) -> tuple[float, int]:
        rows = self._rows(self.rig(x), lengths_m)
        pull = self._whiten @ (x / self._to_x)
        return float(rows @ rows + pull @ pull), rows.size - len(lengths_m)

    def reduced_chi2(self, x: Array, lengths_m: Array) -> float:
        chi2, dof = self.chi2(x, lengths_m)
        return chi2 / max(dof, 1)

    def noise(self, x: Array, lengths_m: Array) -> Noise:
        """What the residuals say the noise is, beside what was stated (which counts as _STATED observations)."""
        missed = float(np.sum(self._missed(self.rig(x)) ** 2))
        match = self._noise.match * np.sqrt((missed + _STATED) / (len(self._matches) + _STATED))
        rows = self._white(self.rig(x), lengths_m) ** 2
        freedom = 1 - self._leverages(self.rig(x), lengths_m)
        pixel, reading = (
            np.sqrt((np.sum(rows[:, part]) + _STATED) / (np.sum(freedom[:, part]) + _STATED))
            for part in (slice(0, 4), slice(4, 5))
        )
        reading = self._noise.range * max(1.0, reading)
        return Noise(float(self._noise.pixel * pixel), float(reading), max(float(match), LEAST_MATCH))

    def _leverages(self, rig: Rig, lengths_m: Array) -> Array:
        """The share of each residual (N, 5) that the parameters and lengths take up (the hat matrix's diagonal)."""
        n, k = len(lengths_m), self._count
        design = self._design(rig, lengths_m)
        information = design.T @ design
        information[:k, :k] += _inverse(self._prior_x)
        shares = np.sum(design * _solve(information, design.T).T, axis=1)
        return np.asarray(shares[: 5 * n].reshape(n, 5))

    def result(self, x: Array, lengths_m: Array) -> Rig:
        """The rig at the solution, with the joint covariance of everything that was uncertain."""
        rig = self.rig(x)
        q = self._without_lengths(rig, lengths_m)
        h_free = q @ self._gradient(rig, self._free, lengths_m) @ self._basis
        h_held = q @ self._gradient(rig, self._held, lengths_m)
        information = h_free.T @ h_free + _inverse(self._prior_x)
        gain = _solve(information, h_free.T)
        k, m = self._count, len(self._held)
        spread = np.block([[np.eye(k) - gain @ h_free, -gain @ h_held], [np.zeros((m, k)), np.eye(m)]])
        before = self._joint_prior()
        after = spread @ before @ spread.T
        after[:k, :k] += gain @ gain.T
        lift = np.block([
            [self._basis, np.zeros((len(self._free), m))],
            [np.zeros((m, k)), np.eye(m)],
        ])  # fmt: skip
        cov = lift @ after @ lift.T
        covariance = RigCovariance(self._free + self._held, (cov + cov.T) / 2)
        return _with_covariance(rig, covariance)

    def _joint_prior(self) -> Array:
        names = self._free + self._held
        m = len(self._held)
        drop = np.block([
            [self._basis.T, np.zeros((self._count, m))],
            [np.zeros((m, len(self._free))), np.eye(m)],
        ])  # fmt: skip
        return np.asarray(drop @ self._prior.of(names) @ drop.T)

    def _first_lengths(self) -> Array:
        assert self._rig.laser is not None
        points, _ = self._rig.triangulate(self._measured[:, :2], self._measured[:, 2:4])
        along = (points - self._rig.laser.origin_m) @ self._rig.laser.direction
        read = (self._measured[:, 4] - self._rig.laser.range_offset_m) / (
            self._rig.laser.range_scale * self._rig.laser.group_index
        )
        return np.where(np.isfinite(along) & (along > 0), along, read)

    def _vector(self, scaled: Array) -> Array:
        x, lengths = scaled[: self._count] * self._to_x, scaled[self._count :]
        pull = self._whiten @ scaled[: self._count]
        try:
            rows = self._rows(self.rig(x), lengths)
        except ValueError:  # a step to where no rig is: an index below 1, a port behind the camera
            rows = np.full(self._measured.size + len(self._matches), 1e6)
        return np.concatenate([np.nan_to_num(rows, nan=1e6), pull])

    def _jacobian(self, scaled: Array) -> Array:
        """d(_vector)/d(scaled) (5N + M + k, k + N)."""
        x, lengths = scaled[: self._count] * self._to_x, scaled[self._count :]
        rows = -self._design(self.rig(x), lengths)
        rows[:, : self._count] *= self._to_x
        pull = np.hstack([self._whiten, np.zeros((self._count, len(lengths)))])
        return np.concatenate([np.nan_to_num(rows), pull])

    def _design(self, rig: Rig, lengths_m: Array) -> Array:
        """d(whitened measurements)/d(free parameters in their coordinates, lengths) (5N + M, k + N)."""
        n, k = len(lengths_m), self._count
        gradient = self._gradient(rig, self._free, lengths_m) @ self._basis
        out = np.hstack([gradient, np.zeros((len(gradient), n))])
        for i, slope in enumerate(self._length_slopes(rig, lengths_m)):
            out[i * 5 : (i + 1) * 5, k + i] = slope
        return out

    def _rows(self, rig: Rig, lengths_m: Array) -> Array:
        """All whitened residuals: the stations' (5N), then the matches'."""
        return np.concatenate([self._white(rig, lengths_m).ravel(), self._missed(rig)])

    def _missed(self, rig: Rig) -> Array:
        if not len(self._matches):
            return np.zeros(0)
        return misses_px(rig, self._matches) / self._match_sigma

    def _off(self, rig: Rig, lengths_m: Array) -> Array:
        """Measured minus expected (N, 5): pixels, then the reading."""
        return np.asarray(self._measured - expected(rig, lengths_m))

    def _white(self, rig: Rig, lengths_m: Array) -> Array:
        return np.asarray(self._off(rig, lengths_m) / self._sigma)

    def _without_lengths(self, rig: Rig, lengths_m: Array) -> Array:
        """(4N + M, 5N + M): what of the residuals no choice of the lengths can explain; matches have no length."""
        slopes = self._length_slopes(rig, lengths_m)
        n, width = slopes.shape
        m = len(self._matches)
        out = np.zeros((n * (width - 1) + m, n * width + m))
        out[n * (width - 1) :, n * width :] = np.eye(m)
        for i, slope in enumerate(slopes):
            null = np.linalg.svd(slope[None])[2][1:]
            out[i * (width - 1) : (i + 1) * (width - 1), i * width : (i + 1) * width] = null
        return out

    def _length_slopes(self, rig: Rig, lengths_m: Array) -> Array:
        """d(whitened measurements)/d(own length) (N, 5)."""
        return np.asarray(by_length(rig, lengths_m) / self._sigma)

    def _gradient(self, rig: Rig, names: tuple[str, ...], lengths_m: Array) -> Array:
        """d(whitened measurements)/d(parameters) (5N + M, k)."""
        if not names:
            return np.zeros((5 * len(lengths_m) + len(self._matches), 0))
        seen = by_names(rig, lengths_m, names) / self._sigma[:, :, None]
        missed = misses_by_names(rig, self._matches, names) / self._match_sigma
        return np.concatenate([seen.reshape(-1, len(names)), missed])


def _pixel_sigmas(station: Station) -> list[float]:
    return [*np.sqrt(np.diag(station.left.cov_px2)), *np.sqrt(np.diag(station.right.cov_px2))]


def _basis(rig: Rig, names: tuple[str, ...]) -> Array:
    """(names, coordinates), orthonormal: a direction has two, the others one each."""
    columns = [np.eye(len(names))[:, i] for i, name in enumerate(names) if name not in DIRECTION]
    if set(DIRECTION) <= set(names):
        assert rig.laser is not None
        places = [names.index(name) for name in DIRECTION]
        for across in np.linalg.svd(rig.laser.direction[None])[2][1:]:
            column = np.zeros(len(names))
            column[places] = across
            columns.append(column)
    return np.stack(columns, axis=1)


def _with_covariance(rig: Rig, covariance: RigCovariance) -> Rig:
    """Covariance in place of the rig's own."""
    return dataclasses.replace(rig, covariance=covariance)


def _inverse(cov: Array) -> Array:
    sigma = np.sqrt(np.diag(cov))
    correlation = cov / np.outer(sigma, sigma) + _JITTER * np.eye(len(cov))
    return np.asarray(np.linalg.inv(correlation) / np.outer(sigma, sigma))


def _solve(information: Array, right_hand: Array) -> Array:
    scale = 1 / np.sqrt(np.diag(information))
    return np.asarray(
        scale[:, None] * np.linalg.solve(information * np.outer(scale, scale), right_hand * scale[:, None])
    )
