"""Simulated dives with things that go wrong: how often a solution is wrong and does not say so.

    python -m benchmarks.silent [DIVES [FIRST]] [--draws N] [--processes N] [--renders FOLDER]

Small pictures (320x180), some thirty frames a dive, drawn by its number: scene, water, featureless or clothed, sensor
faults, exposures and clocks apart, a rig for other water, boxes that shake and fail. Silent: a valid solution whose
range is off by more than 5 stated sigmas and 20 mm.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.silent_cases import Case, Footage, ShakyBoxes, case
from leadline.localizer import Localizer
from leadline.samples import Solution, Status, StereoFrame
from leadline.target import Cylinder, Plane

SILENT_SIGMAS, SILENT_M = 5.0, 0.020

Floats = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True, slots=True)
class Result:
    """Errors and sigmas of the valid solutions, m; times of the silent ones, s; frames that show the target."""

    name: str
    error_m: Floats
    sigma_m: Floats
    silent_s: tuple[float, ...]
    frames: int
    frames_valid: int
    notices: tuple[str, ...]


def solve(one: Case, footage: Footage) -> Result:
    """Run a case through the localizer."""
    finder = None if isinstance(one.target, Plane | Cylinder) else ShakyBoxes(footage, one.number)
    localizer = Localizer(one.rig(footage), one.target, finder)
    rows, frames, valid = [], 0, 0
    for sample in one.samples(footage):
        solution = localizer.step(sample)
        row = _row(footage, solution)
        if isinstance(sample, StereoFrame) and footage.boxes_px[sample.name] is not None:
            frames, valid = frames + 1, valid + (row is not None)
        if row is not None:
            rows.append(row)
    t_s, error, sigma = np.array(rows).reshape(-1, 3).T
    silent = (np.abs(error) > SILENT_SIGMAS * sigma) & (np.abs(error) > SILENT_M)
    return Result(one.name, error, sigma, tuple(t_s[silent].tolist()), frames, valid, tuple(localizer.notices))


def _row(footage: Footage, s: Solution | None) -> tuple[float, float, float] | None:
    if s is None or s.status is not Status.VALID or s.range_m is None or s.range_sigma_m is None:
        return None
    return s.t_s, s.range_m - footage.range_m[s.t_ns], s.range_sigma_m


def solve_all_draws(number: int, draws: Sequence[int], renders: Path | None) -> list[Result]:
    """One dive's pictures with each draw of faults."""
    cv2.setNumThreads(1)
    footage = case(number).footage(renders)
    return [solve(case(number, draw), footage) for draw in draws]


def summary(results: Sequence[Result]) -> str:
    error, sigma = (np.concatenate([getattr(r, name) for r in results]) for name in ("error_m", "sigma_m"))
    count, dives = sum(len(r.silent_s) for r in results), sum(bool(r.silent_s) for r in results)
    rms = float(np.sqrt(np.mean(error**2)))
    frames, valid = sum(r.frames for r in results), sum(r.frames_valid for r in results)
    return (
        f"{len(results)} dives, {len(error)} solutions: {count} silent in {dives} dives; |error| mean "
        f"{1e3 * np.abs(error).mean():.1f} mm, median {1e3 * np.median(np.abs(error)):.1f} mm, RMS {1e3 * rms:.1f} mm; "
        f"median sigma {1e3 * np.median(sigma):.1f} mm ({np.median(sigma) / rms:.2f} RMS), within 2 sigma "
        f"{np.mean(np.abs(error) < 2 * sigma):.1%}; valid in {valid / frames:.1%} of {frames} frames with the target"
    )


def main(words: Sequence[str] | None = None) -> bool:
    """Print the silent errors and a line of sums; whether there were none."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.silent")
    parser.add_argument("dives", type=int, nargs="?", default=40)
    parser.add_argument("first", type=int, nargs="?", default=0)
    parser.add_argument("--draws", type=int, default=1, help="of faults, for the pictures of each dive")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--renders", type=Path, help="folder that keeps renders of this version, 10 MB a dive")
    asked = parser.parse_args(words)
    job = partial(solve_all_draws, draws=range(asked.draws), renders=asked.renders)
    results: list[Result] = []
    with get_context("spawn").Pool(asked.processes) as pool:
        for batch in pool.imap(job, range(asked.first, asked.first + asked.dives)):
            results += batch
            for result in batch:
                if result.silent_s:
                    worst = 1e3 * float(np.abs(result.error_m).max())
                    times = ", ".join(f"{t:.2f}" for t in result.silent_s[:6])
                    print(f"{result.name}: {len(result.silent_s)} silent, to {worst:.0f} mm, at {times} s", flush=True)
    print(summary(results))
    return not any(r.silent_s for r in results)


if __name__ == "__main__":
    sys.exit(0 if main() else 1)
