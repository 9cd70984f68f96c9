"""What was measured, in the order of its stamps: a late sample is put in its place and what follows is done again."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field

from leadline.estimation.state import State
from leadline.samples import NS_PER_S, Kind, Measurement, Rejected, VehicleMotion

Inputs = tuple[Measurement, ...] | VehicleMotion


@dataclass(frozen=True, slots=True)
class Taken:
    """What became of an instant's measurements. surprise: of those taken, the largest share of the gate."""

    used: tuple[Kind, ...] = ()
    rejected: tuple[Rejected, ...] = ()
    position: bool = False
    surprise: float = 0.0


NOTHING = Taken()


@dataclass(frozen=True, slots=True)
class Entry:
    """An instant: what was measured, the state before and after it, and what became of it."""

    inputs: Inputs
    before: State
    after: State
    taken: Taken = NOTHING

    @property
    def t_ns(self) -> int:
        return self.after.t_ns


Apply = Callable[[State, int, Inputs], Entry]


@dataclass(slots=True)
class History:
    """Entries of the last ``horizon_s``, and one before them to start from; ``kept``: the older ones, where wanted."""

    horizon_s: float
    keep: bool = False
    entries: list[Entry] = field(default_factory=list)
    kept: list[Entry] = field(default_factory=list)

    def begin(self, state: State) -> None:
        self.entries, self.kept = [Entry((), state, state)], []

    def place(self, t_ns: int) -> int:
        """Where a sample with this stamp goes; 0: before everything."""
        return bisect_right(self.entries, t_ns, key=_stamp)

    def insert(self, t_ns: int, inputs: Inputs, apply: Apply) -> Entry | None:
        """Put an instant in its place and do the later ones again; None where it is too late for that."""
        at = self.place(t_ns)
        if at == 0:
            return None
        later = self.entries[at:]
        del self.entries[at:]
        self.entries.append(apply(self.entries[-1].after, t_ns, inputs))
        for old in later:
            self.entries.append(apply(self.entries[-1].after, old.t_ns, old.inputs))
        self._forget()
        return self.entries[-1 - len(later)]

    def last(self, t_ns: int) -> Entry:
        """The entry at a time or the last before it; the first, where all are later."""
        return self.entries[max(self.place(t_ns), 1) - 1]

    def since(self, t_ns: int) -> list[Entry]:
        """The entries after a time."""
        return self.entries[self.place(t_ns) :]

    def all(self) -> list[Entry]:
        return self.kept + self.entries

    def end(self, t_ns: int) -> None:
        """Nothing from this time on is true."""
        self.kept = [entry for entry in self.kept if entry.t_ns < t_ns]
        self.entries = [entry for entry in self.entries if entry.t_ns < t_ns]

    def _forget(self) -> None:
        oldest_ns = self.entries[-1].t_ns - int(self.horizon_s * NS_PER_S)
        if len(self.entries) < 2 or self.entries[1].t_ns > oldest_ns:
            return
        drop = self.place(oldest_ns) - 1
        if self.keep:
            self.kept += self.entries[:drop]
        del self.entries[:drop]


def _stamp(entry: Entry) -> int:
    return entry.after.t_ns
