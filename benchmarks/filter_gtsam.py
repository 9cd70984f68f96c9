"""The peer: GTSAM's incremental fixed-lag smoother with a robust kernel, on the same samples.

It is given what the filter has to find out: that the laser's clock is right, and how the target moves. A state for each
stamp, made as soon as a sample with that stamp or a later one has come, so that late samples find theirs.
"""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np

from benchmarks.filter_dives import BEAM, SPEED_SIGMA_M_S, START_SIGMA_M, Dives
from leadline.samples import Array

LAG_S, FAR = 2.0, 1e3


def fixed_lag(dives: Dives, run: int, psd: float) -> Array:
    """Position (K, 3) at each arrival."""
    return _Peer(dives, run, psd).answers()


class _Peer:
    def __init__(self, dives: Dives, run: int, psd: float) -> None:
        self._dives, self._run, self._psd = dives, run, psd
        # Of Huber, Cauchy, Geman-McClure and Tukey the one, with its constant, that does best here.
        self._kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(3.0)
        parameters = gtsam.ISAM2Params()
        parameters.relinearizeSkip = 1
        parameters.setRelinearizeThreshold(1e-5)  # by default weights are hardly ever renewed: 50 mm instead of 6
        self._smoother = gtsam.IncrementalFixedLagSmoother(LAG_S, parameters)
        self._order = np.argsort(dives.t_s, kind="stable")
        self._place = np.argsort(self._order)
        self._made = 0  # states so far, in the order of stamps
        self._last = np.zeros(6)

    def answers(self) -> Array:
        dives = self._dives
        result = np.zeros((len(dives.t_s), 3))
        for k in range(len(dives.t_s)):
            if dives.there[self._run, k]:
                self._add(k)
            t = float(dives.t_s[self._order[max(self._made - 1, 0)]])
            result[k] = self._last[:3] + self._last[3:] * (dives.arrival_s[k] - t)
        return result

    def _add(self, k: int) -> None:
        graph, values, times = gtsam.NonlinearFactorGraph(), gtsam.Values(), {}
        while self._made <= self._place[k]:
            self._make(graph, values, times)
        graph.add(self._measured(k))
        self._smoother.update(graph, values, times)
        self._smoother.update()  # twice, for the kernel's weights to settle
        self._last = self._smoother.calculateEstimate().atVector(self._made - 1)

    def _make(self, graph: Any, values: Any, times: dict[int, float]) -> None:
        n, t = self._made, float(self._dives.t_s[self._order[self._made]])
        if n == 0:
            self._last = np.concatenate([self._dives.start_m[self._run], np.zeros(3)])
            sigmas = np.array([START_SIGMA_M] * 3 + [SPEED_SIGMA_M_S] * 3)
            graph.add(gtsam.PriorFactorVector(0, self._last, gtsam.noiseModel.Diagonal.Sigmas(sigmas)))
        else:
            dt = max(t - float(self._dives.t_s[self._order[n - 1]]), 1e-6)
            F = np.kron([[1, dt], [0, 1]], np.eye(3))
            Q = self._psd * np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.eye(3))
            W = np.linalg.inv(np.linalg.cholesky(Q))
            moved = gtsam.JacobianFactor(n - 1, -W @ F, n, W, np.zeros(6), gtsam.noiseModel.Unit.Create(6))
            graph.add(gtsam.LinearContainerFactor(moved))
            self._last = F @ self._last
        values.insert(n, self._last)
        times[n] = t
        self._made += 1

    def _measured(self, k: int) -> Any:
        """A place, a reading's known along the beam only; of the velocity nothing."""
        dives, run = self._dives, self._run
        cov, z = FAR**2 * np.eye(6), np.zeros(6)
        if dives.is_laser[k]:
            axes = np.vstack([BEAM, np.linalg.svd(BEAM)[2][1:]])
            cov[:3, :3] = axes.T @ np.diag([dives.cov_m2[run, k, 0, 0], FAR**2, FAR**2]) @ axes
            z[:3] = BEAM[0] * dives.z_m[run, k, 0]
        else:
            cov[:3, :3], z[:3] = dives.cov_m2[run, k], dives.z_m[run, k]
        noise = gtsam.noiseModel.Robust.Create(self._kernel, gtsam.noiseModel.Gaussian.Covariance(cov))
        return gtsam.PriorFactorVector(int(self._place[k]), z, noise)
