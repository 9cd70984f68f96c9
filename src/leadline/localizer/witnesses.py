"""Who else says so? A distance is stated no better than it is known should any one sensor or method be wrong.

For each suspect (the laser, its spot, either camera, stereo, the outline, all pictures) an account is kept of what all
others say: how far off they see the target, along the line of sight, from where the filter has it, and how surely. So
satellite receivers watch over themselves (solution separation: Brown and McBurney 1988; Blanch et al. 2012).

- What the filter does on the word of a suspect is not known to the others: each of its corrections is noise in the
  accounts, of place and speed alike. An account that is spoken for shrinks again; one that is not stays as wide as the
  filter was moved meanwhile, and that is little as long as what is measured goes on as predicted.
- While the accounts are in harmony with their witnesses and with the filter, any one suspect may still be wrong, as
  far as its account allows: a fifth of that is the least sigma that is stated.
- Once witnesses contradict each other, the accounts that are in harmony say what is wrong: what their suspect says.
  How far the filter is off them stands in full in the stated sigma. So does an account that is off the filter for sure.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import sqrt

from leadline.estimation import Estimate
from leadline.samples import NS_PER_S, Kind, Measurement
from leadline.target import Target

METHOD = {Kind.LASER: "laser", Kind.SPOT: "spot", Kind.STEREO: "stereo", Kind.SIZE: "outline"}
PICTURES = "pictures"  # all that the cameras show: old, late, of something else
SUSPECTS = (*METHOD.values(), "left", "right", PICTURES)
GATE = 16.0  # 4 sigma: a witness farther off contradicts the account
SURE = 2.0  # sigmas that an account may be off
ALLOWED = 5.0  # stated sigmas that a wrong suspect may cost
APART = 3.0  # sigmas off the filter that an account is for sure
SPEED_M_S = 0.4  # how fast what one witness says may run away from what the filter says
LASTS_NS = NS_PER_S  # a witness counts so long
DISCREDITED_NS = 4 * NS_PER_S  # an account that had to begin again explains nothing for so long
MOVES = 16  # corrections that are remembered
LEAST_SLOPE = 0.3  # a beam that hardly grows with the distance is no witness of it


def _by(m: Measurement) -> frozenset[str]:
    """Who must be right for a measurement to be."""
    return m.cameras | ({METHOD[m.kind]} if m.kind is Kind.LASER else {METHOD[m.kind], PICTURES})


@dataclass(frozen=True, slots=True)
class Evidence:
    """A word: the target is ``off_m`` farther than the filter has it. common_m2: what no averaging removes."""

    kind: Kind
    by: frozenset[str]
    off_m: float
    variance_m2: float
    common_m2: float


@dataclass(slots=True)
class Account:
    """What is said without one suspect: how far off the filter's distance (m), its rate (m/s), and their covariance.

    Plain numbers: a matrix of four takes NumPy ten times as long.
    """

    begun: bool = False
    off_m: float = 0.0
    _rate_m_s: float = 0.0
    variance_m2: float = 0.0
    _mixed: float = 0.0
    _rate_variance: float = 0.0
    _discredited_ns: int = 0  # until then
    _taken: dict[Kind, int] = field(default_factory=dict)  # when
    _refused: dict[Kind, list[tuple[int, float]]] = field(default_factory=dict)  # when, how far off; those in a row

    def go_on(self, dt_s: float) -> None:
        self.off_m += dt_s * self._rate_m_s
        self.variance_m2 += dt_s * (2 * self._mixed + dt_s * self._rate_variance)
        self._mixed += dt_s * self._rate_variance

    def filter_moved(self, by_m: float, by_m_s: float) -> None:
        """The filter was corrected, on whose word ever."""
        self.variance_m2 += by_m**2
        self._mixed += by_m * by_m_s
        self._rate_variance += by_m_s**2

    def hear(self, said: Evidence, now_ns: int) -> None:
        if not self.begun:
            self._begin(said)
            return
        surprise = said.off_m - self.off_m
        total = self.variance_m2 + said.variance_m2
        if surprise**2 > GATE * total:
            self._refuse(said, now_ns)
            return
        self._refused.pop(said.kind, None)
        self._taken[said.kind] = now_ns
        least = min(self.variance_m2, said.common_m2)
        gain, rate_gain = self.variance_m2 / total, self._mixed / total
        self.off_m += gain * surprise
        self._rate_m_s += rate_gain * surprise
        self._rate_variance -= rate_gain * self._mixed
        self._mixed -= rate_gain * self.variance_m2
        self.variance_m2 = max((1 - gain) * self.variance_m2, least)

    def _refuse(self, said: Evidence, now_ns: int) -> None:
        """Begin again with it where it insists and no other has spoken for the account lately."""
        row = self._refused[said.kind] = [*self._refused.get(said.kind, [])[-1:], (now_ns, said.off_m)]
        others = [t_ns for kind, t_ns in self._taken.items() if kind is not said.kind]
        if now_ns - max(others, default=0) > LASTS_NS and _lead_on(row, said.variance_m2):
            self._begin(said)
            self._discredited_ns = now_ns + DISCREDITED_NS

    def _begin(self, said: Evidence) -> None:
        self.begun, self.off_m, self._rate_m_s = True, said.off_m, 0.0
        self.variance_m2, self._mixed, self._rate_variance = said.variance_m2, 0.0, SPEED_M_S**2

    def contradicted_m(self, now_ns: int) -> float:
        """How far off the filter those see the target whom the account has refused twice; 0: nobody."""
        rows = [row for row in self._refused.values() if len(row) > 1 and now_ns - row[-1][0] <= DISCREDITED_NS]
        return max((abs(row[-1][1]) for row in rows), default=0.0)

    def in_harmony(self, now_ns: int) -> bool:
        """Whether it has all its witnesses for it, and has had for a while."""
        return self.contradicted_m(now_ns) == 0 and now_ns >= self._discredited_ns

    def speaks_for_filter(self, now_ns: int) -> bool:
        """Whether all its witnesses agree with it, and it with the filter."""
        return bool(self._taken) and not self._refused and self.in_harmony(now_ns) and not self.apart

    def taken_lately(self, kind: Kind, now_ns: int) -> bool:
        return kind in self._taken and now_ns - self._taken[kind] <= LASTS_NS

    @property
    def apart(self) -> bool:
        """Whether it is off the filter for sure."""
        return self.off_m**2 > APART**2 * self.variance_m2

    @property
    def allowed_m(self) -> float:
        """How far off the filter the target may be by this account."""
        return abs(self.off_m) + SURE * sqrt(self.variance_m2)

    def expected_m2(self, now_ns: int) -> float:
        """How far off the filter the target is expected to be, by the account or by whom it has refused; squared."""
        return max(self.off_m**2 + self.variance_m2, self.contradicted_m(now_ns) ** 2)


def _lead_on(row: Sequence[tuple[int, float]], variance_m2: float) -> bool:
    """Whether the last two of those refused lead to one another."""
    if len(row) < 2:
        return False
    (t0_ns, off0_m), (t1_ns, off1_m) = row[-2:]
    return (off1_m - off0_m) ** 2 < GATE * (2 * variance_m2 + (SPEED_M_S * (t1_ns - t0_ns) / NS_PER_S) ** 2)


class Witnesses:
    """Of one track."""

    def __init__(self, target: Target, clock_sigma_s: float) -> None:
        self._target, self._clock_sigma_s = target, clock_sigma_s
        self.forget()

    def forget(self) -> None:
        self._accounts = {suspect: Account() for suspect in SUSPECTS}
        self._heard: set[str] = set()
        self._now_ns: int | None = None
        self._since_ns = 0
        self._moves: deque[tuple[int, float]] = deque(maxlen=MOVES)  # stamp of what was measured, how far it moved

    def now_ns(self, t_ns: int) -> int:
        """The newest time that was heard of, this one included."""
        return t_ns if self._now_ns is None else max(t_ns, self._now_ns)

    def moved(self, t_ns: int, now_ns: int, before: Estimate | None, after: Estimate) -> None:
        """Measurements of a time were taken, and the filter's estimate for now is another; before: None at first."""
        if self._now_ns is None:
            self._now_ns = self._since_ns = now_ns
        dt_s = (now_ns - self._now_ns) / NS_PER_S
        self._now_ns = now_ns
        if before is None:
            return
        (m, m_s), (was_m, was_m_s) = self._distance_and_speed(after), self._distance_and_speed(before)
        self._moves.append((t_ns, m - was_m))
        for account in self._accounts.values():
            account.go_on(dt_s)
            account.filter_moved(m - was_m, m_s - was_m_s)

    def hear(self, said: Evidence) -> None:
        assert self._now_ns is not None
        self._heard |= said.by
        for suspect, account in self._accounts.items():
            if suspect not in said.by:
                account.hear(said, self._now_ns)

    @property
    def alone_s(self) -> float | None:
        """How long somebody has been heard whom nobody else confirms; None once all have been confirmed."""
        heard = self._heard - {PICTURES}
        if self._now_ns is None or all(self._accounts[suspect].begun for suspect in heard):
            return None
        return (self._now_ns - self._since_ns) / NS_PER_S

    def blame(self, strange: Sequence[Measurement], others: Sequence[Measurement]) -> bool:
        """Whether one suspect behind all that is strange in a frame is wrong, rather than the filter.

        Some other must speak for the filter: in the same frame, or the laser, which has frames of its own, lately.
        """
        if self._now_ns is None:
            return False
        for suspect in frozenset.intersection(*(_by(m) for m in strange)):
            account = self._accounts[suspect]
            heard = account.taken_lately(Kind.LASER, self._now_ns) or any(suspect not in _by(m) for m in others)
            if heard and account.speaks_for_filter(self._now_ns):
                return True
        return False

    def variance_m2(self, t_ns: int) -> float:
        """What the stated variance of a distance must have besides, that is told for a time.

        Where later readings were there first, the filter's estimate for the time is without them, and the accounts are
        not: what they moved it by is no less uncertain.
        """
        if self._now_ns is None:
            return 0.0
        since_m = sum(by_m for taken_ns, by_m in self._moves if taken_ns > t_ns)
        now_ns = self._now_ns
        accounts = {s: self._accounts[s] for s in self._heard if self._accounts[s].begun}
        least = max((a.allowed_m for s, a in accounts.items() if s != PICTURES), default=0.0) / ALLOWED
        harmonic = [a for a in accounts.values() if a.in_harmony(now_ns)]
        agreed = len(harmonic) == len(accounts)
        telling = [a for a in harmonic if a.apart] if agreed else harmonic or accounts.values()
        return max([since_m**2, least**2, *(a.expected_m2(now_ns) for a in telling)])

    def evidence(self, m: Measurement, x: Estimate, common_m2: float, slack_m2: float = 0.0) -> Evidence | None:
        """What a measurement says against the estimate of its time; slack: how far the target may be aside."""
        by = _by(m)
        distance, gradient = self._target.range(x.x)
        if m.kind in (Kind.STEREO, Kind.SIZE):
            said, slope = self._target.range(m.z)
            return Evidence(m.kind, by, said - distance, float(slope @ m.cov @ slope), common_m2)
        late = x.laser_clock_s if m.kind is Kind.LASER else 0.0
        at = x.x.copy()
        at[:3] += late * x.velocity_m_s
        predicted = m.predict(at)
        if predicted is None:
            return None
        h, H = predicted
        sight = gradient[:3]
        slope_along = float(H[0, :3] @ sight)
        if abs(slope_along) < LEAST_SLOPE:
            return None
        across = H[0] - slope_along * gradient
        variance = float(m.cov[0, 0] + across @ x.cov @ across) / slope_along**2 + slack_m2
        if m.kind is Kind.LASER:  # its clock is known by the word of the others only
            by_clock_m2 = (self._clock_sigma_s * float(sight @ x.velocity_m_s)) ** 2
            variance, common_m2 = variance + by_clock_m2, common_m2 + by_clock_m2
        return Evidence(m.kind, by, float(m.z[0] - h[0]) / slope_along, variance, common_m2)

    def _distance_and_speed(self, estimate: Estimate) -> tuple[float, float]:
        distance, gradient = self._target.range(estimate.x)
        return distance, float(gradient[:3] @ estimate.velocity_m_s)
