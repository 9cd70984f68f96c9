"""Dimetix D series (DLS-C, FLS-C and their forerunners DLS-A, FLS-A): lines of ASCII, <cr><lf>, N the device's number.

    sNh   tracking: reads until stopped     sNg   one reading     sNc   stop
    gNh+xxxxxxxx   distance in 1/10 mm      gN@Ezzz   error zzz    gN?   done

Source: Dimetix "Technical reference manual DLS-C(H)/FLS-C(H)", 9.1.1-9.1.5 (page 29/53), 9.4.3 (page 44/53); DLS-A
manual 8.2.1-8.2.2 (page 19/40). Error codes: the manual's appendix, as in andrewpeck/dimetix-lasersensor (libdls.cpp).
"""

from __future__ import annotations

import re
from typing import ClassVar

from leadline.errors import InputError
from leadline.wire.laser_protocol import Heard, LaserRefusal, LineProtocol, distance

_READING = re.compile(r"g\d(?:g|h|ug|uh)([+-]\d{8})")
_ERROR = re.compile(r"g\d@E(\d{3})")
_OTHER = re.compile(r"g\d[a-z]*\?|g\d[a-z]{1,4}(?:[+-]\w*)*|s\d[a-z]+(?:[+-]\d+)*")
ERRORS = {
    203: "wrong syntax",
    210: "not in tracking mode",
    211: "sampling time too short",
    212: "command not possible while tracking",
    220: "communication error",
    230: "distance overflow by the user's offset or gain",
    252: "temperature too high",
    253: "temperature too low",
    254: "bad signal from the target, it takes too long to measure",
    255: "received signal too weak, or target lost",
    256: "received signal too strong",
    258: "supply voltage too high",
    259: "supply voltage too low",
    260: "ambiguous targets",
    263: "too much light, or a jump of the distance",
    264: "too much light",
    330: "acceleration too strong, or a jump of the distance",
    331: "target too fast",
    360: "measuring time too short",
    361: "measuring time too long",
}


class DimetixLaser(LineProtocol):
    """device: its number on the ID switch, 0-9."""

    name: ClassVar[str] = "dimetix"
    baud: ClassVar[int] = 19200

    def __init__(self, device: int = 0) -> None:
        super().__init__()
        if not 0 <= device <= 9:
            raise InputError(f"device={device} is not 0 to 9", "serial", "give the number on the ID switch")
        self.start, self.stop, self.single = (f"s{device}{letter}\r\n".encode() for letter in "hcg")

    def _read(self, line: str) -> Heard | None:
        if found := _READING.fullmatch(line):
            return distance(int(found[1]) / 10_000)
        if found := _ERROR.fullmatch(line):
            code = int(found[1])
            return LaserRefusal(f"error {code}: {ERRORS.get(code, 'hardware fault or unknown')}")
        if _OTHER.fullmatch(line):
            return None
        raise ValueError(line)
