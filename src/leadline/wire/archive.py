"""Files as one zip that is made while it is sent: nothing is written, however large a recording is."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, cast

PIECE_BYTES = 1 << 20


class _Piece:
    """A file for ``zipfile`` that hands on what was written to it."""

    def __init__(self) -> None:
        self._written: list[bytes] = []

    def write(self, data: bytes) -> int:
        self._written.append(bytes(data))
        return len(data)

    def flush(self) -> None:
        pass

    def taken(self) -> bytes:
        data = b"".join(self._written)
        self._written.clear()
        return data


def zipped(files: Sequence[Path]) -> Iterator[bytes]:
    """The archive's bytes, piece by piece. A file that still grows is taken as long as it was when its turn came."""
    piece = _Piece()
    with zipfile.ZipFile(cast(IO[bytes], piece), "w", zipfile.ZIP_STORED) as archive:
        for path in files:
            left = path.stat().st_size
            with path.open("rb") as source, archive.open(path.name, "w", force_zip64=True) as entry:
                while left > 0 and (data := source.read(min(PIECE_BYTES, left))):
                    entry.write(data)
                    left -= len(data)
                    yield piece.taken()
    yield piece.taken()
