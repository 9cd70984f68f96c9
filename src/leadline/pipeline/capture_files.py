"""The folder of a guided capture: images saved whole or not at all, and ``capture.json`` with what was judged.

What stands in the folder counts, not what the file says: images that somebody took out are gone, and a killed capture
goes on where it was. Nothing is ever deleted: what is taken out stands in ``set_aside``.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from leadline.errors import InputError
from leadline.files import make_folder, write_whole

CAPTURE, ASIDE = "capture.json", "set_aside"
_UNDONE = ".part"


class CaptureFolder:
    """places: the folders within ``out`` into which each shot puts one file, such as left and right.

    kind: what must be the same for a capture to go on. InputError where the folder holds anything else.
    """

    def __init__(self, out: Path, places: Sequence[str], kind: Mapping[str, Any]) -> None:
        self.out, self.places, self._kind = out, tuple(places), dict(kind)
        self.notes: dict[str, Any] = {}
        _check(out, self._kind)
        for place in self.places:
            make_folder(out / place)
        if (out / CAPTURE).is_file():
            self.notes = json.loads((out / CAPTURE).read_text(encoding="utf-8")).get("shots", {})
        self._tidy()
        self.write({})
        self._number = max([0, *(int(name) for name in (*self.names, *self.notes) if name.isdigit())])

    @property
    def names(self) -> list[str]:
        """Stems of the shots that are there, in order."""
        found = [{path.stem for path in (self.out / place).iterdir() if path.is_file()} for place in self.places]
        return sorted(set.intersection(*found))

    def files(self, name: str) -> list[Path]:
        return [path for place in self.places for path in (self.out / place).glob(f"{name}.*")]

    def next_name(self) -> str:
        return f"{self._number + 1:04d}"

    def save(self, contents: Sequence[tuple[bytes, str]], note: Mapping[str, Any]) -> str:
        """One shot's files (bytes, suffix), in the order of ``places``; its name. All are written, then named."""
        name = self.next_name()
        self._number += 1
        paths = [self.out / place / f"{name}{suffix}" for place, (_, suffix) in zip(self.places, contents, strict=True)]
        for path, (data, _) in zip(paths, contents, strict=True):
            with path.with_name(f".{path.name}{_UNDONE}").open("wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
        for path in paths:
            path.with_name(f".{path.name}{_UNDONE}").replace(path)
        self.notes[name] = dict(note)
        return name

    def set_aside(self, name: str, why: str) -> None:
        for path in self.files(name):
            aside = self.out / ASIDE / path.parent.name
            aside.mkdir(parents=True, exist_ok=True)
            path.replace(aside / path.name)
        self.notes[name] = {**self.notes.get(name, {}), "set_aside": why}

    def write(self, verdict: Mapping[str, Any]) -> None:
        """``capture.json``, in one step."""
        told = {**self._kind, **verdict, "shots": dict(sorted(self.notes.items()))}
        write_whole(self.out / CAPTURE, json.dumps(told, indent=1) + "\n")

    def _tidy(self) -> None:
        """What a kill has left: files half written, and one without its partner."""
        for place in self.places:
            for path in (self.out / place).glob(f".*{_UNDONE}"):
                path.unlink()
        whole = set(self.names)
        for place in self.places:
            for path in sorted((self.out / place).iterdir()):
                if path.is_file() and path.stem not in whole:
                    self.set_aside(path.stem, "has no partner")


def _check(out: Path, kind: Mapping[str, Any]) -> None:
    if out.exists() and not out.is_dir():
        raise InputError("this is a file", str(out), "give a folder to --out")
    if not out.is_dir() or not any(out.iterdir()):
        return
    path = out / CAPTURE
    if not path.is_file():
        raise InputError("holds something that is no guided capture", str(out), "give a new folder to --out")
    try:
        told = dict(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError) as error:
        raise InputError("cannot be read", str(path), "give a new folder to --out") from error
    for key, value in kind.items():
        if told.get(key) != value:
            fix = "go on with the same, or give a new folder to --out"
            what = f"was captured with {key} {_say(told.get(key))}, this is {_say(value)}"
            raise InputError(what.replace("with what ", "of a "), str(out), fix)


def _say(value: Any) -> str:
    return " ".join(str(one) for one in value.values()) if isinstance(value, dict) else str(value)
