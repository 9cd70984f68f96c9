"""What runs on a vehicle: the start script with a stand-in for leadline, the container's labels, the unit."""

from __future__ import annotations

import configparser
import json
import os
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture
def vehicle(tmp_path: Path) -> Path:
    """A folder with a ``leadline`` that prints what it was asked, an argument a line."""
    stand_in = tmp_path / "bin" / "leadline"
    stand_in.parent.mkdir()
    stand_in.write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
    stand_in.chmod(0o755)
    return tmp_path


def start(vehicle: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    path = f"{vehicle / 'bin'}:{os.environ['PATH']}"
    return subprocess.run(
        [str(ROOT / "deploy" / "start.sh"), *arguments],
        cwd=vehicle,
        env={"PATH": path, **environment},
        capture_output=True,
        text=True,
        check=False,
    )


def test_arguments_are_a_command_of_leadline(vehicle: Path) -> None:
    assert start(vehicle, "doctor", "--json").stdout.split() == ["doctor", "--json"]


def test_without_settings_doctor_speaks_and_the_status_is_two(vehicle: Path) -> None:
    done = start(vehicle)
    assert (done.returncode, done.stdout.split()) == (2, ["doctor"])
    assert "leadline.env" in done.stderr


def test_settings_make_a_run_each_into_a_folder_of_its_own(vehicle: Path) -> None:
    (vehicle / "leadline.env").write_text(
        "LEADLINE_SOURCE='uvc:0+serial:/dev/ttyUSB0?protocol=jrt'\n"
        "LEADLINE_OPTIONS='--rig rig.yaml --target sphere:0.34 --record'\n"
    )
    done = start(vehicle, LEADLINE_PAGE="0.0.0.0:8550")
    asked = done.stdout.split()
    assert done.returncode == 0, done.stderr
    assert asked[:3] == ["run", "uvc:0+serial:/dev/ttyUSB0?protocol=jrt", "--out"]
    assert re.fullmatch(r"dives/\d{8}T\d{6}Z", asked[3])
    assert asked[4:6] == ["--view-at", "0.0.0.0:8550"]
    assert asked[6:] == ["--headless", "--rig", "rig.yaml", "--target", "sphere:0.34", "--record"]
    assert "--view-at" not in start(vehicle).stdout


def test_the_containers_labels_are_what_an_extension_needs() -> None:
    text = (ROOT / "Dockerfile").read_text()
    labels = dict(re.findall(r"LABEL (\w+)='(.*)'", text))
    permissions = json.loads(labels["permissions"])
    port = re.search(r"EXPOSE (\d+/tcp)", text)
    assert port is not None
    assert port[1] in permissions["ExposedPorts"]
    assert permissions["HostConfig"]["NetworkMode"] == "host"
    assert json.loads(labels["authors"])[0]["name"]
    assert json.loads(labels["links"])["source"].startswith("https://")
    assert {"permissions", "authors", "company", "links", "tags"} <= set(labels)
    version = re.search(r'^version = "(.*)"', (ROOT / "pyproject.toml").read_text(), re.M)
    assert version is not None
    assert f'LABEL version="{version[1]}"' in text


def test_the_image_copies_only_what_is_there() -> None:
    text = (ROOT / "Dockerfile").read_text()
    for line in re.findall(r"^COPY (?!--from)(.*) \S+$", text, re.M):
        assert all((ROOT / name).exists() for name in line.split()), line


def test_the_unit_ends_a_dive_as_ctrl_c_does_and_starts_again() -> None:
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read(ROOT / "deploy" / "leadline.service")
    service = unit["Service"]
    assert service["KillSignal"] == "SIGINT"
    assert service["Restart"] == "always"
    assert service["ExecStart"].endswith("start.sh")
