"""The live page in a real Chromium: what a user sees, presses and is told. Pictures go to $LEADLINE_SHOTS, if set."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Download, expect

from leadline.sinks.control import Desk, Event, Request, Wish
from leadline.sinks.web_access import Place
from page_scenes import Scene, served
from page_tabs import Tab, answered_by, chromium, lit, needs_chromium

TOKEN = "a-token-of-the-tests"

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


def answered(scene: Scene, wish: Wish) -> Request:
    return answered_by(scene.control, wish)


def test_a_dive_is_shown_to_its_end_with_the_network_off(tab: Tab) -> None:
    scene = Scene()
    with served(scene) as server:
        tab.page.goto(server.url)
        tab.link("Live")
        expect(tab.page.locator("#stages [aria-current]")).to_contain_text("Cameras")
        shots = 0
        while scene.thread.is_alive():
            tab.page.wait_for_timeout(500)
            shots += 1
            if shots == 10:
                tab.shot("live")
        tab.link("Dive ended")
        expect(tab.page.locator("#banner")).to_contain_text("All is said.")
        expect(tab.page.locator("#range")).to_have_text("0.160")
        expect(tab.page.locator("#alarm")).to_be_visible()
        expect(tab.page.locator("#reach")).to_have_text("✓ yes")
        assert all(lit(tab.page, canvas) > 5 for canvas in ("left", "right", "above", "side"))
        assert tab.page.locator("#plot canvas").count() == 1
        tab.shot("ended")
    assert not tab.complaints
    assert not tab.elsewhere
    assert scene.slowest_s < 0.1, "the page has held up the loop"


def test_a_failing_part_is_told_in_words_with_what_to_do(tab: Tab) -> None:
    scene = Scene(length_s=0.0)
    scene.step(5.0)
    with served(scene) as server:
        tab.page.goto(server.url)
        fault = tab.page.locator("#parts .fault")
        expect(fault).to_contain_text("Laser: off. nothing for 0.5 s.")
        expect(fault).to_contain_text("What to do: check its power")
        expect(tab.page.locator("#parts .ok")).to_have_count(6)


def test_a_server_restart_is_told_and_survived(tab: Tab) -> None:
    first, second = Scene(length_s=60.0), Scene(length_s=60.0)
    with served(first) as server:
        tab.page.goto(server.url)
        tab.link("Live")
    tab.link("Connection lost")
    expect(tab.page.locator("#banner")).to_contain_text("what you see is old")
    tab.shot("lost")
    for number in range(3):
        second.step(number / 10)
    with served(second, place=Place(port=server.port)):
        tab.link("Live")
        expect(tab.page.locator("#banner")).to_be_hidden()
        expect(tab.page.locator("#range")).not_to_have_text("–")


def test_a_wrong_token_is_refused_and_the_right_one_asked_for(tab: Tab) -> None:
    with served(Scene(), token=TOKEN) as server:
        base = f"http://127.0.0.1:{server.port}/"
        answer = tab.page.goto(f"{base}?token=wrong-wrong-wrong")
        assert answer is not None
        assert answer.status == 401
        expect(tab.page.locator("canvas")).to_have_count(0)
        closed = """(url) => new Promise((done) => {
            const socket = new WebSocket(url);
            socket.onopen = () => done("open");
            socket.onclose = () => done("closed");
        })"""
        assert tab.page.evaluate(closed, f"ws://127.0.0.1:{server.port}/live") == "closed"
        tab.page.get_by_label("Token").fill(TOKEN)
        tab.page.keyboard.press("Enter")
        tab.link("Live")
        assert tab.page.url == base  # the token does not stay there
    other = Scene()
    with served(other, token=TOKEN + "-of-another-run", place=Place(port=server.port)):
        tab.link("Token refused")


def test_everything_can_be_done_from_the_keyboard(tab: Tab, tmp_path: Path) -> None:
    table = tmp_path / "solutions.csv"
    table.write_text("t_s\n1.0\n")
    scene = Scene(length_s=60.0)
    with served(scene, files=(table,)) as server:
        page = tab.page
        page.goto(server.url)
        tab.link("Live")
        page.keyboard.press("r")
        answered(scene, Wish.RECORD)
        scene.control.desk = Desk(recording=True, files=(tmp_path / "dive.mcap",))
        expect(page.locator("#record")).to_have_text("Stop recording R")
        page.keyboard.press("r")
        answered(scene, Wish.STOP)
        page.keyboard.press("m")
        page.keyboard.type("an anchor, rusty")
        tab.shot("mark")
        page.keyboard.press("Enter")
        assert answered(scene, Wish.MARK).text == "an anchor, rusty"
        scene.sink.event(Event(10**9, "<b>an anchor</b>"))
        expect(page.locator("#events li").first).to_contain_text("<b>an anchor</b>")  # words, never markup
        page.keyboard.press("m")
        page.keyboard.press("Escape")
        expect(page.locator("#mark_dialog")).to_be_hidden()
        page.locator("#mark_text").dispatch_event("keydown", {"key": "?"})  # on a busy page it still has the focus
        expect(page.locator("#help_dialog")).to_be_visible()
        tab.shot("help")
        page.keyboard.press("Escape")
        page.keyboard.press("t")
        expect(page.locator("html")).to_have_attribute("data-theme", "dark")
        with page.expect_download() as download:
            page.keyboard.press("d")
        assert names(download.value) == ["solutions.csv"]
        page.keyboard.press("Tab")
        seen = []
        for _ in range(5):
            seen.append(page.evaluate("document.activeElement.id"))
            page.keyboard.press("Tab")
        assert set(seen) >= {"mark", "theme", "help"} or set(seen) >= {"record", "mark", "download"}
        assert not scene.control.take()  # a cancelled mark asked for nothing
    assert not tab.elsewhere


def names(download: Download) -> list[str]:
    return zipfile.ZipFile(download.path()).namelist()


@pytest.mark.parametrize(("width", "height", "scheme"), [(768, 1024, "light"), (1280, 800, "dark"), (390, 800, "dark")])
def test_nothing_sticks_out_and_what_is_read_is_large(browser: Browser, width: int, height: int, scheme: str) -> None:
    tab = Tab(browser, width, height, scheme)
    scene = Scene(length_s=0.0)
    for number in range(60):
        scene.step(number / 8)
    with served(scene) as server:
        tab.page.goto(server.url)
        tab.link("Dive ended")
        expect(tab.page.locator("#range")).not_to_have_text("–")
        tab.page.wait_for_timeout(1200)
        tab.shot(f"page_{width}_{scheme}")
        assert tab.page.evaluate("document.documentElement.scrollWidth") <= width
        assert tab.page.evaluate("document.documentElement.dataset.theme") == scheme
        for name in ("#range", "#pictures", "#plot", "#above", "#side", "#parts"):
            box = tab.page.locator(name).bounding_box()
            assert box is not None
            assert box["x"] >= 0
            assert box["x"] + box["width"] <= width + 1
        size = "(id) => parseFloat(getComputedStyle(document.querySelector(id)).fontSize)"
        assert tab.page.evaluate(size, "#range") >= 60
        assert tab.page.evaluate(size, "#parts .ok") >= 16
        if width == 768:  # what matters is seen without scrolling
            box = tab.page.locator("#pictures").bounding_box()
            assert box is not None
            assert box["y"] + box["height"] < height
    assert not tab.complaints
    tab.context.close()
