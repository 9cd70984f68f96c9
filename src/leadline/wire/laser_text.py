"""A rangefinder that writes a line of text for each reading: which number of it is the distance is the user's to say.

``protocol=text`` takes the first number of a line, in metres; ``field=2&separator=;`` the third field; ``pattern=...``
a regular expression with a group ``range`` (and, if there is one, ``quality``); ``scale=0.001`` for millimetres.
"""

from __future__ import annotations

import re
from typing import ClassVar

from leadline.errors import InputError
from leadline.wire.laser_protocol import Heard, LineProtocol, distance

NUMBER = r"[-+]?\d+(?:\.\d*)?"


class TextLaser(LineProtocol):
    name: ClassVar[str] = "text"
    baud: ClassVar[int] = 115200

    def __init__(
        self, pattern: str = "", field: int | None = None, separator: str = ",", scale: float = 1.0, single: str = ""
    ) -> None:
        """scale: metres in one unit of what is written. single: what asks for a line, if it must be asked."""
        super().__init__()
        if pattern and field is not None:
            raise InputError("pattern and field are two answers to one question", "serial", "give one of them")
        if field is not None:
            skipped = rf"(?:[^{re.escape(separator)}]*{re.escape(separator)}){{{field}}}"
            pattern = rf"^{skipped}[^-+\d{re.escape(separator)}]*(?P<range>{NUMBER})"
        try:
            self._pattern = re.compile(pattern or rf"(?P<range>{NUMBER})")
        except re.error as error:
            raise InputError(f"pattern: {error}", "serial", "give a regular expression") from error
        if "range" not in self._pattern.groupindex:
            raise InputError("the pattern has no group 'range'", "serial", "write (?P<range>...) in it")
        self._scale = scale
        self.single = single.encode().decode("unicode_escape").encode("latin-1") if single else b""
        self.polled = bool(single)  # type: ignore[misc]

    def _read(self, line: str) -> Heard | None:
        found = self._pattern.search(line)
        if found is None:
            raise ValueError(line)
        quality = found.groupdict().get("quality")
        return distance(float(found["range"]) * self._scale, None if quality is None else float(quality))
