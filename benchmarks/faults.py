"""Each of 7 parts fails in each of 7 ways in a small dive that runs as live: is it told in time, and is it over?

    python -m benchmarks.faults [--out out/faults.csv] [--seeds N] [--footage FILE]
    python -m benchmarks.faults --clean HOURS      # dives without a fault: how many flags?

A fault must be told within 1 s or 7 periods of its part, whichever is longer, of the first sample that it spoils, and
be over 2 s after its end; no solution may be silently wrong (``benchmarks.silent``'s measure), and a flag before the
fault is a false one. The localizer, the loop's track, its sinks' threads and the health are those of ``leadline run``;
detector, disk, output and clock are stand-ins, time is simulated.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np

from benchmarks.faults_dive import DIAMETER_M, SECONDS, Clock, Footage, LiveFootage, footage
from benchmarks.faults_parts import FailingDetector, FailingSink, Told, Window, failing_clock
from benchmarks.silent import SILENT_M, SILENT_SIGMAS
from leadline.health import Condition, Part
from leadline.localizer import Localizer
from leadline.pipeline.build import Steps
from leadline.pipeline.loop import Track
from leadline.pipeline.watch import Outlet, Watch, WatchedFinder
from leadline.samples import NS_PER_S, Solution, Status
from leadline.simulation.faults import Fault, Mode
from leadline.target import Sphere

CAMERA_HZ, LASER_HZ = 10.0, 3.0
START_S, LASTS_S, AFTER_S = 6.5, 3.5, 2.6
OVER_S = 2.0
FALSE_AN_HOUR = 1.0
SENSORS = {Part.LEFT, Part.RIGHT, Part.LASER}
MODES: tuple[Mode, ...] = get_args(Mode)
CONTRADICTED = {(part, "wrong") for part in (*SENSORS, Part.DETECTOR)} | {(Part.DETECTOR, "delayed")}


@dataclass(frozen=True, slots=True)
class Seen:
    """Of one dive. flagged_s: after the first sample that was spoilt; over_s: after the fault's end; None: never."""

    part: Part
    mode: Mode
    flagged_s: float | None
    over_s: float | None
    state: str  # the first that was told
    beside: str  # other parts that were flagged too
    false: int  # flags before the fault
    silent: int  # solutions

    @property
    def in_time(self) -> bool:
        return self.flagged_s is not None and self.flagged_s <= due_s(self.part)

    @property
    def over_in_time(self) -> bool:
        return self.over_s is not None and self.over_s <= OVER_S


def due_s(part: Part) -> float:
    return max(1.0, 7 / LASER_HZ if part is Part.LASER else 7 / CAMERA_HZ)


def watch(film: Footage, part: Part, mode: Mode, seed: int, *, blind: bool = False) -> Seen:
    """One dive with one fault. blind: without the localizer."""
    start_s = START_S + 0.37 * seed % 1.0
    window = Window(part, mode, start_s, start_s + LASTS_S)
    faults = []
    if part in SENSORS:
        faults = [Fault(sensor=part.value, mode=mode, start_s=start_s, end_s=window.end_s)]  # type: ignore[arg-type]
    events, silent, first_s = _dive(film, window, faults, seed, blind=blind)
    told = [event for event in events if not event.ok]
    mine = [event for event in told if event.part is part and event.since_ns >= start_s * NS_PER_S]
    ends = [event for event in events if event.ok and event.part is part]
    last = [event for event in events if event.part is part][-1:]
    over = ends[-1].since_ns / NS_PER_S - window.end_s if ends and last and last[0].ok else None
    return Seen(
        part,
        mode,
        max(mine[0].since_ns / NS_PER_S - first_s, 0.0) if mine else None,
        over,
        str(mine[0].state) if mine else "",
        "+".join(sorted({str(event.part) for event in told if event.part is not part})),
        sum(event.since_ns < start_s * NS_PER_S for event in told),
        silent,
    )


def _dive(
    film: Footage, window: Window, faults: list[Fault], seed: int, *, blind: bool
) -> tuple[list[Condition], int, float]:
    """The changes of state, how many solutions were silently wrong, and when the first sample was spoilt."""
    source = LiveFootage(film, seed, faults, failing_clock(window, seed))
    thinking = Clock()
    failing = FailingDetector(film, window, thinking, seed)
    finder = WatchedFinder(failing, live=True, clock=thinking)
    watch = Watch(source, film.rig, finder)
    sinks = [FailingSink(part, window, Clock(), seed) for part in (Part.DISK, Part.OUTPUT)]
    outlets = [Outlet(sink, watch.health, lambda: source.now_ns, live=True, clock=sink.clock) for sink in sinks]
    solutions: list[Solution] = []
    seeing = window.part in SENSORS or window.part is Part.DETECTOR
    localizer: Steps = Localizer(film.rig, Sphere(DIAMETER_M), finder) if seeing and not blind else Told(film, finder)
    track = Track("fused", localizer, outlets, watch)
    end_s = window.end_s + AFTER_S
    for sample in source:
        now_s = source.now_ns / NS_PER_S
        if now_s > end_s:
            break
        if window.mode == "stuck" and now_s >= window.end_s:
            for sink in sinks:
                sink.released.set()
        solution = track.take(sample)
        if solution is not None:
            solutions.append(solution)
        _settle(outlets, sinks, window, now_s)
    for outlet in outlets:
        outlet.close()
    firsts = [source.first_spoilt_s(), failing.first_s, *(sink.first_s for sink in sinks)]
    first_s = min((one for one in firsts if one is not None and window.mode == "intermittent"), default=window.start_s)
    return list(watch.health.events), sum(_is_silent(one, film) for one in solutions), first_s


def _settle(outlets: Sequence[Outlet], sinks: Sequence[FailingSink], window: Window, now_s: float) -> None:
    """Threads take no simulated time: let them finish, but for one that hangs."""
    for outlet, sink in zip(outlets, sinks, strict=True):
        if outlet.worker is not None and window.mode_of(sink.part, now_s) != "stuck":
            outlet.worker.settle(10.0)
        outlet.collect()


def _is_silent(one: Solution, film: Footage) -> bool:
    truth = film.truth.get(one.t_ns)
    if one.status is not Status.VALID or truth is None or one.range_m is None or one.range_sigma_m is None:
        return False
    off_m = abs(one.range_m - truth.range_m)
    return off_m > SILENT_SIGMAS * one.range_sigma_m and off_m > SILENT_M


def clean(hours: float, first: int = 1000) -> bool:
    """Dives of their own without a fault, until they are so long; prints each flag. Whether they are rare enough."""
    passed_s, flags, silent, seed = 0.0, 0, 0, first
    while passed_s < hours * 3600:
        film, never = footage(seed=seed), Window(Part.DETECTOR, "off", SECONDS, SECONDS)  # whom the localizer asks
        events, wrong, _ = _dive(film, never, [], seed, blind=False)
        told = [event for event in events if not event.ok]
        for event in told:
            print(f"dive {seed}, {event}", flush=True)
        passed_s, flags, silent, seed = passed_s + SECONDS, flags + len(told), silent + wrong, seed + 1
    print(f"{passed_s / 3600:.2f} h in {seed - first} dives: {flags} false flags, {silent} solutions silently wrong")
    return flags <= FALSE_AN_HOUR * hours and not silent


def rows(seen: Sequence[Seen]) -> Iterator[dict[str, object]]:
    """One for each part and mode, over the seeds."""
    for part in Part:
        for mode in MODES:
            of = [one for one in seen if (one.part, one.mode) == (part, mode)]
            if of:
                yield _row(part, mode, of)


def _row(part: Part, mode: Mode, of: Sequence[Seen]) -> dict[str, object]:
    flagged = [one.flagged_s for one in of if one.flagged_s is not None]
    over = [one.over_s for one in of if one.over_s is not None]
    return {
        "part": str(part),
        "mode": mode,
        "dives": len(of),
        "due_s": round(due_s(part), 2),
        "flagged_in_time": sum(one.in_time for one in of),
        "flagged_median_s": round(float(np.median(flagged)), 2) if flagged else "",
        "flagged_max_s": round(max(flagged), 2) if len(flagged) == len(of) else "",
        "over_in_time": sum(one.over_in_time for one in of),
        "over_max_s": round(max(over), 2) if len(over) == len(of) else "",
        "told_as": "+".join(sorted({one.state for one in of if one.state})),
        "beside": "+".join(sorted({name for one in of for name in one.beside.split("+") if name})),
        "false_flags": sum(one.false for one in of),
        "silent": sum(one.silent for one in of),
    }


def cases(parts: Iterable[Part] = tuple(Part), modes: Iterable[Mode] = MODES) -> list[tuple[Part, Mode]]:
    modes = tuple(modes)
    return [(part, mode) for part in parts for mode in modes]


def main(words: Sequence[str] | None = None) -> bool:
    """Print the table; whether every fault of every dive was told and over in time and nothing was silently wrong."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.faults")
    parser.add_argument("--out", type=Path, default=Path("out/faults.csv"))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--footage", type=Path, help="keeps the rendered dive")
    parser.add_argument("--parts", nargs="+", type=Part, default=list(Part))
    parser.add_argument("--modes", nargs="+", choices=MODES, default=MODES)
    parser.add_argument("--clean", type=float, metavar="HOURS", help="instead: dives without a fault")
    parser.add_argument("--quick", action="store_true", help="the localizer only where nothing else can tell the fault")
    options = parser.parse_args(words)
    if options.clean is not None:
        return clean(options.clean)
    film = footage(options.footage)
    seen: list[Seen] = []
    for part, mode in cases(options.parts, options.modes):
        blind = options.quick and (part, mode) not in CONTRADICTED
        of = [watch(film, part, mode, seed, blind=blind) for seed in range(options.seeds)]
        seen += of
        row = _row(part, mode, of)
        if len(seen) == len(of):
            print("  ".join(row), flush=True)
        print("  ".join(str(value) or "-" for value in row.values()), flush=True)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with options.out.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, list(next(rows(seen))), lineterminator="\n")
        table.writeheader()
        table.writerows(rows(seen))
    good = sum(one.in_time and one.over_in_time and not one.silent for one in seen)
    print(
        f"{good} of {len(seen)} faults told and over in time; told in time {sum(o.in_time for o in seen)}, over in "
        f"time {sum(o.over_in_time for o in seen)}, {sum(o.silent for o in seen)} solutions silently wrong, "
        f"{sum(o.false for o in seen)} false flags in {len(seen) * START_S / 3600:.2f} h before the faults"
    )
    return good == len(seen)


if __name__ == "__main__":
    sys.exit(0 if main() else 1)
