"""The recorder: samples as they came through the one door, and what became of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from leadline.health import Part, State, Verdict
from leadline.rig import Rig
from leadline.samples import Detection, LaserRange, Sample, Solution, StereoFrame, Truth, VehicleMotion
from leadline.sinks.control import Event
from leadline.wire import ros2_definitions as topics
from leadline.wire import ros2_messages as ros2
from leadline.wire.images import encode_png
from leadline.wire.recording import RecordingWriter
from leadline.wire.rig_text import rig_to_text
from leadline.wire.truth import truth_text

EVENT_NAME = "leadline/event"  # of what somebody marked, on /diagnostics


class McapSink:
    """Replaying the file gives the same samples, bit for bit. Each frame goes to the disk as it is written.

    While the disk takes nothing, ``sample`` raises OSError and ``check`` says why; what comes is kept for when there is
    room again, up to 64 MiB. What is lost beyond that stands in the file, as a warning on /diagnostics.
    """

    part: ClassVar[Part] = Part.DISK

    def __init__(self, path: Path | str, rig: Rig | None = None, truth: Sequence[Truth] = ()) -> None:
        attachments = []
        if rig is not None:
            attachments.append(("rig.yaml", "application/yaml", rig_to_text(rig)))
        if truth:
            attachments.append(("truth.csv", "text/csv", truth_text(truth).encode()))
        self.name = Path(path).name
        self._writer = RecordingWriter(Path(path), attachments)
        self._camera_infos = None if rig is None else ros2.camera_infos(rig)
        self._arrival_ns = 0
        self._lost = 0

    def sample(self, sample: Sample) -> None:
        self._arrival_ns = sample.t_ns if sample.arrival_ns is None else sample.arrival_ns
        self._tell_lost(sample.t_ns)
        if isinstance(sample, LaserRange):
            self._write(topics.SAMPLE_INFO, ros2.laser_info(sample), sample.t_ns)
            self._write(topics.LASER, ros2.range_message(sample), sample.t_ns)
            self._writer.flush_if_due()
        elif isinstance(sample, VehicleMotion):
            self._write(topics.SAMPLE_INFO, ros2.motion_info(sample), sample.t_ns)
            self._write(topics.MOTION, ros2.motion_message(sample), sample.t_ns)
            self._writer.flush_if_due()
        else:
            self._frame(sample)
            self._writer.flush()

    def detections(self, frame: StereoFrame, detections: Sequence[Detection]) -> None:
        self._write(topics.DETECTIONS, ros2.detections_message(frame.t_ns, detections), frame.t_ns)

    def solution(self, solution: Solution) -> None:
        self._write(topics.DIAGNOSTICS, ros2.solution_diagnostic(solution), solution.t_ns)
        if solution.position_m is not None and solution.cov_m2 is not None:
            self._write(topics.TARGET, ros2.target_message(solution), solution.t_ns)

    def event(self, event: Event) -> None:
        self._arrival_ns = max(self._arrival_ns, event.t_ns)
        self._write(topics.DIAGNOSTICS, ros2.diagnostic(event.t_ns, EVENT_NAME, {}, text=event.text), event.t_ns)

    def check(self) -> Verdict:
        """While the disk takes nothing: why."""
        error = self._writer.error
        return None if error is None else (State.OFF, f"{error.strerror}: nothing is recorded")

    def close(self) -> None:
        self._writer.close()

    def _tell_lost(self, t_ns: int) -> None:
        if self._writer.lost > self._lost and self._writer.error is None:
            text = f"{self._writer.lost - self._lost} parts before this one are lost: the disk had no room"
            self._lost = self._writer.lost
            self._write(topics.DIAGNOSTICS, ros2.diagnostic(t_ns, "leadline/recorder", {}, level=1, text=text), t_ns)

    def _frame(self, frame: StereoFrame) -> None:
        left, right = frame.encoded or (encode_png(frame.left), encode_png(frame.right))
        left_ns = frame.t_ns if frame.left_t_ns is None else frame.left_t_ns
        right_ns = frame.t_ns if frame.right_t_ns is None else frame.right_t_ns
        self._write(topics.SAMPLE_INFO, ros2.frame_info(frame), frame.t_ns)
        self._write(topics.LEFT_IMAGE, ros2.compressed_image(left_ns, ros2.LEFT_FRAME, left), left_ns)
        self._write(topics.RIGHT_IMAGE, ros2.compressed_image(right_ns, ros2.RIGHT_FRAME, right), right_ns)
        if self._camera_infos is not None:
            self._write(topics.LEFT_INFO, ros2.at(self._camera_infos[0], left_ns), left_ns)
            self._write(topics.RIGHT_INFO, ros2.at(self._camera_infos[1], right_ns), right_ns)

    def _write(self, topic: str, message: ros2.Message, t_ns: int) -> None:
        self._writer.write(topic, message, log_ns=self._arrival_ns, publish_ns=t_ns)
