"""What speaks against the present estimate, in metres: it stands in the stated sigma until it is settled.

A filter that has refused a measurement, or has followed a surprising one, is as certain as before. Whoever reads its
sigma must not be: while nothing is seen, a leap of the readings may be the vehicle's or the laser's; a target that the
cameras see elsewhere may be there.
"""

from __future__ import annotations

from dataclasses import dataclass

SURPRISE = 9.0  # an innovation's square, in its variance: 3 sigma
WITHHELD_NS = 4_000_000_000
LASTS_NS = 1_000_000_000  # what the cameras saw elsewhere counts so long


@dataclass(slots=True)
class Doubt:
    leap_m: float = 0.0
    elsewhere_m: float = 0.0
    elsewhere_ns: int = 0
    since_ns: int = 0
    _refused: int = 0

    def settled(self) -> None:
        """The target was seen where it was believed to be."""
        self.leap_m = self.elsewhere_m = 0.0
        self._refused = 0

    def read_blindly(self, off_m: float, variance_m2: float, taken: bool) -> None:
        """A reading while nothing was seen. One alone that is refused is a stray; a second one is not."""
        self._refused = 0 if taken else self._refused + 1
        if off_m**2 > SURPRISE * variance_m2 and (taken or self._refused > 1):
            self.leap_m = max(self.leap_m, abs(off_m))

    def seen_elsewhere(self, t_ns: int, off_m: float) -> None:
        """All positions of a frame were refused, the first of them so far away."""
        if self.elsewhere_m == 0:
            self.since_ns = t_ns
        self.elsewhere_m, self.elsewhere_ns = abs(off_m), t_ns

    def withholds(self, t_ns: int, laser_ns: int | None) -> bool:
        """Whether positions that are refused are only refused: readings taken meanwhile, without a leap, speak for
        the present estimate, and the filter must not start again from what the cameras see elsewhere."""
        lasting = self.elsewhere_m > 0 and t_ns - self.since_ns < WITHHELD_NS
        return lasting and self.leap_m == 0 and laser_ns is not None and t_ns - laser_ns < LASTS_NS

    def variance_m2(self, t_ns: int) -> float:
        elsewhere_m = self.elsewhere_m if abs(t_ns - self.elsewhere_ns) <= LASTS_NS else 0.0
        return max(self.leap_m, elsewhere_m) ** 2
