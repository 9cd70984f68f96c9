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


def test_settings_may_stand_anywhere(vehicle: Path) -> None:
    for place in ("there.env", "etc/there.env", str(vehicle / "etc" / "there.env")):
        file = vehicle / place
        file.parent.mkdir(exist_ok=True)
        file.write_text("LEADLINE_SOURCE=uvc:7\n")
        done = start(vehicle, LEADLINE_SETTINGS=place)
        assert done.returncode == 0, done.stderr
        assert done.stdout.split()[:2] == ["run", "uvc:7"]


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


def unit_service() -> configparser.SectionProxy:
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read(ROOT / "deploy" / "leadline.service")
    return unit["Service"]


def test_the_unit_ends_a_dive_as_ctrl_c_does_and_starts_again() -> None:
    service = unit_service()
    assert service["KillSignal"] == "SIGINT"
    assert service["Restart"] == "always"
    assert service["ExecStart"].endswith("start.sh")


def test_the_document_makes_all_that_the_unit_names() -> None:
    service = unit_service()
    told = (ROOT / "docs" / "vehicle.md").read_text()
    commands = [line for line in told.splitlines() if line.startswith("sudo ")]

    def command(*words: str) -> str:
        found = [line for line in commands if all(word in line.split() for word in words)]
        assert len(found) == 1, words
        return found[0]

    user, home = service["User"], service["WorkingDirectory"]
    assert home == f"/var/lib/{service['StateDirectory']}"
    made = command("useradd", "--system", user, "--home-dir", home)
    assert sorted(made.split("--groups ")[1].split()[0].split(",")) == sorted(service["SupplementaryGroups"].split())
    command("install", "-d", "-o", user, home)
    command("install", "leadline.env", "rig.yaml", f"{home}/")
    command("install", "755", "deploy/start.sh", service["ExecStart"])
    command("install", "deploy/leadline.service", "/etc/systemd/system/leadline.service")
    command("systemctl", "enable", "--now", "leadline")
    programs = Path(service["Environment"].removeprefix("PATH=").split(":")[0])
    command("python3", "-m", "venv", str(programs.parent))
    assert f"sudo {programs}/pip install" in told


def test_nothing_installs_the_package_from_an_index() -> None:
    for path in (ROOT / "README.md", ROOT / "Dockerfile", *(ROOT / "docs").glob("*.md"), *ROOT.glob("ros2/**/*.md")):
        assert not re.search(r"pip3? install.*['\" ]leadline", path.read_text()), path
