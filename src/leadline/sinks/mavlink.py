"""Guidance to an autopilot or a ground station."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from leadline.guidance import Guidance, Guide
from leadline.health import Condition
from leadline.samples import NS_PER_S, Detection, Sample, Solution, StereoFrame
from leadline.wire.mavlink import MavlinkLink, guidance_messages, heartbeat, say

BEAT_NS = NS_PER_S
NS_PER_MS = 1_000_000


class MavlinkSink:
    """Each solution as it comes, a heartbeat once a second, an alarm and a failing part in words when they begin."""

    name: ClassVar[str] = "MAVLink"

    def __init__(self, link: MavlinkLink, guide: Guide) -> None:
        self._link, self._guide = link, guide
        self._first_ns: int | None = None
        self._beat_ns: int | None = None
        self._alarm = False
        self._told: dict[str, str] = {}
        link.open()

    def sample(self, sample: Sample) -> None:
        self._beat(sample.t_ns)

    def detections(self, frame: StereoFrame, detections: Sequence[Detection]) -> None:
        """Nothing: a box is no position."""

    def solution(self, solution: Solution) -> None:
        guidance = self._guide.of(solution)
        if guidance is None:
            self._alarm = False
            return
        self._link.send(guidance_messages(guidance, self._guide.T_body_left, self._boot_ms(guidance.t_ns)))
        self._cry(guidance)

    def health(self, conditions: Sequence[Condition], now_ns: int) -> None:
        self._beat(now_ns)
        for condition in conditions:
            before, self._told[condition.part] = self._told.get(condition.part, "ok"), condition.state
            if before != condition.state:
                self._link.send(say(f"leadline: {condition.part} {condition.state}", alert=not condition.ok))

    def close(self) -> None:
        self._link.close()

    def _beat(self, now_ns: int) -> None:
        if self._beat_ns is None or now_ns - self._beat_ns >= BEAT_NS:
            self._beat_ns = now_ns
            self._link.send(heartbeat())

    def _cry(self, guidance: Guidance) -> None:
        if guidance.alarm and not self._alarm:
            self._link.send(say(f"leadline: {guidance.range_m:.2f} m to the target", alert=True))
        self._alarm = guidance.alarm

    def _boot_ms(self, t_ns: int) -> int:
        """Milliseconds since the first solution: MAVLink's own stamp has 32 bits."""
        self._first_ns = t_ns if self._first_ns is None else self._first_ns
        return max((t_ns - self._first_ns) // NS_PER_MS, 0) & 0xFFFFFFFF
