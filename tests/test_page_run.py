"""`leadline run --view` from a terminal, with a real Chromium beside it: recorded, marked, downloaded, to its end."""

from __future__ import annotations

import csv
import os
import shutil
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import pytest
from playwright.sync_api import expect, sync_playwright
from rosbags.highlevel import AnyReader

from leadline.errors import InputError
from leadline.pipeline import build_job, run
from leadline.pipeline.recorder import Recorder
from leadline.pipeline.view import View
from leadline.samples import LaserRange
from leadline.sinks import Sink
from leadline.sinks.control import Control, Wish
from leadline.sinks.web_access import Place
from leadline.sources import open_source

CHROMIUM = os.environ.get("LEADLINE_CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
DIVE = """name: short
description: A ball of 0.34 m from 1 m to 0.4 m.
path: {start_m: 1.0, end_m: 0.4, speed_m_s: 0.15, dwell_s: 0.5}
camera: {rate_hz: 5.0, image_width_px: 320}
"""
PATIENCE_MS = 180_000  # for a busy machine
EVENTS = ["dive.mcap: recording begins", "seen from the tests", "dive.mcap: recording ends"]


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "short.yaml"
    path.write_text(DIVE)
    return path


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine (LEADLINE_CHROMIUM names one)")
def test_a_dive_is_watched_recorded_and_taken_home(scenario: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    command = [sys.executable, "-m", "leadline", "run", f"sim:{scenario}", "--out", str(out)]
    process = subprocess.Popen(
        [*command, "--view-at", "127.0.0.1:0", "--headless"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    try:
        first = process.stdout.readline()
        assert first.startswith("live page: http://127.0.0.1:"), first
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
            page = browser.new_page()
            page.set_default_timeout(PATIENCE_MS)
            page.goto(first.split()[-1])
            page.get_by_role("button", name="Record").click()
            expect(page.locator("#record")).to_have_attribute("aria-pressed", "true", timeout=PATIENCE_MS)
            page.keyboard.press("m")
            page.keyboard.type("seen from the tests")
            page.keyboard.press("Enter")
            expect(page.locator("#events")).to_contain_text("seen from the tests", timeout=PATIENCE_MS)
            page.keyboard.press("r")
            expect(page.locator("#record")).to_have_attribute("aria-pressed", "false", timeout=PATIENCE_MS)
            expect(page.locator("#banner")).to_contain_text("position good in", timeout=PATIENCE_MS)
            expect(page.locator("#status")).to_contain_text("Position good")
            with page.expect_download() as download:
                page.keyboard.press("d")
            archive = zipfile.ZipFile(download.value.path())
            browser.close()
        rest, complaints = process.communicate(timeout=180)  # nobody looks any more: it ends by itself
    finally:
        process.kill()
    assert process.returncode == 0, complaints
    assert "solutions" in rest
    assert archive.testzip() is None
    assert {"solutions.csv", "events.csv", "dive.mcap", "summary.json", "config.yaml"} <= set(archive.namelist())
    with (out / "events.csv").open(encoding="utf-8") as table:
        assert [row["text"] for row in csv.DictReader(table)] == EVENTS


def test_recording_starts_stops_and_starts_again_between_samples(scenario: Path, tmp_path: Path) -> None:
    control = Control()
    asked = {2: Wish.RECORD, 4: Wish.MARK, 6: Wish.STOP, 8: Wish.STOP, 9: Wish.RECORD}
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "solutions.csv").touch()
    earlier = tmp_path / "run" / "dive.mcap"
    earlier.write_bytes(b"of an earlier run")
    run(
        build_job(f"sim:{scenario}"),
        tmp_path / "run",
        progress=lambda done, total: control.ask(asked[done], "here") if done in asked else None,
        control=control,
    )
    assert earlier.read_bytes() == b"of an earlier run"
    assert [path.name for path in control.desk.files] == ["dive_2.mcap", "dive_3.mcap"]
    assert not control.desk.recording
    with AnyReader([control.desk.files[0]]) as reader:
        told = [
            reader.deserialize(raw, one.msgtype) for one, _, raw in reader.messages() if one.topic == "/diagnostics"
        ]
    said = [one.status[0].message for one in told if one.status[0].name == "leadline/event"]
    assert said == ["dive_2.mcap: recording begins", "here", "dive_2.mcap: recording ends"]
    frames = [one for one in open_source(control.desk.files[0]) if not isinstance(one, LaserRange)]
    assert len(frames) == 4  # asked for after frame 2, stopped after frame 6


def test_a_recording_that_cannot_be_written_is_told_and_the_dive_goes_on(tmp_path: Path) -> None:
    def refuse(path: Path) -> Sink:
        raise PermissionError(13, "Permission denied", str(path))

    control = Control()
    recorder = Recorder(tmp_path, [], control, refuse, None, lambda: 0)  # type: ignore[arg-type]  nothing to watch
    control.ask(Wish.RECORD)
    recorder.poll()
    assert control.desk.trouble == "dive.mcap cannot be written: Permission denied"
    assert not control.desk.recording
    recorder.close()


def test_without_the_extra_the_command_that_brings_it_is_told(
    scenario: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "leadline.sinks.web_server", None)
    with pytest.raises(InputError, match=r"pip install \"leadline\[live\]\""):
        View(build_job(f"sim:{scenario}"), tmp_path / "run", Place(port=0))


def test_an_ended_page_waits_for_its_last_visitor_only(
    scenario: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("leadline.pipeline.page.NOBODY_S", 0.4)
    with View(build_job(f"sim:{scenario}"), tmp_path / "run", Place(port=0)) as view:
        start_s = time.monotonic()
        view.linger()
    assert time.monotonic() - start_s < 20
