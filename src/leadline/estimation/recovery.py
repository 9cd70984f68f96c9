"""A measurement was turned away: was it wrong, or was the filter? What happened is tried again in another way.

Ways to be wrong that are put right at once, and the entries of the history done again: a wrong position was taken
shortly before (``without_suspect``), the target moves more than it did (``livelier``), or wrong readings were taken
while only the laser measured (``without_readings``). A position that none explains is an outlier, until it goes on for
so long that the filter starts again from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from leadline.estimation.adapt import MOST
from leadline.estimation.replay import Apply, Entry, History
from leadline.samples import NS_PER_S, Kind, Measurement

SUSPECT_FOR_S, UNSURPRISING = 0.3, 0.25  # a position may be taken back so much later, if the new one then fits well
CONTRADICTED = 2  # so many readings turned away in a row speak against those before
LIVELIER = (10.0, 100.0)  # power densities of acceleration to try, against the one before


def without_suspect(history: History, entry: Entry, apply: Apply) -> list[Entry] | None:
    """The entries without the one recent position whose absence lets this one fit well; None where there is none."""
    at = history.place(entry.t_ns) - 1
    oldest_ns = entry.t_ns - int(SUSPECT_FOR_S * NS_PER_S)
    entries = history.entries
    recent = [i for i in range(1, at) if entries[i].taken.position and entries[i].t_ns >= oldest_ns]
    if not recent:
        return None
    most_surprising = max(recent, key=lambda i: entries[i].taken.surprise)
    for suspect in dict.fromkeys((most_surprising, recent[-1])):
        changed = again(entries[:suspect], entries[suspect + 1 :], apply)
        taken = changed[at - 1].taken
        if taken.position and taken.surprise < UNSURPRISING:
            return changed
    return None


def without_readings(history: History, entry: Entry, apply: Apply) -> list[Entry] | None:
    """The entries without the readings from a surprising one on, where all turned away after them then fit well.

    While only the laser measures, wrong readings that follow one another look like a target that moved; the next ones
    tell. The fewest that will do are taken back; None where there are none.
    """
    at = history.place(entry.t_ns) - 1
    entries = history.entries
    away, taken = _readings(entries, at)
    for suspect in taken:
        if entries[suspect].taken.surprise < UNSURPRISING:
            continue
        later = [entries[i] for i in range(suspect, len(entries)) if i not in taken]
        changed = again(entries[:suspect], later, apply)
        if all(e.taken.used and e.taken.surprise < UNSURPRISING for e in changed if e.t_ns in away):
            return changed
    return None


def _readings(entries: Sequence[Entry], last: int) -> tuple[set[int], list[int]]:
    """Since the last position, newest first: stamps of the readings turned away at the end, places of those before."""
    away: set[int] = set()
    taken: list[int] = []
    for i in range(last, 0, -1):
        if entries[i].taken.position:
            break
        if entries[i].taken.used == (Kind.LASER,):
            taken.append(i)
        elif not taken and any(r.kind is Kind.LASER for r in entries[i].taken.rejected):
            away.add(entries[i].t_ns)
    return away, taken


def livelier(history: History, agreed: Sequence[Measurement], apply: Apply, usual_psd: float) -> list[Entry] | None:
    """The entries with a target that moves more, where all positions that were turned away then fit; or None."""
    first = history.place(agreed[0].t_ns - 1)
    if first == 0:
        return None
    before = history.entries[first - 1]
    noise = before.after.noise
    times = {m.t_ns for m in agreed}
    for factor in LIVELIER:
        psd = min(noise.acceleration_psd * factor, MOST * usual_psd)
        awake = replace(before, after=replace(before.after, noise=replace(noise, acceleration_psd=psd)))
        changed = again([*history.entries[: first - 1], awake], history.entries[first:], apply)
        if all(e.taken.position for e in changed if e.t_ns in times and e.inputs):
            return changed
    return None


def again(done: list[Entry], later: Sequence[Entry], apply: Apply) -> list[Entry]:
    """Entries that are done, and later ones done anew after them."""
    entries = list(done)
    for old in later:
        entries.append(apply(entries[-1].after, old.t_ns, old.inputs))
    return entries
