"""What a reader tells beside the samples: rows skipped, samples late or repeated. Counted, never fatal by itself."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from leadline.errors import one_line


class NoticeKind(StrEnum):
    SKIPPED = "skipped"  # a sample that could not be read, or makes no sense, and was left out
    IGNORED = (
        "ignored"  # a value beside the sample (quality, truth) that could not be read; the sample itself was given
    )
    REORDERED = "reordered"  # a row that stood out of arrival order in its file; given in its place in time
    LATE = "late"  # arrived after a newer sample had been given; given all the same, the localizer looks at its stamp
    REPEATED = "repeated"  # the same sensor and the same stamp again; left out
    LOST = "lost"  # a live device was lost, and is opened again
    TRUNCATED = "truncated"  # a recording whose end or a part is missing or damaged; the rest was read


@dataclass(frozen=True, slots=True)
class Notice:
    """``where`` names the file and row or time, ``why`` says what is the matter, in one line."""

    kind: NoticeKind
    where: str
    why: str

    def __str__(self) -> str:
        return one_line(f"{self.kind}: {self.where}: {self.why}")


def count_notices(notices: Iterable[Notice]) -> dict[str, int]:
    """How many of each kind, for ``summary.json``: {"skipped": 2}; empty on clean data."""
    return dict(Counter(str(notice.kind) for notice in notices))
