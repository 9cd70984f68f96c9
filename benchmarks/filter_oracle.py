"""The oracle: a plain Kalman filter over all dives at once, given the same samples but the outliers.

It knows which samples are wrong, the laser's clock, the true noise and the best power density of acceleration.
Written apart from the filter on purpose.
"""

from __future__ import annotations

import numpy as np

from benchmarks.filter_dives import BEAM, SPEED_SIGMA_M_S, START_SIGMA_M, Dives
from leadline.samples import Array


def oracle(dives: Dives, psd: float) -> Array:
    """Position (N, K, 3) at each arrival, from all that had arrived by then, in the order of stamps."""
    runs, count = dives.there.shape
    y = np.concatenate([dives.start_m, np.zeros((runs, 3))], axis=1)
    P = np.broadcast_to(np.diag([START_SIGMA_M**2] * 3 + [SPEED_SIGMA_M_S**2] * 3), (runs, 6, 6))
    order = np.argsort(dives.t_s, kind="stable")
    arrived = np.zeros(count, bool)
    done, t = 0, float(dives.t_s[0])
    answer = np.zeros((runs, count, 3))
    for k in range(count):
        arrived[k] = True
        while done < count and arrived[order[done]]:  # no earlier one can come any more
            y, P = _take(dives, *_predict(y, P, dives.t_s[order[done]] - t, psd), order[done])
            t = dives.t_s[order[done]]
            done += 1
        now, cov, then = y, P, t
        for j in order[done:][arrived[order[done:]]]:
            now, cov = _take(dives, *_predict(now, cov, dives.t_s[j] - then, psd), j)
            then = dives.t_s[j]
        answer[:, k] = now[:, :3] + now[:, 3:] * (dives.arrival_s[k] - then)
    return answer


def _predict(y: Array, P: Array, dt: float, psd: float) -> tuple[Array, Array]:
    F = np.kron([[1, dt], [0, 1]], np.eye(3))
    Q = psd * np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.eye(3))
    return y @ F.T, F @ P @ F.T + Q


def _take(dives: Dives, y: Array, P: Array, k: int) -> tuple[Array, Array]:
    if dives.is_laser[k]:
        H, z, R = np.hstack([BEAM, np.zeros((1, 3))]), dives.z_m[:, k, :1], dives.cov_m2[:, k, :1, :1]
    else:
        H, z, R = np.eye(3, 6), dives.z_m[:, k], dives.cov_m2[:, k]
    PHt = P @ H.T
    K = PHt @ np.linalg.inv(H @ PHt + R * dives.plan.noise_factor**2)
    good = dives.good[:, k, None]
    moved = y + np.einsum("nij,nj->ni", K, z - y @ H.T)
    after = P - K @ PHt.transpose(0, 2, 1)
    after = (after + after.transpose(0, 2, 1)) / 2  # else rounding grows
    return np.where(good, moved, y), np.where(good[..., None], after, P)
