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
from leadline.wire.laser_answers import can_state
from leadline.wire.laser_protocols import PROTOCOLS


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


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize(
    "impossible",
    [
        ("--range", "inf"),
        ("--range", "nan"),
        ("--range", "1e300"),
        ("--range", "2000"),
        ("--sway", "inf"),
        ("--sway", "nan"),
        ("--range", "300", "--sway", "900"),
        ("--rate", "inf"),
        ("--rate", "nan"),
    ],
)
def test_what_a_device_cannot_say_is_one_line_at_the_start(
    protocol: str, impossible: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["rangefinder", "--protocol", protocol, *impossible]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.startswith("leadline: ")
    assert told.err.count("\n") == 1


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_every_protocol_states_what_the_message_promises(protocol: str) -> None:
    assert can_state(protocol, 0.01)
    assert can_state(protocol, 300.0)
    assert can_state(protocol, 123.456)


def test_an_unknown_protocol_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rangefinder", "--protocol", "sonar"]) == 2
    assert "no protocol 'sonar'" in capsys.readouterr().err
