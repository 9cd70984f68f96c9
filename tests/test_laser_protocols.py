"""Rangefinder protocols against what the devices say; garbage never raises and never lasts.

Transcripts: [1] LRF with JRT module, a user's log (five readings as received); [2] a driver's own test and comment;
[3] M703A manual, "Serial commands"; [4] Dimetix DLS-C manual, 9.1-9.4; [5] LightWare SF11 manual p. 19, LW20 p. 25-26;
[6] LW20-docs, serial.md and command_detail.md.
"""

from __future__ import annotations

import binascii
import os
import random
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from leadline.errors import InputError
from leadline.wire.laser_lightware import packet
from leadline.wire.laser_protocol import LaserProtocol, LaserReading, LaserRefusal
from leadline.wire.laser_protocols import PROTOCOLS, make_protocol

WHOLE = {  # a good frame of each, and the metres in it
    "text": (b"1.234\r\n", 1.234),
    "m703a": (b"D:12.345m,0079\r\n", 12.345),
    "jrt": (bytes.fromhex("AA 00 00 22 00 03 00 00 00 B5 02 5E 3A"), 0.181),
    "dimetix": (b"g0h+00012345\r\n", 1.2345),
    "lightware": (packet(44, bytes.fromhex("7B 00 50 00")), 1.23),
    "lightware-text": (b"ld,0:23.67\r\n", 23.67),
}
NAMES = sorted(PROTOCOLS)


def ranges(protocol: LaserProtocol, data: bytes) -> list[float]:
    return [heard.range_m for heard in protocol.feed(data) if isinstance(heard, LaserReading)]


def refusals(name: str, data: bytes) -> list[LaserRefusal]:
    return [heard for heard in make_protocol(name).feed(data) if isinstance(heard, LaserRefusal)]


@pytest.mark.parametrize(
    ("frame", "range_m", "quality"),
    [  # [1], [2]
        ("AA 00 00 22 00 03 00 00 00 B5 02 5E 3A", 0.181, 0x25E),
        ("AA 00 00 22 00 03 00 00 00 B4 02 5B 36", 0.180, 0x25B),
        ("AA 00 00 22 00 03 00 00 00 D5 02 60 5C", 0.213, 0x260),
        ("AA 00 00 22 00 03 00 00 00 A9 02 7D 4D", 0.169, 0x27D),
        ("AA 00 00 22 00 03 00 00 0B 5A 02 A4 30", 2.906, 0x2A4),
        ("AA 00 00 22 00 03 00 00 04 75 00 18 B6", 1.141, 0x18),
    ],
)
def test_jrt_readings_as_logged(frame: str, range_m: float, quality: int) -> None:
    (reading,) = make_protocol("jrt").feed(bytes.fromhex(frame))
    assert reading == LaserReading(range_m, float(quality), size=13)


def test_jrt_error_and_echo() -> None:
    (refusal,) = refusals("jrt", bytes.fromhex("EE 00 00 00 00 01 00 02 03"))
    assert refusal == LaserRefusal("error 2: internal error")
    assert make_protocol("jrt").feed(bytes.fromhex("AA 00 01 BE 00 01 00 01 C1")) == []  # laser on, echoed


def test_jrt_commands_have_right_sums() -> None:
    protocol = make_protocol("jrt")
    for command in (protocol.start, protocol.single):
        assert sum(command[1:-1]) & 0xFF == command[-1]


def test_m703a_session() -> None:  # [3]
    said = b",OK!\r\nO,OK!\r\n18.0'C, 2.7V\r\nD:12.345m,0079\r\nF: 1.494m,0054\r\nD:Er.05!\r\n"
    heard = make_protocol("m703a").feed(said)
    assert [h.range_m for h in heard if isinstance(h, LaserReading)] == [12.345, 1.494]
    assert [h.quality for h in heard if isinstance(h, LaserReading)] == [79.0, 54.0]
    assert heard[-1] == LaserRefusal("error 5: target out of range")
    assert len(heard) == 3


def test_dimetix_session() -> None:  # [4]
    heard = make_protocol("dimetix").feed(b"g0?\r\ng0h+00012345\r\ng0uh+00000999\r\ng0@E255\r\ng0uof+00000010\r\n")
    assert [h.range_m for h in heard if isinstance(h, LaserReading)] == [1.2345, 0.0999]
    assert heard[-1] == LaserRefusal("error 255: received signal too weak, or target lost")
    assert len(heard) == 3
    assert make_protocol("dimetix", {"device": "3"}).start == b"s3h\r\n"


def test_lightware_text() -> None:  # [5]
    heard = make_protocol("lightware-text").feed(b"p:LW20,1.0,1\r\nld,0:23.67\r\n78.32\r\n?LD 98.67\r\n-1.00\r\n")
    assert [h.range_m for h in heard if isinstance(h, LaserReading)] == [23.67, 78.32, 98.67]
    assert heard[-1] == LaserRefusal("signal lost")


def test_lightware_packets() -> None:  # [6]
    assert binascii.crc_hqx(b"123456789", 0) == 0x31C3  # CRC-16/XMODEM's check value
    assert _crc_of_the_manual(b"123456789") == 0x31C3
    request = packet(30, b"\x05\x00\x00\x00", write=True)
    assert request[:4] == bytes([0xAA, 0x41, 0x01, 30])  # five bytes of payload << 6, and the write bit
    assert int.from_bytes(request[-2:], "little") == _crc_of_the_manual(request[:-2])
    lost = packet(44, (-100).to_bytes(2, "little", signed=True) + b"\0\0")
    assert refusals("lightware", lost) == [LaserRefusal("signal lost")]


def _crc_of_the_manual(data: bytes) -> int:
    """createCRC of serial.md, "Checksum"."""
    crc = 0
    for byte in data:
        code = crc >> 8 ^ byte
        code ^= code >> 4
        crc = (crc << 8 ^ code ^ code << 5 ^ code << 12) & 0xFFFF
    return crc


@pytest.mark.parametrize(
    ("options", "line", "range_m"),
    [
        ({}, b"range 2.50 m\n", 2.5),
        ({"scale": "0.001"}, b"1234\n", 1.234),
        ({"field": "2", "separator": ";", "scale": "0.001"}, b"7;x;1234;9\n", 1.234),
        ({"pattern": r"R=(?P<range>[\d.]+) Q=(?P<quality>\d+)"}, b"T=9.9 R=1.25 Q=80\n", 1.25),
    ],
)
def test_text_lines(options: dict[str, str], line: bytes, range_m: float) -> None:
    assert ranges(make_protocol("text", options), line) == [range_m]


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("sonar", {}),
        ("text", {"pattern": "("}),
        ("text", {"pattern": "[0-9]+"}),
        ("text", {"scale": "x"}),
        ("text", {"field": "1", "pattern": "(?P<range>.)"}),
        ("jrt", {"scale": "1"}),
        ("dimetix", {"device": "12"}),
    ],
)
def test_wrong_settings_get_one_clear_line(name: str, options: dict[str, str]) -> None:
    with pytest.raises(InputError) as caught:
        make_protocol(name, options)
    assert "\n" not in str(caught.value)
    assert caught.value.fix


@pytest.mark.parametrize("name", NAMES)
def test_frames_arrive_in_pieces(name: str) -> None:
    frame, range_m = WHOLE[name]
    protocol = make_protocol(name)
    heard = [r for place in range(3 * len(frame)) for r in ranges(protocol, (frame * 3)[place : place + 1])]
    assert heard == [range_m] * 3


@pytest.mark.parametrize("name", NAMES)
def test_bytes_behind_a_frame_are_counted(name: str) -> None:
    """The time of a reading is that of its own last byte, not of the last byte read with it."""
    frame, _ = WHOLE[name]
    readings = [h for h in make_protocol(name).feed(frame * 3) if isinstance(h, LaserReading)]
    assert [a.behind - b.behind for a, b in pairwise(readings)] == [len(frame)] * 2
    assert all(abs(reading.size - len(frame)) <= 1 for reading in readings)


@pytest.mark.parametrize("name", ["jrt", "lightware"])
def test_a_flipped_bit_does_not_give_another_distance(name: str) -> None:
    """These have a checksum; a line of text has none."""
    frame, _ = WHOLE[name]
    for bit in range(8 * len(frame)):
        spoilt = bytearray(frame)
        spoilt[bit // 8] ^= 1 << bit % 8
        protocol = make_protocol(name)
        assert ranges(protocol, bytes(spoilt) + frame) in ([], [WHOLE[name][1]])
        assert ranges(protocol, frame)[-1:] == [WHOLE[name][1]]


def survives(name: str, garbage: bytes) -> None:
    """After any bytes, the second whole frame at the latest is read, and nothing raises."""
    frame, range_m = WHOLE[name]
    protocol = make_protocol(name)
    protocol.feed(garbage)
    first, second, third = (ranges(protocol, frame) for _ in range(3))
    assert second[-1:] == [range_m] or first[-1:] == [range_m], garbage
    assert third == [range_m], garbage


def streams(count: int, seed: int) -> None:
    """Random bytes, and good streams with bytes changed, lost and added; half of each protocol's own alphabet."""
    rng = random.Random(seed)
    for number in range(count):
        name = NAMES[number % len(NAMES)]
        frame = WHOLE[name][0]
        if number % 3 == 0:
            garbage = rng.randbytes(rng.randrange(0, 60))
        elif number % 3 == 1:
            garbage = bytes(rng.choice(frame) for _ in range(rng.randrange(0, 60)))
        else:
            spoilt = bytearray(frame * rng.randrange(1, 4))
            for _ in range(rng.randrange(1, 5)):
                place = rng.randrange(len(spoilt))
                if rng.random() < 0.3:
                    del spoilt[place : place + rng.randrange(1, 4)]
                    spoilt = spoilt or bytearray(b"\0")
                else:
                    spoilt[place] = rng.randrange(256)
            garbage = bytes(spoilt)
        survives(name, garbage)


def test_ten_thousand_streams() -> None:
    streams(10_000, seed=1)


@pytest.mark.long
def test_a_million_streams() -> None:
    streams(int(os.environ.get("LEADLINE_STREAMS", "1000000")), seed=2)


@settings(max_examples=300, deadline=None)
@given(name=st.sampled_from(NAMES), garbage=st.binary(max_size=200))
def test_any_bytes(name: str, garbage: bytes) -> None:
    survives(name, garbage)


@pytest.mark.parametrize("name", NAMES)
def test_a_silent_flood_does_not_grow_the_buffer(name: str) -> None:
    protocol = make_protocol(name)
    for _ in range(200):
        protocol.feed(bytes(range(33, 127)) * 4)
    assert len(protocol._buffer) < 200
