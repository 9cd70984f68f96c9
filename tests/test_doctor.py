"""`leadline doctor`: with nothing connected, with a dive, and with things that are wrong."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from leadline.cli import main
from leadline.pipeline import doctor, doctor_computer
from leadline.pipeline.doctor import Finding, Level, examine
from wire_helpers import write_folder

QUICK = doctor_computer.Disk(10**12, 5e8, 0.01)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The step's benchmark and the disk's speed are measured once, elsewhere: here they are given."""
    monkeypatch.setattr(doctor_computer, "step_s", lambda: 0.05)
    monkeypatch.setattr(doctor_computer, "measure_disk", lambda folder: QUICK)
    monkeypatch.setattr(doctor_computer, "typical_s", lambda work, times: (work() and None) or 0.02)


def found(source: str | None, rig: str | None = None, **options: object) -> dict[str, Finding]:
    return {one.part: one for one in examine(source, rig, Path(), **options)}  # type: ignore[arg-type]


def test_with_nothing_connected(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor_computer, "devices", lambda: ([], []))
    assert main(["doctor", "--json"]) == 0
    findings = {one["part"]: one for one in json.loads(capsys.readouterr().out)}
    assert {"cameras", "laser", "rig", "disk room", "disk speed", "model", "speed", "clock", "extra live"} <= set(
        findings
    )
    assert findings["cameras"]["level"] == "warn"
    assert "doctor uvc:0" in findings["cameras"]["advice"]


def test_a_dive_and_a_rig_of_another_size(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_folder(tmp_path / "dive", frames=6)
    findings = found(str(folder), "rendered")
    assert (findings["cameras"].level, findings["laser"].level) == (Level.OK, Level.OK)
    assert "6 frames of 64x48, 2.5 a second" in findings["cameras"].said
    assert findings["rig size"].level is Level.FAIL
    assert main(["doctor", str(folder), "--rig", "rendered"]) == 1
    assert "the camera gives 64x48" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("grey", "level", "said"), [(0, Level.FAIL, "black"), (15, Level.WARN, "dark"), (255, Level.WARN, "bright")]
)
def test_images_that_show_nothing(tmp_path: Path, grey: int, level: Level, said: str) -> None:
    folder = write_folder(tmp_path / "dive", frames=4)
    for path in folder.glob("right_*.jpg"):
        cv2.imwrite(str(path), np.full((48, 64, 3), grey, np.uint8))
    findings = found(str(folder))
    assert findings["right image"].level is level
    assert said in findings["right image"].said
    assert findings["left image"].level is Level.OK


def test_what_cannot_be_opened_is_a_finding() -> None:
    findings = found("uvc:77", "no_such_rig.yaml", seconds=1.0)
    assert {findings[part].level for part in ("rig",)} == {Level.FAIL}
    assert Level.FAIL in {findings[part].level for part in ("source", "cameras") if part in findings}
    assert findings["speed"].level is Level.OK


def test_a_users_own_words_are_printed_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    """`:x:` was a picture, and `[red]` a colour."""
    assert main(["doctor", "live:dive+bogus:x:[red]"]) == 1
    assert "dive+bogus:x:[red]" in "".join(capsys.readouterr().out.split())


def test_slow_disk_old_rig_bad_fit(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(doctor_computer, "measure_disk", lambda folder: doctor_computer.Disk(10**9, 1e6, 2.0))
    text = (Path(doctor.__file__).parents[1] / "rigs" / "paper.yaml").read_text()
    head = text.split("\nprovenance:")[0]
    rig = tmp_path / "rig.yaml"
    rig.write_text(head + "\nprovenance: {date: '2020-01-01T00:00:00+00:00', rms_px: 0.9}\n")
    findings = found(None, str(rig))
    assert {findings[part].level for part in ("disk room", "disk speed", "rig age", "rig fit")} == {Level.WARN}
    assert "days old" in findings["rig age"].said
