"""The live page on the command line: where it is served, and a browser that opens it."""

from __future__ import annotations

import os
import sys
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from leadline.cli_progress import progress

if TYPE_CHECKING:
    from leadline.pipeline.build import Job
    from leadline.pipeline.loop import Report

ViewFlag = Annotated[
    bool, typer.Option("--view", help="Serve the live page, and open it in a browser; a dive at its own pace.")
]
ViewAt = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS:PORT", help="Serve it there; beyond this computer it asks for a token (LEADLINE_TOKEN)."
    ),
]


@contextmanager
def watched_run(
    job: Job, out: Path, what: str, *, record: bool, view: bool, at: str | None, headless: bool
) -> Iterator[Report]:
    """The run's report; at the end of the block its page, where one is wanted, stays as long as somebody looks."""
    from leadline.pipeline import run  # noqa: PLC0415

    if not (view or at):
        with progress(what) as tick:
            report = run(job, out, record=record, progress=tick, say=typer.echo)
        yield report
        return

    from leadline.pipeline.view import View  # noqa: PLC0415
    from leadline.sinks.web_access import Place  # noqa: PLC0415

    with View(job, out, Place.parse(at) if at else Place()) as page:
        typer.echo(f"live page: {page.url}")
        if not headless and has_screen():
            webbrowser.open(page.url)
        with progress(what) as tick:
            report = run(page.job, out, record=record, progress=tick, control=page.control, say=typer.echo)
        page.ended(report.summary)
        yield report
        typer.echo(f"the page stays as long as somebody looks at it, or until Ctrl-C: {page.url}")
        page.linger()


def has_screen() -> bool:
    """Without one, a browser for terminals would take this one."""
    return sys.platform in ("win32", "darwin") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
