"""A position was turned away: was it wrong, or was the filter? What happened is tried again in another way.

Two ways to be wrong are put right at once, and the entries of the history done again: a wrong position was taken
shortly before (``without_suspect``), or the target moves more than it did (``livelier``). What neither explains is an
outlier, until it goes on for so long that the filter starts again from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from leadline.estimation.adapt import MOST
from leadline.estimation.replay import Apply, Entry, History
from leadline.samples import NS_PER_S, Measurement

SUSPECT_FOR_S, UNSURPRISING = 0.3, 0.25  # a position may be taken back so much later, if the new one then fits well
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
