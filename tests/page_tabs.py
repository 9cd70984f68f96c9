"""A real Chromium for the pages' tests. Pictures go to $LEADLINE_SHOTS, if set."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright

from leadline.sinks.control import Control, Request, Wish

CHROMIUM = os.environ.get("LEADLINE_CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
PATIENCE_MS = 30_000

needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium on this machine (LEADLINE_CHROMIUM names one)"
)


@contextmanager
def chromium() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


class Tab:
    """A page without any network but this computer; what it complains about and asks for is kept."""

    def __init__(self, browser: Browser, width: int = 1280, height: int = 800, scheme: str = "light") -> None:
        self.context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)  # type: ignore[arg-type]
        self.page: Page = self.context.new_page()
        self.page.set_default_timeout(PATIENCE_MS)
        self.complaints: list[str] = []
        self.elsewhere: list[str] = []
        self.page.on("console", lambda said: self.complaints.append(said.text) if said.type == "error" else None)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.context.route("**/*", self._route)

    def _route(self, route: object) -> None:
        url = route.request.url  # type: ignore[attr-defined]
        if url.startswith(("http://127.0.0.1:", "blob:http://127.0.0.1:")):
            route.continue_()  # type: ignore[attr-defined]
        else:
            self.elsewhere.append(url)
            route.abort()  # type: ignore[attr-defined]

    def shot(self, name: str) -> None:
        if folder := os.environ.get("LEADLINE_SHOTS"):
            self.page.screenshot(path=Path(folder) / f"{name}.png", full_page=True)

    def link(self, words: str) -> None:
        expect(self.page.locator("#link")).to_have_text(words, timeout=PATIENCE_MS)


def answered_by(control: Control, wish: Wish) -> Request:
    """The next request of this kind, as the loop would take it."""
    for _ in range(500):
        for request in control.take():
            if request.wish is wish:
                return request
        time.sleep(0.01)
    raise AssertionError(f"nobody asked to {wish}")


def lit(page: Page, canvas: str) -> int:
    """How many different colours a canvas shows."""
    return page.evaluate(
        """(id) => { const c = document.getElementById(id);
        const d = new Uint32Array(c.getContext("2d").getImageData(0, 0, c.width, c.height).data.buffer);
        return new Set(d).size; }""",
        canvas,
    )  # type: ignore[no-any-return]
