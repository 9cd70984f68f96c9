"""A run with its live page."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

from leadline.errors import InputError
from leadline.guidance import Guide
from leadline.pipeline import folder
from leadline.pipeline.build import Job
from leadline.sinks.control import Control
from leadline.sinks.web import WebSink
from leadline.sinks.web_access import Place, choose_token

TOKEN = "LEADLINE_TOKEN"
NOBODY_S, GONE_S = 60.0, 10.0  # how long the page of an ended dive waits: for a first visitor, for the last to return


class View:
    """Serves the page from ``with`` to its end. Run ``job``, and let it take ``control``."""

    def __init__(self, job: Job, out: Path, place: Place) -> None:
        """InputError where the place cannot be had, the token is weak, or the extra is missing."""
        try:
            from leadline.sinks.web_server import PageServer  # noqa: PLC0415  an extra
        except ImportError as error:
            fix = 'pip install "leadline[live]"'
            raise InputError(f"the live page needs {error.name or 'starlette and uvicorn'}", "--view", fix) from error
        self.control = Control()
        guide = Guide(job.rig, job.config.guidance)
        self._sink = WebSink(Path(job.source.name).name, job.rig, job.target, guide, self.control, job.source.truth)
        token = choose_token(place, os.environ.get(TOKEN))
        self._server = PageServer(self._sink, place, token, lambda: folder.written(out, self.control.desk.files))
        self.job = replace(job, outputs=(*job.outputs, self._sink))
        self._out = out

    @property
    def url(self) -> str:
        return self._server.url

    def __enter__(self) -> View:
        self._server.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._server.close()

    def ended(self, summary: dict[str, Any]) -> None:
        """Tell the page what the dive came to."""
        self._sink.ended(_words(summary, self._out))

    def linger(self) -> None:
        """Until nobody looks any more, or Ctrl-C."""
        left_s = NOBODY_S
        try:
            while left_s > 0:
                time.sleep(0.2)
                if self._server.clients:
                    left_s = GONE_S
                else:
                    left_s -= 0.2
        except KeyboardInterrupt:
            return


def _words(summary: dict[str, Any], out: Path) -> list[str]:
    solutions = max(summary["solutions"], 1)
    valid = 100 * summary["status"]["valid"] / solutions
    return [
        f"{summary['frames']} stereo frames and {summary['readings']} laser readings, "
        f"position good in {valid:.0f} % of the solutions.",
        f"Tables, picture and settings are in {out}.",
    ]
