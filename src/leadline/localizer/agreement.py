"""Do the laser and the cameras agree? Two ways to one length, that of the beam, are compared all the time.

Each reading is set against what the cameras saw just before and after it: the spot, else the target where the beam
meets it. The differences of the last readings are explained by an offset (a calibration), a scale (the water) and a
clock (a difference that goes with the speed). An offset or a scale that the calibration's own uncertainty does not
explain is told, and stands in the stated sigma for as long as it lasts: nobody knows which of the two is right. So does
a spot that lies before or behind the surface that the same frame shows (exposures apart, a target of another shape).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import sqrt

from leadline.localizer.differences import Biases, Difference, biases, clock
from leadline.samples import NS_PER_S

KEPT = 30  # readings
FRAMES_KEPT = 60
LEAST = 6  # before anything is said
GAP_S = 0.6  # between two frames that a reading is compared with
TOLD_SIGMAS, COVERED_SIGMAS = 3.5, 2.0
IN_A_ROW = 3  # readings that contradict the cameras alike count at once
CLOCK_SIGMA_S, WIDE_CLOCK_S = 0.05, 1.0
CLOCK_TOLD_S = 0.1
WATERS = 0.03  # of the length: more is no other water
SURFACE_M = 0.002  # how far a target may stand off its ideal shape where the spot is
SPOTS, SPOTS_TOLD, SPOT_SIGMAS = 5, 5, 2.5  # frames: those that count, and how many contradictions are told


@dataclass(frozen=True, slots=True)
class Length:
    """The beam's length at a time, measured one way. variance_m2: noise of this one; common_m2: of the calibration.

    shape_m2: of where an unknown surface lies under the beam, which the frames share as well.
    """

    t_ns: int
    length_m: float
    variance_m2: float
    common_m2: float
    shape_m2: float = 0.0


class Agreement:
    def __init__(self) -> None:
        self._seen: deque[Length] = deque(maxlen=FRAMES_KEPT)
        self._waiting: list[Length] = []
        self._pairs: deque[Difference] = deque(maxlen=KEPT)
        self._beside: deque[tuple[float, float]] = deque(maxlen=SPOTS)  # spot against surface: difference, sigma
        self._contradictions = 0
        self._known: Biases | None = None
        self.clock_s = 0.0  # a reading stamped t was taken at t + clock_s: told only where it is far off
        self.notices: dict[str, str] = {}

    def see(self, seen: Length) -> None:
        """What a frame says of the length."""
        self._seen.append(seen)
        self._compare()

    def check(self, spot: Length, surface: Length) -> None:
        """The spot and the target's surface where the beam meets it, of one frame."""
        sigma_m = sqrt(spot.variance_m2 + surface.variance_m2 + surface.shape_m2 + SURFACE_M**2)
        self._beside.append((spot.length_m - surface.length_m, sigma_m))
        off_m = self._off_surface_m()
        self._contradictions += off_m > 0
        if off_m > 0 and self._contradictions >= SPOTS_TOLD:
            self.notices["surface"] = (
                f"the laser's spot is {1e3 * off_m:.0f} mm off the surface that the same frames show: "
                "do both cameras expose at one time? is the target of this shape?"
            )

    def _off_surface_m(self) -> float:
        """How far the last spots lie off the surface, beyond what their sigmas explain; else 0."""
        if len(self._beside) < IN_A_ROW:
            return 0.0
        off, sigma = (_median(values) for values in zip(*self._beside, strict=True))
        return abs(off) if abs(off) > SPOT_SIGMAS * sigma else 0.0

    def read(self, reading: Length, arrival_ns: int | None) -> None:
        """What the laser says; a stamp later than its own arrival is of a clock that is wrong by as much."""
        if arrival_ns is not None and reading.t_ns > arrival_ns:
            self._correct(min(self.clock_s, (arrival_ns - reading.t_ns) / NS_PER_S))
        self._waiting.append(reading)
        self._compare()

    @property
    def variance_m2(self) -> float:
        """What the present disagreement adds to the variance of a distance."""
        last = list(self._pairs)[-IN_A_ROW:]
        extra = self._off_surface_m() ** 2
        if len(last) == IN_A_ROW:
            values = [one.metres - self.clock_s * one.speed_m_s for one in last]
            sigma = max(sqrt(one.noise_m2 + one.common_m2 + (CLOCK_SIGMA_S * one.speed_m_s) ** 2) for one in last)
            if max(values) - min(values) < 5 * sigma < min(map(abs, values)):
                extra = max(extra, max(map(abs, values)) ** 2)
        if len(self._pairs) >= LEAST:
            for bias in self._biases():
                extra = max(extra, bias.metres**2 - COVERED_SIGMAS**2 * bias.variance_m2)
        return max(extra, 0.0)

    def _compare(self) -> None:
        """Every reading that now has a frame on either side."""
        left = []
        frames = sorted(self._seen, key=lambda seen: seen.t_ns)
        newest = frames[-1].t_ns if frames else None
        for reading in self._waiting:
            around = next((p for p in pairwise(frames) if p[0].t_ns <= reading.t_ns <= p[1].t_ns), None)
            if around is not None:
                self._pair(reading, *around)
            elif newest is None or reading.t_ns > newest - GAP_S * NS_PER_S:
                left.append(reading)
        self._waiting = left[-KEPT:]

    def _pair(self, reading: Length, before: Length, after: Length) -> None:
        gap_s = (after.t_ns - before.t_ns) / NS_PER_S
        if not 0 < gap_s <= GAP_S:
            return
        part = (reading.t_ns - before.t_ns) / NS_PER_S / gap_s
        length = before.length_m + part * (after.length_m - before.length_m)
        speed = (after.length_m - before.length_m) / gap_s
        noise = (1 - part) ** 2 * before.variance_m2 + part**2 * after.variance_m2 + reading.variance_m2
        speed_noise = (before.variance_m2 + after.variance_m2) / gap_s**2
        common = max(one.common_m2 + one.shape_m2 for one in (before, after)) + reading.common_m2
        self._pairs.append(Difference(reading.length_m - length, length, speed, noise, common, speed_noise))
        self._known = None
        if len(self._pairs) >= LEAST:
            self._tell(length)

    def _correct(self, clock_s: float) -> None:
        self.clock_s, late = clock_s, "early" if clock_s > 0 else "late"
        self._known = None
        if abs(clock_s) > CLOCK_TOLD_S:
            self.notices["clock"] = (
                f"the laser's stamps are {abs(clock_s):.2f} s too {late}: corrected, but set its clock"
            )

    def _biases(self) -> Biases:
        """Of the last readings."""
        if self._known is None:
            wide = WIDE_CLOCK_S if "clock" in self.notices else CLOCK_SIGMA_S
            self._known = biases(self._pairs, self.clock_s, wide)
        return self._known

    def _tell(self, length_m: float) -> None:
        late = clock(self._pairs, WIDE_CLOCK_S)
        if late is not None and abs(late[0]) > max(CLOCK_TOLD_S, TOLD_SIGMAS * late[1]):
            self._correct(late[0])
        if "clock" in self.notices:  # then differences are the clock's as much as the water's
            self.notices.pop("offset", None)
            return
        bias = max(self._biases(), key=lambda bias: bias.sigmas)
        if bias.sigmas < TOLD_SIGMAS:
            return
        how = "longer" if bias.metres > 0 else "shorter"
        share = abs(bias.metres) / length_m
        if share < WATERS:
            why = "is the water state right (pool or sea)?"
        else:
            why = f"{'does it pass the target, or ' if bias.metres > 0 else ''}is one of them faulty?"
        self.notices["offset"] = (
            f"the laser reads {1e3 * abs(bias.metres):.0f} mm ({share:.1%}) {how} than the cameras see its beam at "
            f"{length_m:.1f} m ({bias.sigmas:.1f} sigma): {why}"
        )


def _median(values: Sequence[float]) -> float:
    """Of a few numbers: NumPy's own takes thrice as long."""
    ordered, half = sorted(values), len(values) // 2
    return ordered[half] if len(ordered) % 2 else (ordered[half - 1] + ordered[half]) / 2
