"""What can be the matter with a part, in plain words and with what to do about it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from leadline.samples import NS_PER_S


class Part(StrEnum):
    LEFT = "left"
    RIGHT = "right"
    LASER = "laser"
    DETECTOR = "detector"
    CLOCK = "clock"
    DISK = "disk"
    OUTPUT = "output"


class State(StrEnum):
    """The modes of ``simulation.faults``, as a reader sees them; after ok the worst first."""

    OK = "ok"
    OFF = "off"  # nothing comes, or nothing in it
    STUCK = "stuck"  # the same again and again
    GARBAGE = "garbage"  # noise
    WRONG = "wrong"  # plausible, and contradicted by the others
    SLOW = "slow"  # at a lower rate, or taking longer
    DELAYED = "delayed"  # at its rate, but late
    INTERMITTENT = "intermittent"  # now and then


Verdict = tuple[State, str] | None  # what is seen, with its numbers; None: nothing amiss


@dataclass(frozen=True, slots=True)
class Condition:
    """A part's state since ``since_ns``; ``why`` it is said, and what to do (``advice``): empty where all is well."""

    part: Part
    state: State
    since_ns: int
    why: str = ""
    advice: str = ""

    @property
    def ok(self) -> bool:
        return self.state is State.OK

    def __str__(self) -> str:
        said = f"{self.part} {self.state}"
        return said if self.ok else f"{said} since {self.since_ns / NS_PER_S:.1f} s: {self.why}; {self.advice}"


_CAMERA = {
    State.OFF: "check the lens cap, the lights, the cable and the camera's power",
    State.STUCK: "unplug the camera and plug it in again; it is restarted meanwhile",
    State.GARBAGE: "check the cable and the image format",
    State.WRONG: "check that left is left, that nothing has moved, and calibrate again if it lasts",
    State.SLOW: "a dark scene or a busy computer: fix the exposure, lower the resolution or the frame rate",
    State.DELAYED: "lower the resolution or the stream's buffer; close other programs",
    State.INTERMITTENT: "a loose plug, a long cable or a full USB bus: check the cable first",
}
_ADVICE: dict[Part, dict[State, str]] = {
    Part.LEFT: _CAMERA,
    Part.RIGHT: _CAMERA,
    Part.LASER: {
        State.OFF: "check its power, cable, port and baud rate",
        State.STUCK: "switch the laser off and on",
        State.GARBAGE: "check baud rate and protocol, then what the beam meets",
        State.WRONG: "clean its window, check what the beam meets and whether it has moved",
        State.SLOW: "a weak echo: clean its window, or set a faster mode",
        State.DELAYED: "use a faster baud rate, or declare its latency",
        State.INTERMITTENT: "a loose plug or a weak echo: check the cable, clean its window",
    },
    Part.DETECTOR: {
        State.OFF: "check the model; without it the target is followed by its outline only",
        State.STUCK: "restart the run",
        State.GARBAGE: "check that the model is one of this target",
        State.WRONG: "check the model against these images: `leadline detect`",
        State.SLOW: "close other programs, or take a smaller model",
        State.DELAYED: "close other programs, or take a smaller model",
        State.INTERMITTENT: "more light, or train it on such images: `leadline dataset`",
    },
    Part.CLOCK: dict.fromkeys(State, "synchronise the computer's clock (chrony), and set it before a dive"),
    Part.DISK: {
        State.OFF: "make room or change the disk; the dive goes on unrecorded",
        State.STUCK: "change the disk; the dive goes on unrecorded",
        State.GARBAGE: "change the disk: what it holds is not what was written",
        State.WRONG: "change the disk: what it holds is not what was written",
        State.SLOW: "use a faster disk, or record fewer images",
        State.DELAYED: "use a faster disk, or record fewer images",
        State.INTERMITTENT: "check the disk's plug and its room",
    },
    Part.OUTPUT: {
        State.OFF: "check the receiver and the network",
        State.STUCK: "check the receiver and the network",
        State.GARBAGE: "check the receiver's format",
        State.WRONG: "check the receiver's frames and units",
        State.SLOW: "check the network",
        State.DELAYED: "check the network",
        State.INTERMITTENT: "check the network's cable",
    },
}


def advice(part: Part, state: State) -> str:
    """What to do; empty where all is well."""
    return "" if state is State.OK else _ADVICE[part][state]
