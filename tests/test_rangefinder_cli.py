"""`leadline rangefinder`: a device to try a set-up out with, on a port that any program can open."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from leadline.cli import main
from leadline.samples import LaserRange
from leadline.sources.clock import LiveClock
from leadline.sources.laser_serial import SerialLaser


def test_its_port_gives_readings_until_it_is_stopped() -> None:
    command = [sys.executable, "-m", "leadline", "rangefinder", "--range", "1.25", "--sway", "0", "--rate", "20"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as device:
        assert device.stdout is not None
        address = device.stdout.readline().strip()
        port = address.removeprefix("serial:").partition("?")[0]
        laser = SerialLaser(port, LiveClock(), protocol="jrt")
        laser.open()
        readings: list[float] = []
        while len(readings) < 3:
            readings += [one.range_m for one in laser.read() if isinstance(one, LaserRange)]
        laser.close()
        device.send_signal(signal.SIGINT)
        assert "readings sent" in device.communicate(timeout=20)[0]
        assert device.returncode == 0
    assert address.endswith("?protocol=jrt")
    assert readings[:3] == [1.25] * 3


def test_an_unknown_protocol_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rangefinder", "--protocol", "sonar"]) == 2
    assert "no protocol 'sonar'" in capsys.readouterr().err
