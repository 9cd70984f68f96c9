"""The page of a guided capture in a real Chromium. Pictures go to $LEADLINE_SHOTS, if set."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from playwright.sync_api import Browser, expect

from guided_scenes import SMALL, frame_of, held, small_rig
from leadline.calibration.advice import advised
from leadline.calibration.coverage import BANDS, EACH_BAND, EACH_TILT, TILTS, coverage_of
from leadline.pipeline.page import Page
from leadline.rig_derivatives import Medium
from leadline.samples import StereoFrame
from leadline.sinks.control import Control, Wish
from leadline.sinks.web_access import Place
from leadline.sinks.web_capture import CaptureSink, Look, Status, Wanted
from page_tabs import Tab, answered_by, chromium, lit, needs_chromium

pytestmark = needs_chromium


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as browser:
        yield browser


@pytest.fixture
def tab(browser: Browser) -> Iterator[Tab]:
    tab = Tab(browser)
    yield tab
    tab.context.close()


NEXT = "Hold the board in the upper right of the picture, about 0.5 m away, its top edge tilted towards the camera."
BLURRED = "Blurred in the left picture (edges 9 px wide): hold still, give more light, or check the focus."


def status(count: int = 7, *, enough: bool = False) -> Status:
    rig = small_rig()
    coverage = coverage_of([], SMALL, rig, (640, 360))
    advice = advised(coverage, rig, SMALL, Medium.AIR)
    assert advice is not None
    cells = [["yes" if enough or row + column > 2 else "no" for column in range(6)] for row in range(4)]
    return Status(
        count=count,
        want=20,
        share=1.0 if enough else 0.4,
        next="Enough: these images make a good calibration." if enough else NEXT,
        tilt="" if enough else "top",
        cells={"left": cells, "right": cells[::-1]},
        lists={
            "Distance": [
                Wanted(coverage.where(band), 5 if enough else k, EACH_BAND) for k, band in enumerate(BANDS, 2)
            ],
            "Tilted towards the camera": [
                Wanted(f"{t} edge", 3 if enough else k, EACH_TILT) for k, t in enumerate(TILTS)
            ],
        },
        missing=() if enough else ("8 of 24 fields of the left picture", "3 boards nearer than 0.65 m"),
        quality="These images alone: depth good to ±0.3 mm at 1 m, ±1.1 mm at 2.2 m (1 sigma)",
        enough=enough,
        outline={} if enough else {side: q.tolist() for side, q in advice.outline_px.items()},
    )


def frame() -> StereoFrame:
    return frame_of(small_rig(), held(0.8), 1.0, np.random.default_rng(0))


def look(state: str, words: str) -> Look:
    dots = [[200.0 + 30 * (k % 7), 100.0 + 30 * (k // 7)] for k in range(35)]
    return Look(state, words, {"left": dots, "right": dots})


@contextmanager
def served(what: str = "board", aim: str = "Images of the 7x5 board in air") -> Iterator[tuple[CaptureSink, str]]:
    sink = CaptureSink(what, "uvc:0", aim, Control())
    with Page(sink, Place(port=0)) as page:
        yield sink, page.url


def test_what_is_next_what_is_wrong_and_what_is_missing_is_seen(tab: Tab) -> None:
    with served() as (sink, url):
        page = tab.page
        page.goto(url)
        sink.show(frame(), look("bad", BLURRED), status())
        tab.link("Live")
        expect(page.locator("#next")).to_have_text(NEXT)
        expect(page.locator("#now")).to_contain_text(BLURRED)
        expect(page.locator("#now")).to_have_attribute("data-state", "bad")
        expect(page.locator("#count")).to_have_text("7")
        expect(page.locator("#cells_left .no")).to_have_count(6)
        expect(page.locator("#cells_left")).to_have_attribute("aria-label", "left picture: 18 of 24 fields done")
        expect(page.locator("#lists li").first).to_contain_text("○ nearer than 0.65 m■■□□□")
        assert all(lit(page, canvas) > 5 for canvas in ("left", "right", "pose"))
        sink.show(frame(), look("saved", "Saved: image 8."), status(8))
        sink.tell("Saved: image 8.", status(8))
        expect(page.locator("#saved")).to_contain_text("image 8")
        expect(page.locator("#count")).to_have_text("8")
        sink.show(frame(), look("same", "Like image 8, which is saved: move on."), status(8))
        expect(page.locator("#saved")).to_be_hidden()
        sink.show(frame(), look("wait", "Good. Hold the board still …"), status(8))
        expect(page.locator("#now")).to_have_attribute("data-state", "wait")
        sink.show(frame(), look("same", "It is there."), status(20, enough=True))
        sink.ended(["enough: 20 images in out/air", "next: leadline calibrate cameras --air out/air"])
        expect(page.locator("#next")).to_have_text("Enough: these images make a good calibration.")
        expect(page.locator("#banner")).to_contain_text("leadline calibrate cameras --air out/air")
        expect(page.locator("#lists .done")).to_have_count(7)
        tab.shot("capture_enough")
    assert not tab.complaints
    assert not tab.elsewhere


def test_everything_can_be_done_from_the_keyboard(tab: Tab) -> None:
    with served() as (sink, url):
        page = tab.page
        page.goto(url)
        sink.show(frame(), look("wait", "Good. Hold the board still …"), status())
        tab.link("Live")
        page.keyboard.press("u")
        answered_by(sink.control, Wish.UNDO)
        page.keyboard.press("s")  # board images are not kept by hand
        page.keyboard.press("e")
        expect(page.locator("#end_dialog")).to_contain_text("It is not enough yet")
        expect(page.locator("#end_missing li")).to_have_count(2)
        tab.shot("capture_end")
        page.keyboard.press("Enter")  # the safe answer is the first
        expect(page.locator("#end_dialog")).to_be_hidden()
        assert not sink.control.take()
        page.keyboard.press("e")
        page.keyboard.press("Tab")
        page.keyboard.press("Enter")
        answered_by(sink.control, Wish.END)
        page.keyboard.press("b")
        expect(page.locator("#sound")).to_have_attribute("aria-pressed", "true")
        page.keyboard.press("t")
        expect(page.locator("html")).to_have_attribute("data-theme", "dark")
        page.keyboard.press("?")
        expect(page.locator("#help_dialog")).to_be_visible()
    assert not tab.complaints


def test_of_a_target_there_is_one_grid_and_a_key_to_keep_a_picture(tab: Tab) -> None:
    with served("target", "Images of the target, for training") as (sink, url):
        tab.page.goto(url)
        sizes = [Wanted(name, 3, 8) for name in ("under 1/16", "1/16 to 1/8")]
        grid = {"left": [["yes", "no", "no"]] * 3}
        told = dataclasses.replace(
            status(), tilt="", cells=grid, lists={"Size of the target": sizes}, outline={}, quality=""
        )
        sink.show(frame(), Look("same", "Like picture 3.", boxes={"left": [[100, 80, 60, 60]], "right": []}), told)
        tab.link("Live")
        expect(tab.page.locator("#cells_left i")).to_have_count(9)
        expect(tab.page.locator("#cells_right")).to_be_hidden()
        tab.page.keyboard.press("s")
        answered_by(sink.control, Wish.KEEP)
        tab.shot("capture_target")
    assert not tab.complaints


@pytest.mark.parametrize(
    ("width", "height", "scheme"), [(768, 1024, "light"), (1280, 800, "dark"), (390, 800, "light")]
)
def test_nothing_sticks_out_and_what_is_read_is_large(browser: Browser, width: int, height: int, scheme: str) -> None:
    tab = Tab(browser, width, height, scheme)
    with served() as (sink, url):
        tab.page.goto(url)
        sink.show(frame(), look("bad", BLURRED), status())
        tab.link("Live")
        expect(tab.page.locator("#next")).to_have_text(NEXT)
        tab.page.wait_for_timeout(500)
        tab.shot(f"capture_{width}_{scheme}")
        assert tab.page.evaluate("document.documentElement.scrollWidth") <= width
        for name in ("#todo", "#now", "#pictures", "#coverage", "#lists", "#progress"):
            box = tab.page.locator(name).bounding_box()
            assert box is not None
            assert box["x"] >= 0
            assert box["x"] + box["width"] <= width + 1
        size = "(id) => parseFloat(getComputedStyle(document.querySelector(id)).fontSize)"
        assert tab.page.evaluate(size, "#next") >= 19
        assert tab.page.evaluate(size, "#now") >= 17
        pictures = tab.page.locator("#pictures").bounding_box()
        assert pictures is not None
        assert pictures["y"] + pictures["height"] < height  # what to do, what is wrong and the pictures: no scrolling
    assert not tab.complaints
    tab.context.close()
