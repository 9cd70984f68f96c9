"""To ROS 2 topics: what was found, and on a sensor's node what was measured. Stamps are those of acquisition."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import ClassVar

from leadline.guidance import Guide
from leadline.health import Condition
from leadline.rig import Rig
from leadline.samples import Detection, Image, LaserRange, Sample, Solution, StereoFrame
from leadline.wire import ros2_definitions as topics
from leadline.wire import ros2_messages as ros2
from leadline.wire import ros2_results as results
from leadline.wire.images import encode_jpeg
from leadline.wire.ros2_node import Publisher, RosNode

TARGET_POINT, ANNOTATED = "/leadline/target_point", "/leadline/annotated/compressed"
GUIDANCE, ALARM = "/leadline/guidance", "/leadline/alarm"
TF, TF_STATIC, TF_TYPE = "/tf", "/tf_static", "tf2_msgs/msg/TFMessage"
JPEG_QUALITY = 80
Draw = Callable[[Image, Sequence[Detection]], Image]


class Ros2Sink:
    """draw: makes the annotated picture, which is sent only while somebody listens. close: lets go of the node."""

    name: ClassVar[str] = "ROS 2"

    def __init__(
        self, node: RosNode, rig: Rig, guide: Guide, draw: Draw, close: Callable[[], None] = lambda: None
    ) -> None:
        self._guide, self._draw, self._rig, self._close = guide, draw, rig, close
        self._target = _must(node, topics.TARGET)
        self._point = _must(node, TARGET_POINT, "geometry_msgs/msg/PointStamped")
        self._diagnostics = _must(node, topics.DIAGNOSTICS)
        self._guidance = _must(node, GUIDANCE, "std_msgs/msg/String")
        self._alarm = _must(node, ALARM, "std_msgs/msg/Bool")
        self._annotated = _must(node, ANNOTATED, "sensor_msgs/msg/CompressedImage", reliable=False)
        self._detections = node.publisher(topics.DETECTIONS, topics.TOPIC_TYPES[topics.DETECTIONS])
        self._tf = node.publisher(TF, TF_TYPE)
        self._tf_static = node.publisher(TF_STATIC, TF_TYPE, latched=True)
        self._still = True  # the frames that stand still are to be told

    def sample(self, sample: Sample) -> None:
        if self._still and self._tf_static is not None:
            self._tf_static.send(results.rig_transforms(self._rig, self._guide.T_body_left, sample.t_ns))
        self._still = False

    def detections(self, frame: StereoFrame, detections: Sequence[Detection]) -> None:
        if self._detections is not None:
            self._detections.send(ros2.detections_message(frame.t_ns, detections))
        if self._annotated.listeners:
            picture = encode_jpeg(self._draw(frame.left, detections), JPEG_QUALITY)
            self._annotated.send(ros2.compressed_image(frame.t_ns, ros2.LEFT_FRAME, picture))

    def solution(self, solution: Solution) -> None:
        guidance = self._guide.of(solution)
        if guidance is not None:
            self._target.send(ros2.target_message(solution))
            self._point.send(results.point_message(solution))
            if self._tf is not None:
                self._tf.send(results.target_transform(solution))
        self._alarm.send({"data": guidance is not None and guidance.alarm})
        self._guidance.send(results.guidance_text(solution, guidance))

    def health(self, conditions: Sequence[Condition], now_ns: int) -> None:
        self._diagnostics.send(results.health_message(conditions, now_ns))

    def close(self) -> None:
        self._close()


class Ros2Samples:
    """Frames, readings, or both, as they come from their sensors."""

    def __init__(self, node: RosNode, rig: Rig | None, *, frames: bool, readings: bool, reliable: bool) -> None:
        self._infos = None if rig is None or not frames else ros2.camera_infos(rig)
        images = (topics.LEFT_IMAGE, topics.RIGHT_IMAGE) if frames else ()
        infos = (topics.LEFT_INFO, topics.RIGHT_INFO) if self._infos is not None else ()
        self._images = [_must(node, topic, reliable=reliable) for topic in images]
        self._info_topics = [_must(node, topic, reliable=reliable) for topic in infos]
        self._range = _must(node, topics.LASER, reliable=reliable) if readings else None

    def send(self, sample: Sample) -> None:
        if isinstance(sample, StereoFrame):
            self._frame(sample)
        elif isinstance(sample, LaserRange) and self._range is not None:
            self._range.send(ros2.range_message(sample))

    def _frame(self, frame: StereoFrame) -> None:
        if not self._images:
            return
        encoded = frame.encoded or (encode_jpeg(frame.left), encode_jpeg(frame.right))
        stamps = (frame.left_t_ns or frame.t_ns, frame.right_t_ns or frame.t_ns)
        names = (ros2.LEFT_FRAME, ros2.RIGHT_FRAME)
        for publisher, t_ns, name, data in zip(self._images, stamps, names, encoded, strict=True):
            publisher.send(ros2.compressed_image(t_ns, name, data))
        for publisher, t_ns, info in zip(self._info_topics, stamps, self._infos or (), strict=True):
            publisher.send(ros2.at(info, t_ns))


def _must(node: RosNode, topic: str, kind: str | None = None, *, reliable: bool = True) -> Publisher:
    """A topic whose message every ROS 2 has."""
    publisher = node.publisher(topic, kind or topics.TOPIC_TYPES[topic], reliable=reliable)
    assert publisher is not None, topic
    return publisher
