"""One live device, as its supervisor sees it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from leadline.health import Part
from leadline.sources.inbox import Item


class Lost(Exception):  # noqa: N818  what happened, not whose fault it is
    """The device is gone, or no good: close it and open it again."""


class Finished(Exception):  # noqa: N818  no error
    """There is no more, and that is no fault: a film or a dive has ended."""


class LivePart(ABC):
    """Opened, read and closed by one thread. A new object is made for each time that it is opened.

    ``name``: as the user wrote it. ``parts``: whose health it is. A ``read`` that does not return within ``hang_s`` is
    given up, and another object takes over.
    """

    parts: ClassVar[tuple[Part, ...]]
    hang_s: ClassVar[float] = 5.0
    name: str

    @abstractmethod
    def open(self) -> None:
        """Raises Lost where it cannot be."""

    @abstractmethod
    def read(self) -> Sequence[Item]:
        """What has come; waits a short while (0.2 s) for it. Raises Lost or Finished."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the device; never raises, safe to call twice."""
