"""Where a command writes: folders are made, a file is written whole or not at all. YAML that says everything once."""

from __future__ import annotations

import errno
import os
from collections.abc import Hashable, Iterable
from pathlib import Path
from typing import Any

import yaml

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


def read_yaml(path: Path) -> Any:
    """What a YAML file holds. InputError where it cannot be read, is none, or has a key twice."""
    try:
        return yaml.load(path.read_text(encoding="utf-8"), _Once)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not text"
        raise InputError(f"cannot be read ({reason})", str(path), "check the path") from error
    except _DoubledKeyError as error:
        raise InputError(str(error), str(path), "leave one of the two out") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: what looks like a date and is none
        raise InputError("is not YAML", str(path), str(error)) from error


class _DoubledKeyError(ValueError):
    pass


class _Once(yaml.SafeLoader):
    """YAML forbids a key twice; the library takes the last, and a user's setting is gone without a word."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen = set[tuple[str, str]]()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if (key.tag, key.value) in seen:
                raise _DoubledKeyError(f"{key.value}: is there twice, again in line {key.start_mark.line + 1}")
            seen.add((key.tag, key.value))
        return super().construct_mapping(node, deep)
