"""Where a command writes: folders are made, a file is written whole or not at all."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable
from pathlib import Path

from leadline.errors import InputError


def make_folder(folder: Path, *, without: Iterable[str] = ()) -> Path:
    """Make it where there is none, and what it lies in; take files of an earlier time out of it.

    InputError where nothing could be written into it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        for name in without:
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", str(folder), "give a folder that can be") from error
    return folder


def write_whole(path: Path, content: str | bytes) -> None:
    """Replace a file in one step, so that a failure leaves what was there. InputError where it cannot be written."""
    make_folder(path.parent)
    beside = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        beside.write_bytes(content.encode() if isinstance(content, str) else content)
        beside.replace(path)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise InputError(f"cannot be written ({error.strerror})", str(path), "check the folder") from error
