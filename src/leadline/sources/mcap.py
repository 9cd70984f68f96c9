"""A recording as a source: the samples that the recorder saw, in the order in which it saw them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from leadline.errors import InputError
from leadline.samples import Sample, StereoFrame
from leadline.sources.base import Source, frame_size
from leadline.wire.images import SizeError
from leadline.wire.notice import Notice, NoticeKind
from leadline.wire.recording import RecordingReader
from leadline.wire.rig_text import rig_from_text
from leadline.wire.ros2_definitions import LASER, LEFT_IMAGE, MOTION, RIGHT_IMAGE, SAMPLE_INFO
from leadline.wire.ros2_samples import SampleAssembler
from leadline.wire.stamps import format_stamp
from leadline.wire.truth import parse_truth

_TOPICS = (LEFT_IMAGE, RIGHT_IMAGE, LASER, MOTION, SAMPLE_INFO)
Tell = Callable[[Notice], None]


class McapSource(Source):
    """A damaged or cut recording gives what can be read of it, and a notice. InputError if that is not one frame."""

    def __init__(self, path: Path, *, real_time: bool = False) -> None:
        self._path = path
        notices: list[Notice] = []
        reader = RecordingReader(path, lambda _: None)
        attached = reader.attachments()
        truth = attached.get("truth.csv")
        super().__init__(
            str(path),
            rig=rig_from_text(attached["rig.yaml"], f"{path}: rig.yaml") if "rig.yaml" in attached else None,
            truth=parse_truth(truth.decode(), f"{path}: truth.csv", notices.append) if truth else (),
            frame_count=reader.count(LEFT_IMAGE),
            image_size=self._first_size(),
            notices=notices,
            real_time=real_time,
        )

    def read(self) -> Iterator[Sample]:
        for sample in self._samples(self.note):
            where = f"{self._path} frame at {format_stamp(sample.t_ns)} s"
            if not isinstance(sample, StereoFrame) or self.fits(sample, where):
                yield sample

    def _samples(self, tell: Tell, *, strict: bool = False) -> Iterator[Sample]:
        """``strict``: raise SizeError for a pair of unequal images instead of leaving it out."""
        reader = RecordingReader(self._path, lambda why: tell(Notice(NoticeKind.TRUNCATED, str(self._path), why)))
        assembler = SampleAssembler(str(self._path), tell)
        for topic, message, log_ns in reader.messages(_TOPICS):
            try:
                sample = assembler.take(topic, message, log_ns)
            except SizeError as error:
                if strict:
                    raise
                tell(Notice(NoticeKind.SKIPPED, f"{self._path} frame at {format_stamp(log_ns)} s", str(error)))
                continue
            except AttributeError as error:  # a damaged schema describes another message
                why = f"its message is none of {topic} ({error})"
                tell(Notice(NoticeKind.SKIPPED, f"{self._path} {topic} at {format_stamp(log_ns)} s", why))
                continue
            if sample is not None:
                yield sample
        assembler.finish()

    def _first_size(self) -> tuple[int, int]:
        told: list[Notice] = []
        try:
            for sample in self._samples(told.append, strict=True):
                if isinstance(sample, StereoFrame):
                    return frame_size(sample)
        except SizeError as error:
            raise InputError(str(error), str(self._path), "give left and right images of one camera pair") from None
        why = f" ({told[0].why})" if told else ""
        raise InputError(f"no stereo frame can be read{why}", str(self._path), "give a recording made with --record")
