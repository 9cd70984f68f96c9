"""The demonstration: a simulated approach, ours and the paper's method side by side."""

from __future__ import annotations

from leadline.pipeline.build import Job, build_job

SOURCE = "sim:demo"


def demo_job(*, source: str = SOURCE, seed: int = 0, real_time: bool = False) -> Job:
    """Needs no file, no network and no hardware."""
    return build_job(source, methods=("fused", "paper"), seed=seed, real_time=real_time)
