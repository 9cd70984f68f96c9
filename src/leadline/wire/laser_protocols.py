"""All rangefinder protocols by their names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from leadline.errors import InputError
from leadline.wire.laser_dimetix import DimetixLaser
from leadline.wire.laser_jrt import JrtLaser
from leadline.wire.laser_lightware import LightwareLaser, LightwareTextLaser
from leadline.wire.laser_m703a import M703aLaser
from leadline.wire.laser_protocol import LaserProtocol
from leadline.wire.laser_text import TextLaser

PROTOCOLS: dict[str, type[LaserProtocol]] = {
    protocol.name: protocol
    for protocol in (TextLaser, M703aLaser, JrtLaser, DimetixLaser, LightwareLaser, LightwareTextLaser)
}
_OPTIONS: dict[str, dict[str, type]] = {
    "text": {"pattern": str, "field": int, "separator": str, "scale": float, "single": str},
    "dimetix": {"device": int},
}


def make_protocol(name: str, options: Mapping[str, str] | None = None) -> LaserProtocol:
    """A new parser. InputError for a name, an option or a value that is none."""
    if name not in PROTOCOLS:
        raise InputError(f"no protocol {name!r}", "serial", f"use one of {', '.join(PROTOCOLS)}")
    kinds, values = _OPTIONS.get(name, {}), dict[str, Any]()
    for key, text in (options or {}).items():
        if key not in kinds:
            known = f"it takes {', '.join(kinds)}" if kinds else "it takes none"
            raise InputError(f"protocol {name} has no option {key!r}", "serial", known)
        try:
            values[key] = kinds[key](text)
        except ValueError as error:
            raise InputError(f"{key}={text} is not a number", "serial", "give a number") from error
    return PROTOCOLS[name](**values)
