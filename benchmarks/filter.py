"""The filter beside an oracle and beside GTSAM, on dives drawn from their noise.

python -m benchmarks.filter [RUNS]      # 100 dives of each kind; the promises were taken on 1000
"""

from __future__ import annotations

import os
import sys

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"  # before NumPy loads: every figure is one thread's

import time  # noqa: E402
from importlib.util import find_spec  # noqa: E402

import numpy as np  # noqa: E402

from benchmarks.filter_dives import Plan, draw  # noqa: E402
from benchmarks.filter_runs import SETTLED_S, Outcome, experiment  # noqa: E402
from leadline.estimation import Filter  # noqa: E402
from leadline.samples import NS_PER_S  # noqa: E402

STANDARD = Plan("standard")
HARDER = (
    Plan("dropouts", dropouts=2),
    Plan("bursts", bursts=2),
    Plan("clock step", clock_step_s=0.1),
    Plan("murky", noise_factor=2.0),
    Plan("calm", psd=0.001),
    Plan("lively", psd=0.1),
    Plan("smooth", motion="smooth"),
    Plan("still", motion="still"),
    Plan("violent", motion="violent"),
    Plan("violent, near", motion="violent", standoff_m=0.22, camera_outliers=0.0),
)
MOST_RATIO, MOST_TAIL, MOST_STEP_US, PEERS = 1.1, 1.3, 100.0, 30


def row(o: Outcome) -> str:
    return (
        f"{o.plan.name:14s} {1e3 * np.median(o.rms_m):7.2f} {1e3 * np.quantile(o.rms_m, 0.9):7.2f}"
        f" {1e3 * np.median(o.oracle_m):7.2f} {o.ratio:6.3f} {o.tail:6.2f} {o.nees:6.2f} {o.nis:6.2f} {o.lost:5d}"
        f" {1e3 * np.median(o.at_stamp_m):8.2f} {1e3 * np.median(o.single_m):7.2f} {np.median(o.step_us):7.0f}"
    )


def beside_gtsam(runs: int) -> tuple[float, float]:
    """Median RMS error in m of the same dives: ours, GTSAM's."""
    from benchmarks.filter_gtsam import fixed_lag  # noqa: PLC0415  only here is it needed

    dives = draw(STANDARD, runs)
    late = dives.arrival_s > SETTLED_S
    theirs = [
        float(np.sqrt((((fixed_lag(dives, run, STANDARD.psd) - dives.now_m[run])[late]) ** 2).sum(-1).mean()))
        for run in range(runs)
    ]
    return float(np.median(experiment(STANDARD, runs).rms_m)), float(np.median(theirs))


def step_us(repeats: int = 9) -> tuple[float, float]:
    """Median and 95th percentile over the steps of a dive; each the least of some, as others use the machine too."""
    spent = np.min([experiment(STANDARD, 1).step_us for _ in range(repeats)], axis=0)
    return float(np.median(spent)), float(np.quantile(spent, 0.95))


def growth(minutes: float = 5.0) -> float:
    """Median process time of a step in the last minute against the first."""
    plan = Plan("long", seconds=60 * minutes, standoff_m=1.0)
    dives = draw(plan, 1)
    filt = Filter()
    filt.start(round(float(dives.t_s[0]) * NS_PER_S) - 1, dives.start_m[0], 0.01 * np.eye(3))
    spent = []
    for k in range(len(dives.t_s)):
        m = dives.measurement(0, k)
        begin = time.process_time()
        filt.add(m.t_ns, [m])
        spent.append(time.process_time() - begin)
    part = int(len(spent) / minutes)
    return float(np.median(spent[-part:]) / np.median(spent[part // 10 : part]))


def main(runs: int) -> bool:
    """Print the table; whether the promises are kept."""
    print(f"{runs} dives each; RMS error in mm when the answer is given, from {SETTLED_S:g} s on")
    print("dives             ours     p90  oracle  ratio p90/md   NEES    NIS  lost at stamp  single step us")
    standard = experiment(STANDARD, runs)
    print(row(standard), flush=True)
    for plan in HARDER:
        print(row(experiment(plan, runs)), flush=True)
    kept = standard.ratio <= MOST_RATIO and standard.tail <= MOST_TAIL and standard.lost == 0
    kept &= abs(standard.nees - 3) <= standard.band() and abs(standard.nis - 3) <= standard.band()
    print(f"\nNEES and NIS of 3 in 3 +-{standard.band():.2f} (95 %)")
    if find_spec("gtsam") is None:
        print("GTSAM is not installed (pip install gtsam): no peer")
    else:
        ours, theirs = beside_gtsam(PEERS)
        print(f"GTSAM's fixed-lag smoother, the same {PEERS} dives: {1e3 * theirs:.2f} mm, ours {1e3 * ours:.2f}")
        kept &= ours <= theirs
    usual, long = step_us()
    print(
        f"a step takes {usual:.0f} us (at most {MOST_STEP_US:g}), 1 in 20 more than {long:.0f}, late samples included"
    )
    print(f"after five minutes {growth():.2f} times as long")
    return bool(kept) and usual <= MOST_STEP_US


if __name__ == "__main__":
    sys.exit(0 if main(int(sys.argv[1]) if len(sys.argv) > 1 else 100) else 1)
