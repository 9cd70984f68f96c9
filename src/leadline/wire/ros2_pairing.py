"""Left and right images that belong together, by their stamps alone."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

Item = TypeVar("Item")
WAITING = 16  # images that wait for their partner; more than that is a lost partner
INTERVALS = 8


@dataclass(frozen=True, slots=True)
class Pair(Generic[Item]):
    left_ns: int
    left: Item
    right_ns: int
    right: Item

    @property
    def t_ns(self) -> int:
        """The frame's stamp: the middle of both exposures."""
        return (self.left_ns + self.right_ns) // 2


class Pairing(Generic[Item]):
    """An image pairs with the nearest of the other camera, if that is within the tolerance and half a frame period.

    The second condition holds at high rates, where a lost image would else shift all later pairs by one. What is older
    than a pair can have no partner any more.
    """

    def __init__(self, tolerance_ns: int) -> None:
        self._tolerance_ns = tolerance_ns
        self._waiting: tuple[dict[int, Item], dict[int, Item]] = {}, {}
        self._last_ns: list[int | None] = [None, None]
        self._intervals_ns: deque[int] = deque(maxlen=INTERVALS)

    def left(self, t_ns: int, item: Item) -> Pair[Item] | None:
        return self._take(0, t_ns, item)

    def right(self, t_ns: int, item: Item) -> Pair[Item] | None:
        return self._take(1, t_ns, item)

    def _take(self, side: int, t_ns: int, item: Item) -> Pair[Item] | None:
        self._pace(side, t_ns)
        mine, others = self._waiting[side], self._waiting[1 - side]
        mine[t_ns] = item
        other_ns = min(others, key=lambda other: abs(other - t_ns), default=None)
        if other_ns is None or abs(other_ns - t_ns) > self._reach_ns():
            if len(mine) > WAITING:
                del mine[next(iter(mine))]
            return None
        stamps = (t_ns, other_ns) if side == 0 else (other_ns, t_ns)
        lefts, rights = self._waiting
        pair = Pair(stamps[0], lefts[stamps[0]], stamps[1], rights[stamps[1]])
        for images, paired_ns in ((lefts, stamps[0]), (rights, stamps[1])):
            for old in [one for one in images if one <= paired_ns]:
                del images[old]
        return pair

    def _pace(self, side: int, t_ns: int) -> None:
        last_ns, self._last_ns[side] = self._last_ns[side], t_ns
        if last_ns is not None and t_ns > last_ns:
            self._intervals_ns.append(t_ns - last_ns)

    def _reach_ns(self) -> int:
        return min(self._tolerance_ns, min(self._intervals_ns, default=2 * self._tolerance_ns) // 2)
