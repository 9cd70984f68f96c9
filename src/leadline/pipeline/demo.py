"""The demonstration: a simulated approach, ours and the paper's method side by side."""

from __future__ import annotations

from pathlib import Path

from leadline.pipeline.build import Job, build_job
from leadline.pipeline.loop import Progress, Report, run

SOURCE = "sim:demo"


def demo_job(*, source: str = SOURCE, seed: int = 0, real_time: bool = False) -> Job:
    """Needs no file, no network and no hardware."""
    return build_job(source, methods=("fused", "paper"), seed=seed, real_time=real_time)


def demo(out: Path, progress: Progress = lambda done, total: None, *, source: str = SOURCE, seed: int = 0) -> Report:
    """Simulate, locate and write a run's folder."""
    return run(demo_job(source=source, seed=seed), out, progress=progress)
