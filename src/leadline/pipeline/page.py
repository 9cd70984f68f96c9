"""A page that is served while something is going on, and until nobody looks any more."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from leadline.errors import InputError
from leadline.sinks.web_access import Place, choose_token
from leadline.sinks.web_page import Shown

TOKEN = "LEADLINE_TOKEN"
NOBODY_S, GONE_S = 60.0, 10.0  # how long the page of what has ended waits: for a first visitor, for the last to return


class Page:
    """Served from ``with`` to its end. files: what can be downloaded."""

    def __init__(self, sink: Shown, place: Place, files: Callable[[], Sequence[Path]] = lambda: ()) -> None:
        """InputError where the place cannot be had, the token is weak, or the extra is missing."""
        try:
            from leadline.sinks.web_server import PageServer  # noqa: PLC0415  an extra
        except ImportError as error:
            fix = 'pip install "leadline[live]"'
            raise InputError(f"the live page needs {error.name or 'starlette and uvicorn'}", "--view", fix) from error
        self._server = PageServer(sink, place, choose_token(place, os.environ.get(TOKEN)), files)

    @property
    def url(self) -> str:
        return self._server.url

    def __enter__(self) -> Self:
        self._server.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._server.close()

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
