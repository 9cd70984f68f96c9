"""Whether the board is held still, by how fast its corners go from frame to frame."""

from __future__ import annotations

import numpy as np

from leadline.samples import NS_PER_S, Array, StereoFrame

FASTEST = 0.025
"""Parts of the picture's width a second: half a pixel of 1920 in an exposure of 10 ms."""
APART_PX = 0.25
"""That the corners may move between the exposures of the two cameras, where these are known to differ."""
HOLD_S = 0.4
GAP_S = 1.0  # frames farther apart say nothing of each other


class Steady:
    """stills: the source gives pictures of boards that were held (a folder); only what moves within a second moves."""

    def __init__(self, *, stills: bool) -> None:
        self._stills = stills
        self._last: tuple[int, Array] | None = None
        self._since_ns: int | None = None

    def judge(self, frame: StereoFrame, left_px: Array) -> bool:
        """Whether it has been still for HOLD_S, by the frame's own time."""
        last, self._last = self._last, (frame.t_ns, left_px)
        gap_s = float("inf") if last is None else (frame.t_ns - last[0]) / NS_PER_S
        if last is None or not 0 < gap_s < GAP_S or last[1].shape != left_px.shape:
            self._since_ns = frame.t_ns
            return self._stills
        speed_px_s = float(np.linalg.norm(left_px - last[1], axis=1).max()) / gap_s
        if speed_px_s > _allowed_px_s(frame):
            self._since_ns = None
            return False
        self._since_ns = last[0] if self._since_ns is None else self._since_ns
        return frame.t_ns - self._since_ns >= HOLD_S * NS_PER_S

    def forget(self) -> None:
        """The board is out of view."""
        self._last = self._since_ns = None


def _allowed_px_s(frame: StereoFrame) -> float:
    fastest = FASTEST * float(frame.left.shape[1])
    if frame.left_t_ns is None or frame.right_t_ns is None:
        return fastest
    apart_s = abs(frame.left_t_ns - frame.right_t_ns) / NS_PER_S
    return min(fastest, APART_PX / max(apart_s, 1e-6))
