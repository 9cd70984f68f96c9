"""All parts together: samples, work and reports in; conditions out. No clock inside: time comes with each event."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from leadline.health.content import Pictures, Ranges, Scene
from leadline.health.lag import LATE_S, Lag
from leadline.health.pace import Pace
from leadline.health.sight import Boxes, Contradictions
from leadline.health.states import Condition, Part, State, Verdict, advice
from leadline.health.work import Work
from leadline.samples import NS_PER_S, Detection, Image, Sample, Solution, StereoFrame, VehicleMotion

WELL_S = 0.5  # without any sign of a fault
WELL_EVENTS = 1
EVENTS_KEPT = 200
CAMERAS = (Part.LEFT, Part.RIGHT)
SEVERITY = tuple(State)[1:]  # the worst first
WORKERS = (Part.DETECTOR, Part.DISK, Part.OUTPUT)


class _Standing:
    """A part's condition, raised at once and taken back only after a while without any sign of the fault."""

    def __init__(self, part: Part, now_ns: int) -> None:
        self.condition = Condition(part, State.OK, now_ns)
        self._bad_ns, self._good = now_ns, 0

    def judge(self, verdict: Verdict, now_ns: int, *, fresh: bool) -> bool:
        """Whether the state has changed. ``fresh``: the part itself has just been heard of."""
        before = self.condition
        if verdict is not None:
            self._bad_ns, self._good = now_ns, 0
            state, why = verdict
            since_ns = now_ns if before.ok else before.since_ns
            self.condition = Condition(before.part, state, since_ns, why, advice(before.part, state))
        elif not before.ok:
            self._good += fresh
            if self._good >= WELL_EVENTS and now_ns - self._bad_ns >= WELL_S * NS_PER_S:
                self.condition = Condition(before.part, State.OK, now_ns)
        return before.state is not self.condition.state


class Health:
    """parts: those that are there (others join when they are first heard of). periods_s: of sensors, where known."""

    def __init__(self, parts: Iterable[Part] = (), periods_s: Mapping[Part, float] | None = None) -> None:
        self._now_ns: int | None = None  # of the latest event
        self._periods_s = dict(periods_s or {})
        self._standings: dict[Part, _Standing] = {}
        self._paces: dict[Part, Pace] = {}
        self._lags: dict[str, Lag] = {}
        self._clock: Verdict = None  # what they say of it
        self._clock_known = True  # and nothing has been added to them since
        self._own_lags = {part: Lag() for part in CAMERAS}
        self._taken_ns: dict[Part, int] = {}  # each camera's last picture
        self._pictures = {part: Pictures() for part in CAMERAS}
        self._ranges, self._scene = Ranges(), Scene()
        self._work: dict[Part, dict[str, Work]] = {part: {} for part in WORKERS}  # by who does it
        self._boxes, self._contradictions = Boxes(), Contradictions()
        self._reported: dict[Part, tuple[State, str]] = {}
        self._flags: Counter[tuple[Part, State]] = Counter()
        self.events: deque[Condition] = deque(maxlen=EVENTS_KEPT)  # each change of a state, the latest last
        self.conditions: tuple[Condition, ...] = ()  # replaced as a whole: safe to read from another thread
        for part in parts:
            self._join(part)
        self._publish()

    # -- what happens ------------------------------------------------------------------------------------------------

    def sample(self, sample: Sample, now_ns: int | None = None) -> None:
        """A sample has arrived (now_ns; default: its own arrival time, else its stamp)."""
        arrival_ns = sample.t_ns if sample.arrival_ns is None else sample.arrival_ns
        now_ns = arrival_ns if now_ns is None else now_ns
        if isinstance(sample, VehicleMotion):
            self.tick(now_ns)
            return
        if isinstance(sample, StereoFrame):
            self._stamp("camera", arrival_ns, sample.t_ns)
            self._look(Part.LEFT, sample.left, sample.left_t_ns, sample)
            self._look(Part.RIGHT, sample.right, sample.right_t_ns, sample)
            self._scene.look(sample.t_ns, sample.left)
            self._judge(now_ns, CAMERAS)
            return
        self._timing("laser", (Part.LASER,), arrival_ns, sample.t_ns)
        self._ranges.read(sample, moving=self._scene.moving)
        self._judge(now_ns, (Part.LASER,))

    def skipped(self, parts: Sequence[Part], t_ns: int, now_ns: int) -> None:
        """A sample has arrived and was left out by ourselves (overload): its sensor is alive."""
        self._timing("laser" if Part.LASER in parts else "camera", parts, now_ns, t_ns)
        self._judge(now_ns, parts)

    def refused(self, now_ns: int, why: str, *, garbage: bool) -> None:
        """The laser said something that is no reading: an error of its own, or bytes that nobody understands."""
        self._join(Part.LASER)
        self._paces[Part.LASER].arrive(now_ns, now_ns)
        if garbage:
            self._ranges.refuse(why)
        self._judge(now_ns, (Part.LASER,))

    def found(
        self,
        frame: StereoFrame,
        detections: Sequence[Detection],
        now_ns: int,
        took_s: float,
        expected_px: tuple[float, float] | None = None,
    ) -> None:
        """What the detector found in a frame. expected_px: where the target must be, if it must be in view."""
        fault = self._boxes.judge(frame, detections, expected_px)
        self.done(Part.DETECTOR, now_ns, took_s, fault)

    def solved(self, solution: Solution, now_ns: int) -> None:
        """What became of the last sample: measurements that contradict each other speak against a sensor."""
        self._contradictions.see(solution)
        self._judge(now_ns, ())

    def asked(self, part: Part, asked_ns: int, now_ns: int | None = None, *, who: str = "") -> None:
        """The detector, the disk or an output was given something to do, and has not done it yet.

        who: of several that share the part. Each is judged for itself, and the part by the worst of them.
        """
        self._join(part)
        self._worker(part, who).asked(asked_ns)
        self._judge(asked_ns if now_ns is None else now_ns, (), only=part)

    def done(
        self, part: Part, now_ns: int, took_s: float, fault: Verdict = None, lag_s: float = 0.0, *, who: str = ""
    ) -> None:
        """It is done. fault: what was wrong with it (an error: off); lag_s: the age of what it answers."""
        self._join(part)
        self._worker(part, who).done(took_s, fault, lag_s)
        self._judge(now_ns, (part,), only=part)

    def left(self, part: Part, who: str) -> None:
        """It is given nothing more to do: what it did counts no longer."""
        self._work[part].pop(who, None)

    def reported(self, part: Part, state: State, why: str, now_ns: int) -> None:
        """Somebody knows: a port that is gone, a full disk. ``State.OK`` takes it back."""
        self._join(part)
        if state is State.OK:
            self._reported.pop(part, None)
        else:
            self._reported[part] = state, why
        self._judge(now_ns, (part,))

    def wall_clock(self, wall_ns: int, now_ns: int) -> None:
        """The computer's own clock against one that cannot be set (now_ns), about ten times a second."""
        self._join(Part.CLOCK)
        self._stamp("wall", now_ns, wall_ns)

    def tick(self, now_ns: int) -> None:
        """Time passes and nothing has come."""
        self._judge(now_ns, ())

    # -- what it comes to --------------------------------------------------------------------------------------------

    @property
    def ok(self) -> bool:
        return all(condition.ok for condition in self.conditions)

    def state(self, part: Part) -> State:
        standing = self._standings.get(part)
        return State.OK if standing is None else standing.condition.state

    def summary(self) -> dict[str, Any]:
        """For ``summary.json``: how often each state was entered, what stands now, the first and last changes."""
        flags: dict[str, dict[str, int]] = {}
        for (part, state), count in sorted(self._flags.items()):
            flags.setdefault(str(part), {})[str(state)] = count
        return {
            "parts": {str(condition.part): str(condition.state) for condition in self.conditions},
            "flags": flags,
            "last": [str(event) for event in self.events],
        }

    # -- inside ------------------------------------------------------------------------------------------------------

    def _join(self, part: Part) -> None:
        if part in self._standings:
            return
        self._standings[part] = _Standing(part, self._now_ns or 0)
        if part in (*CAMERAS, Part.LASER):
            self._paces[part] = Pace(self._periods_s.get(part))
            self._join(Part.CLOCK)

    def _look(self, part: Part, image: Image, own_ns: int | None, frame: StereoFrame) -> None:
        """A camera's own picture: one that is stamped as the one before it is no new one."""
        arrival_ns = frame.t_ns if frame.arrival_ns is None else frame.arrival_ns
        taken_ns = frame.t_ns if own_ns is None else own_ns
        self._join(part)
        if own_ns is not None and own_ns == self._taken_ns.get(part):
            return
        self._taken_ns[part] = taken_ns
        self._own_lags[part].add(arrival_ns, taken_ns)
        self._paces[part].arrive(arrival_ns, taken_ns)
        self._pictures[part].look(image)

    def _timing(self, name: str, parts: Sequence[Part], arrival_ns: int, t_ns: int) -> None:
        self._stamp(name, arrival_ns, t_ns)
        for part in parts:
            self._join(part)
            self._paces[part].arrive(arrival_ns, t_ns)

    def _stamp(self, name: str, arrival_ns: int, t_ns: int) -> None:
        self._lags.setdefault(name, Lag()).add(arrival_ns, t_ns)
        self._clock_known = False

    def _judge(self, now_ns: int, heard: Sequence[Part], only: Part | None = None) -> None:
        """Look at all parts again, as the silence of one is seen when another is heard; ``only``: at this one."""
        now_ns = self._now_ns = max(self._now_ns or now_ns, now_ns)
        if not self._clock_known:
            self._clock, self._clock_known = self._judge_clock(), True
        changed = False
        for part in self._standings if only is None else (only,):
            changed |= self._judge_part(part, now_ns, fresh=part in heard or (part is Part.CLOCK and bool(heard)))
        if changed or len(self.conditions) != len(self._standings):
            self._publish()

    def _judge_part(self, part: Part, now_ns: int, *, fresh: bool) -> bool:
        """Whether its state has changed."""
        standing = self._standings[part]
        if not standing.judge(self._verdict(part, now_ns), now_ns, fresh=fresh):
            return False
        self.events.append(standing.condition)
        if not standing.condition.ok:
            self._flags[part, standing.condition.state] += 1
        return True

    def _verdict(self, part: Part, now_ns: int) -> Verdict:
        if part is Part.CLOCK:
            return self._clock
        if part in self._reported:
            return self._reported[part]
        if part in WORKERS:
            return self._worst(part, now_ns)
        late = None if self._clock is not None else self._lag(part).late()
        return (
            self._paces[part].verdict(now_ns)
            or self._content(part)
            or late
            or self._contradictions.verdict(part, now_ns)
        )

    def _worker(self, part: Part, who: str) -> Work:
        return self._work[part].setdefault(who, Work())

    def _worst(self, part: Part, now_ns: int) -> Verdict:
        verdicts = [verdict for work in self._work[part].values() if (verdict := work.verdict(now_ns)) is not None]
        return min(verdicts, key=lambda verdict: SEVERITY.index(verdict[0]), default=None)

    def _content(self, part: Part) -> Verdict:
        if part is Part.LASER:
            return self._ranges.verdict()
        seen = self._pictures[part].verdict()
        if seen is None and self._pictures[Part.LEFT].print and self._twins():
            return State.WRONG, "left and right give the same picture"
        return seen

    def _twins(self) -> bool:
        return self._pictures[Part.LEFT].print == self._pictures[Part.RIGHT].print

    def _lag(self, part: Part) -> Lag:
        return self._own_lags[part] if part in CAMERAS else self._lags.setdefault("laser", Lag())

    def _judge_clock(self) -> Verdict:
        """Stamps that cannot be: of one sensor, or all late alike, which is no delay of theirs."""
        for name, lag in self._lags.items():
            seen = lag.impossible()
            if seen is not None:
                whose = "the computer's clock" if name == "wall" else f"the {name}'s stamps"
                return seen[0], f"{whose}: {seen[1]}"
        heard = {name: lag for name, lag in self._lags.items() if lag.heard}
        judges = [heard["wall"]] if "wall" in heard else list(heard.values())
        if "wall" not in heard and len(judges) < 2:
            return None  # one sensor alone may be late itself
        recent = [lag.excess_s[-2:] for lag in judges]
        shifts = [min(excess, key=abs) for excess in recent if len(excess) == 2]
        if len(shifts) == len(judges) and min(map(abs, shifts)) > LATE_S and max(shifts) - min(shifts) < LATE_S:
            return State.WRONG, f"all stamps are {abs(shifts[0]):.1f} s {'behind' if shifts[0] > 0 else 'ahead'}"
        if all(lag.drifts() for lag in judges):
            return State.SLOW, "all stamps drift against the arrivals"
        return None

    def _publish(self) -> None:
        self.conditions = tuple(self._standings[part].condition for part in Part if part in self._standings)
