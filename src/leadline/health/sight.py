"""What can be told of a sensor only by the others: boxes that are nowhere, readings that the cameras contradict."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence

import numpy as np

from leadline.health.lateness import Lateness
from leadline.health.states import Part, State, Verdict
from leadline.samples import NS_PER_S, Detection, Kind, Solution, StereoFrame

VISION = frozenset({Kind.STEREO, Kind.SIZE, Kind.SPOT})
READINGS, AGAINST = 5, 4
FRAMES, FRAMES_AGAINST = 8, 6
UNPROVEN = 3  # times as many, of a sensor that has not agreed with the others for so many yet: who is wrong is open
RECENT_S = 1.5
APART = 5  # frames that do not match, at one go,
MATCHED, BEFORE = 7, 12  # while at least so many of so many before them did: all but one in eight of them
NEAREST_M = 0.6  # nearer, left and right may see different things
REACH = 1.0  # of a box's size: a target in view lies this near the middle of its box
Box = tuple[float, float, float, float]


class Boxes:
    """The detector's, from frame to frame."""

    def __init__(self) -> None:
        self._last: tuple[Box, ...] = ()
        self._picture: bytes = b""
        self._repeats = 0
        self._lateness = Lateness()

    def judge(
        self, frame: StereoFrame, detections: Sequence[Detection], expected_px: tuple[float, float] | None
    ) -> Verdict:
        boxes = tuple(detection.box_px for detection in detections)
        picture = frame.left[::32, ::32].tobytes()
        same = bool(boxes) and boxes == self._last and picture != self._picture
        self._repeats = self._repeats + 1 if same else 0
        self._last, self._picture = boxes, picture
        if self._repeats >= 2:
            return State.STUCK, "the same box in other pictures"
        rows, columns = frame.left.shape[:2]
        if not all(detection.is_in(columns, rows) for detection in detections):
            return State.GARBAGE, "a box that is not in the picture"
        if expected_px is None:
            return None
        if not boxes:
            return State.OFF, "does not see a target that is in view"
        if min(_off(box, expected_px) for box in boxes) > REACH:
            return State.WRONG, "sees it where it cannot be"
        x, y, width, height = min(boxes, key=lambda box: _off(box, expected_px))
        middle_px = np.array([x + width / 2, y + height / 2])
        return self._lateness.judge(frame.t_ns, middle_px, max(width, height), np.array(expected_px))


def _off(box: Box, point_px: tuple[float, float]) -> float:
    """Distance of a point from a box's middle, in the box's half size."""
    x, y, width, height = box
    return max(abs(point_px[0] - x - width / 2) / (width / 2), abs(point_px[1] - y - height / 2) / (height / 2)) / 2


class LeftAndRight:
    """Two pictures that showed one thing, and from one moment on do not, while the rest of the picture is still good.

    Of a ball the outlines tell, and in which camera it is not where the other one has it: its texture may be lost for
    seconds, as it turns. Of other targets the matches tell, if they were many before.
    """

    def __init__(self) -> None:
        self._matches: deque[bool] = deque(maxlen=BEFORE + APART)  # frames with the target
        self._apart = False
        self._whole = 0  # frames in which both showed it alike
        self._doubts: Counter[str] = Counter()  # by camera: frames on end that do not show it where the other does

    def see(self, solution: Solution) -> None:
        if Kind.STEREO in solution.used:
            self._matches.append(True)
            self._alike()
        elif doubted := {one.camera for one in solution.rejected if one.camera}:
            self._doubts = Counter({camera: self._doubts[camera] + 1 for camera in doubted})
        elif Kind.SIZE in solution.used:
            self._alike()
        elif any(one.kind is Kind.STEREO for one in solution.rejected):
            self._matches.append(False)
            near = solution.range_m is None or solution.range_m < NEAREST_M
            self._apart = self._apart or (self._broke() and not near and bool(solution.used))

    def _alike(self) -> None:
        self._whole += 1
        self._apart = False
        self._doubts.clear()

    def _broke(self) -> bool:
        """A target with too little texture, or too far away, matches now and then: that is not an end of it."""
        before, last = list(self._matches)[:-APART], list(self._matches)[-APART:]
        missed = len(before) - sum(before)
        return not any(last) and sum(before) >= MATCHED and missed <= len(before) // 8

    def verdict(self, part: Part) -> Verdict:
        if self._doubts[part.value] >= APART and self._whole >= MATCHED:
            return State.WRONG, "does not show the target where the other camera has it"
        if self._apart:
            return State.WRONG, "left and right do not fit together any more: one of them is wrong"
        return None


class Contradictions:
    """Measurements turned away again and again while another sensor's are taken."""

    def __init__(self) -> None:
        self._laser: deque[bool] = deque(maxlen=UNPROVEN * READINGS)
        self._vision: deque[bool] = deque(maxlen=UNPROVEN * FRAMES)
        self._proven: set[Kind] = set()
        self._laser_ns = self._vision_ns = -(10**18)  # when each was last taken
        self._pair = LeftAndRight()

    def see(self, solution: Solution) -> None:
        self._pair.see(solution)
        refuted = {one.kind for one in solution.rejected if one.nis is not None}  # not: beside the target, too late
        if Kind.LASER in solution.used or Kind.LASER in refuted:
            self._laser.append(Kind.LASER not in solution.used)
            self._prove(Kind.LASER, self._laser, READINGS)
        if Kind.LASER in solution.used:
            self._laser_ns = solution.t_ns
        if VISION & set(solution.used):
            self._vision_ns = solution.t_ns
            self._vision.append(False)
            self._prove(Kind.STEREO, self._vision, FRAMES)
        elif VISION & refuted:
            self._vision.append(True)

    def _prove(self, kind: Kind, against: deque[bool], count: int) -> None:
        if len(against) >= count and not any(list(against)[-count:]):
            self._proven.add(kind)

    def _refuted(self, kind: Kind, against: deque[bool], count: int, most: int) -> bool:
        """Whether most of the last were turned away, and not only of those before the last two."""
        times = 1 if kind in self._proven else UNPROVEN
        last = list(against)[-times * count :]
        return len(last) == times * count and sum(last) >= times * most and any(last[-2:])

    def verdict(self, part: Part, now_ns: int) -> Verdict:
        if part is Part.LASER:
            seen = now_ns - self._vision_ns < RECENT_S * NS_PER_S
            if seen and self._refuted(Kind.LASER, self._laser, READINGS, AGAINST):
                return State.WRONG, "its readings contradict what the cameras see"
            return None
        if (apart := self._pair.verdict(part)) is not None:
            return apart
        read = now_ns - self._laser_ns < RECENT_S * NS_PER_S
        if read and self._refuted(Kind.STEREO, self._vision, FRAMES, FRAMES_AGAINST):
            return State.WRONG, "what the cameras see contradicts the laser: one of them is wrong"
        return None
