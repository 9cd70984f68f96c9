"""A run with its live page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from leadline.guidance import Guide
from leadline.pipeline import folder
from leadline.pipeline.build import Job
from leadline.pipeline.page import Page
from leadline.sinks.control import Control
from leadline.sinks.web import WebSink
from leadline.sinks.web_access import Place


class View(Page):
    """Run ``job``, and let it take ``control``."""

    def __init__(self, job: Job, out: Path, place: Place) -> None:
        self.control = Control()
        guide = Guide(job.rig, job.config.guidance)
        self._sink = WebSink(Path(job.source.name).name, job.rig, job.target, guide, self.control, job.source.truth)
        super().__init__(self._sink, place, lambda: folder.written(out, self.control.desk.files))
        self.job = replace(job, outputs=(*job.outputs, self._sink))
        self._out = out

    def ended(self, summary: dict[str, Any]) -> None:
        """Tell the page what the dive came to."""
        self._sink.ended(_words(summary, self._out))


def _words(summary: dict[str, Any], out: Path) -> list[str]:
    solutions = max(summary["solutions"], 1)
    valid = 100 * summary["status"]["valid"] / solutions
    return [
        f"{summary['frames']} stereo frames and {summary['readings']} laser readings, "
        f"position good in {valid:.0f} % of the solutions.",
        f"Tables, picture and settings are in {out}.",
        *(f"{line}." for line in summary["unfinished"]),
    ]
