"""M703A and its kin (one letter of ASCII a command, 19200 baud).

    O  laser on     C  laser off     S  state     D / M / F  one reading: automatic, slow, fast     X  power off

A reading is ``D:12.345m,0079``: metres and signal quality, smaller is better; an error ``D:Er.05!``. Without its nCTRL
pin held low the module measures once for each letter, so it is asked again after each answer.

Source: the module's manual, "Serial commands" (power-on ``,OK!``; ``O``, ``C``, ``S``, ``D``; "12.345m, 0079"), as its
sellers print it (wf-fdjz.com, show-105-94-1); the error prefix and the table of errors as in public drivers of it.
"""

from __future__ import annotations

import re
from typing import ClassVar

from leadline.wire.laser_jrt import STATUS
from leadline.wire.laser_protocol import Heard, LaserRefusal, LineProtocol, distance

_READING = re.compile(r"[DMF]?:? ?(\d{1,3}\.\d{3})m, ?(\d{4})")
_ERROR = re.compile(r"[A-Z]?:? ?Er\.?(\d{1,2})!?")
_OTHER = re.compile(r"[A-Z]?:?,? ?OK!?|[A-Z]?:? ?-?\d+\.\d'?C, ?\d\.\dV|[OCSDMFXV]")


class M703aLaser(LineProtocol):
    name: ClassVar[str] = "m703a"
    baud: ClassVar[int] = 19200
    polled: ClassVar[bool] = True
    start = b"O"
    stop = b"C"
    single = b"F"

    def _read(self, line: str) -> Heard | None:
        if found := _READING.fullmatch(line):
            return distance(float(found[1]), float(found[2]))
        if found := _ERROR.fullmatch(line):
            code = int(found[1])
            return LaserRefusal(f"error {code}: {STATUS.get(code, 'unknown')}")
        if _OTHER.fullmatch(line):
            return None
        raise ValueError(line)
