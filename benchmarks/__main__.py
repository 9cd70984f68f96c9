"""Run all benchmarks and print a table; exit status 1 where a promised ratio is missed."""

from __future__ import annotations

import os
import sys

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"  # before NumPy loads: every figure is one thread's

from benchmarks import geometry  # noqa: E402

if __name__ == "__main__":
    sys.exit(0 if geometry.main() else 1)
