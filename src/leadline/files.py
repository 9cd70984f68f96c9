"""Writing a file whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

from leadline.errors import InputError


def write_whole(path: Path, text: str) -> None:
    """Replace a file in one step, so that a failure leaves what was there. InputError where it cannot be written."""
    beside = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        beside.write_text(text, encoding="utf-8")
        beside.replace(path)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise InputError(f"cannot be written ({error.strerror})", str(path), "check the folder") from error
