"""Our filter through drawn dives, and what came of it beside the oracle."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.filter_dives import START_SIGMA_M, Dives, Plan, draw
from benchmarks.filter_oracle import oracle
from leadline.estimation import Filter, FilterSettings
from leadline.samples import NS_PER_S, Array, Kind

SETTLED_S = 2.5
PSDS = np.geomspace(1e-4, 10, 11)
LOST_M, LOST_NEES, LOST_S = 0.05, 75.0, 1.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """Of N dives: RMS errors (N,) in m from 2.5 s on, at the answers' time and at the frames' own stamps."""

    plan: Plan
    rms_m: Array
    oracle_m: Array
    at_stamp_m: Array
    single_m: Array  # of the good frames alone
    nees: float  # mean over answers
    nis: float  # mean over good frames
    lost: int  # dives in which the answer was far off and sure of itself for a second
    step_us: Array  # process time of each ``add``

    @property
    def ratio(self) -> float:
        return float(np.sqrt((self.rms_m**2).mean() / (self.oracle_m**2).mean()))

    @property
    def tail(self) -> float:
        """p90 / median of the dives' RMS errors."""
        return float(np.quantile(self.rms_m, 0.9) / np.median(self.rms_m))

    def band(self) -> float:
        """Half the 95 % band of a mean NEES of 3 dimensions at one time, over so many dives."""
        return float(1.96 * np.sqrt(6 / len(self.rms_m)))


def experiment(plan: Plan, runs: int, settings: FilterSettings | None = None) -> Outcome:
    dives = draw(plan, runs)
    late = dives.arrival_s > SETTLED_S
    ours = [_run(dives, run, settings or FilterSettings()) for run in range(runs)]
    error = np.array([one.now_m for one in ours]) - dives.now_m
    frames = late & ~dives.is_laser
    stamp = np.array([one.then_m for one in ours]) - dives.truth_m
    single = np.where(dives.good[..., None], dives.z_m - dives.truth_m, np.nan)
    nees = np.array([one.nees for one in ours])
    return Outcome(
        plan,
        _rms(error[:, late]),
        _best_oracle(replace(plan, clock_step_s=0.0, clock_sigma_s=0.0), runs),
        _rms(stamp[:, frames]),
        _rms(single[:, frames]),
        float(nees[:, late].mean()),
        float(np.nanmean(np.array([one.nis for one in ours])[:, late])),
        int(sum(_was_lost(e, n, dives.arrival_s) for e, n in zip(error, nees, strict=True))),
        np.concatenate([one.step_us for one in ours]),
    )


def _rms(error_m: Array) -> Array:
    return np.sqrt(np.nanmean((error_m**2).sum(-1), axis=1))


def _best_oracle(plan: Plan, runs: int) -> Array:
    """With the motion's own power density, or where there is none the best of many in hindsight."""
    dives = draw(plan, runs)
    late = dives.arrival_s > SETTLED_S
    tried = [
        _rms((oracle(dives, psd) - dives.now_m)[:, late]) for psd in ([plan.psd] if plan.motion == "model" else PSDS)
    ]
    return min(tried, key=lambda rms: float((rms**2).mean()))


def _was_lost(error_m: Array, nees: Array, t_s: Array) -> bool:
    begun = None
    for off, surprise, t in zip(np.linalg.norm(error_m, axis=1), nees, t_s, strict=True):
        if t < SETTLED_S or off < LOST_M or surprise < LOST_NEES:
            begun = None
        elif begun is None:
            begun = t
        elif t - begun > LOST_S:
            return True
    return False


@dataclass(frozen=True, slots=True)
class _Run:
    now_m: Array
    then_m: Array
    nees: Array
    nis: Array
    step_us: Array


def _run(dives: Dives, run: int, settings: FilterSettings) -> _Run:
    count = len(dives.t_s)
    now, then = np.zeros((count, 3)), np.full((count, 3), np.nan)
    nees, nis = np.zeros(count), np.full(count, np.nan)
    spent: list[float] = []
    filt = Filter(settings)
    filt.start(_ns(dives.t_s[0]) - 1, dives.start_m[run], START_SIGMA_M**2 * np.eye(3))
    for k in range(count):
        if dives.there[run, k]:
            m = dives.measurement(run, k)
            if m.kind is Kind.STEREO and dives.good[run, k]:
                predicted = filt.at(m.t_ns)
                off = m.z - predicted.x
                nis[k] = off @ np.linalg.solve(predicted.cov + m.cov, off)
            begin = time.process_time()
            filt.add(m.t_ns, [m])
            spent.append(time.process_time() - begin)
            then[k] = filt.at(m.t_ns).x
        estimate = filt.at(_ns(dives.arrival_s[k]))
        now[k] = estimate.x
        error = now[k] - dives.now_m[run, k]
        nees[k] = error @ np.linalg.solve(estimate.cov, error)
    return _Run(now, then, nees, nis, 1e6 * np.array(spent))


def _ns(t_s: float) -> int:
    return round(float(t_s) * NS_PER_S)
