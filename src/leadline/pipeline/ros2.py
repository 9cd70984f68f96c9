"""The paper's nodes (its section 2.1) with a lifecycle: camera, laser, localizer; all in one process, or one in each.

A node reads its parameters when it is configured, and works while it is active, in a thread of its own. What goes
wrong there (a camera that is gone, images of another size) is logged and tried again; the node stays.
"""

from __future__ import annotations

import signal
import threading
import time
import traceback
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from leadline.config import Config
from leadline.errors import InputError
from leadline.evaluation.drawing import draw_detections
from leadline.guidance import Guide
from leadline.pipeline.build import Job, build_job, stated_target, stated_water
from leadline.pipeline.loop import Track
from leadline.pipeline.watch import Watch
from leadline.rig import Rig
from leadline.samples import Sample, StereoFrame
from leadline.sinks import McapSink, Sink
from leadline.sinks.ros2 import Ros2Samples, Ros2Sink
from leadline.sources import Source, open_source, require_size
from leadline.sources.clock import LiveClock
from leadline.sources.live import LiveSource
from leadline.sources.ros2 import CameraInfos, RosTopics, StereoTopics, Tap
from leadline.sources.sync import arrival_ns
from leadline.wire.ros2_node import Activity, Ros, RosNode

RETRY_S = 1.0
JOIN_S = 10.0
INFO_S = 0.1
TOPIC_PARAMETERS = tuple(one.name for one in fields(StereoTopics))


class Working(Activity):
    """A node with a thread."""

    def __init__(self) -> None:
        self.node: RosNode | None = None
        self._thread: threading.Thread | None = None
        self._halt = threading.Event()

    def activate(self) -> None:
        self._halt.clear()
        self._prepare()
        self._thread = threading.Thread(target=self._persist, name=type(self).__name__, daemon=True)
        self._thread.start()

    def deactivate(self) -> None:
        self._halt.set()
        self._interrupt()
        if self._thread is not None:
            self._thread.join(JOIN_S)
            self._thread = None
        if self.node is not None:
            self.node.release()

    @property
    def _active(self) -> bool:
        return not self._halt.is_set()

    def _persist(self) -> None:
        assert self.node is not None
        while self._active:
            try:
                self._work()
                return
            except InputError as error:
                self.node.error(str(error))
            except Exception:
                self.node.error(traceback.format_exc())
            self._halt.wait(RETRY_S)

    @abstractmethod
    def _prepare(self) -> None:
        """Topics, in the thread that spins."""

    @abstractmethod
    def _work(self) -> None:
        """Until it is done for good, or no longer active. Raises what is to be tried again."""

    @abstractmethod
    def _interrupt(self) -> None:
        """Make ``_work`` come back soon."""


class SensorNode(Working):
    """Gives what a source gives: live devices as they are, a dive at its own pace as if it were now.

    Parameters: source, rig (for CameraInfo; default the dive's own), reliable, restamp (a dive's stamps are moved to
    now).
    """

    def __init__(self, *, frames: bool, readings: bool) -> None:
        super().__init__()
        self._frames, self._readings = frames, readings
        self._source: Source | None = None
        self._rig: Rig | None = None
        self._sender: Ros2Samples | None = None

    def configure(self, node: RosNode) -> None:
        self.node = node
        spec, rig = _text(node, "source"), _text(node, "rig")
        if not spec:
            raise InputError("no source", node.name, "give the parameter source, like uvc:0 or a dive's folder")
        self._source = open_source(spec, real_time=True)
        self._rig = Rig.load(rig) if rig else self._source.rig
        node.parameter("reliable", False)
        node.parameter("restamp", True)

    def _prepare(self) -> None:
        assert self.node is not None
        reliable = bool(self.node.parameter("reliable", False))
        self._sender = Ros2Samples(
            self.node, self._rig, frames=self._frames, readings=self._readings, reliable=reliable
        )

    def _work(self) -> None:
        assert self.node is not None
        assert self._source is not None
        assert self._sender is not None
        past = not self._source.live or (isinstance(self._source, LiveSource) and self._source.of is not None)
        shift_ns = None if past and self.node.parameter("restamp", True) else 0
        for sample in self._source:
            if not self._active:
                return
            if shift_ns is None:
                shift_ns = time.time_ns() - arrival_ns(sample)
            self._sender.send(_shifted(sample, shift_ns) if shift_ns else sample)
        if self._active:
            self.node.info(f"{self._source.name} is at its end")

    def _interrupt(self) -> None:
        if self._source is not None:
            self._source.close()


class LocalizerNode(Working):
    """Any stereo pair and any range in, the target out.

    Parameters: rig (none: from CameraInfo, without port and laser), target, model, config, water_state, record (a
    folder for recordings), and those of ``StereoTopics``.
    """

    def __init__(self) -> None:
        super().__init__()
        self._wanted = StereoTopics()
        self._clock = LiveClock()
        self._source: LiveSource | None = None
        self._build: Callable[[Source], Job] | None = None
        self._job: Job | None = None
        self._tap: Tap | None = None
        self._infos: CameraInfos | None = None

    def configure(self, node: RosNode) -> None:
        self.node = node
        _require_all(
            lambda: _stereo_topics(node),
            lambda: _text(node, "rig") and Rig.load(_text(node, "rig")),
            lambda: _text(node, "target") and stated_target(_text(node, "target")),
            lambda: _settings(node),
            lambda: stated_water(_text(node, "water_state") or None),
        )
        self._wanted = _stereo_topics(node)
        self._source = LiveSource(f"ros2:{node.name}", [self._topics], self._clock)
        self._build = self._builder(node)
        if _text(node, "rig"):
            self._job = self._build(self._source)
        _text(node, "record")

    def _builder(self, node: RosNode) -> Callable[[Source], Job]:
        rig, target, model, water = (_text(node, name) or None for name in ("rig", "target", "model", "water_state"))
        settings = _settings(node)

        def build(source: Source) -> Job:
            return build_job(
                source,
                rig_file=rig,
                target=target,
                model=Path(model) if model else None,
                config=settings,
                water_state=water,
            )

        return build

    def _topics(self) -> RosTopics:
        def connect() -> tuple[Tap, Callable[[], None]]:
            assert self._tap is not None
            return self._tap, lambda: None

        return RosTopics("topics", connect, self._wanted.pair_s)

    def _prepare(self) -> None:
        assert self.node is not None
        self._tap = Tap(self.node, self._wanted, self._clock)
        if self._job is None:
            self._infos = CameraInfos(self.node, self._wanted)

    def _work(self) -> None:
        assert self._source is not None
        assert self._build is not None
        if self._job is None:
            self._source.rig = self._rig_from_infos()
            if self._source.rig is None:
                return
        job = self._job or self._build(self._source)
        self._job = None  # one that fails is not used again
        self._localize(job)
        self._job = job

    def _rig_from_infos(self) -> Rig | None:
        """None where the node is deactivated meanwhile."""
        assert self.node is not None
        assert self._infos is not None
        self.node.info(f"no rig is given: waiting for {self._wanted.left_info} and {self._wanted.right_info}")
        while (rig := self._infos.rig) is None and self._active:
            self._halt.wait(INFO_S)
        return rig

    def _localize(self, job: Job) -> None:
        if not self._active:  # deactivated while a model was loaded
            return
        watch = Watch(job.source, job.rig, job.detector)
        outlets = [watch.outlet(sink) for sink in self._sinks(job)]
        name, localizer = next(iter(job.methods.items()))
        track = Track(name, localizer, outlets, watch)
        try:
            for sample in job.source:
                if isinstance(sample, StereoFrame):
                    require_size(job.rig, job.source)
                track.take(sample)
        finally:
            for outlet in outlets:
                outlet.close()

    def _sinks(self, job: Job) -> list[Sink]:
        assert self.node is not None
        sinks: list[Sink] = [Ros2Sink(self.node, job.rig, Guide(job.rig, job.config.guidance), draw_detections)]
        if folder := _text(self.node, "record"):
            sinks.append(McapSink(Path(folder) / time.strftime("leadline-%Y%m%d-%H%M%S.mcap"), job.rig))
        return sinks

    def _interrupt(self) -> None:
        if self._source is not None:
            self._source.close()


NODES: dict[str, Callable[[], Activity]] = {
    "camera": lambda: SensorNode(frames=True, readings=False),
    "laser": lambda: SensorNode(frames=False, readings=True),
    "sensors": lambda: SensorNode(frames=True, readings=True),
    "localizer": LocalizerNode,
}


def spin(names: Sequence[str], arguments: Sequence[str] = ()) -> None:
    """Nodes ``leadline_NAME`` in this process, until SIGINT or SIGTERM. arguments: ``--ros-args ...``.

    With the parameter ``autostart`` a node becomes active by itself; else by its lifecycle's services.
    """
    ros = Ros(arguments)
    signal.signal(signal.SIGTERM, lambda *_: ros.stop())
    try:
        for name in names:
            node = ros.node(f"leadline_{name}", NODES[name]())
            if node.parameter("autostart", False):
                node.bring_up()
        ros.spin()
    except KeyboardInterrupt:
        return
    finally:
        ros.close()


def _require_all(*checks: Callable[[], object]) -> None:
    """InputError with all that is wrong: one that is mended is not followed by the next at the next start."""
    wrong = []
    for check in checks:
        try:
            check()
        except InputError as error:
            wrong.append(str(error))
    if wrong:
        raise InputError(" | ".join(wrong))


def _stereo_topics(node: RosNode) -> StereoTopics:
    defaults = StereoTopics()
    said = {name: node.parameter(name, getattr(defaults, name)) for name in TOPIC_PARAMETERS}
    return StereoTopics(**said).with_infos().checked(node.name)


def _settings(node: RosNode) -> Config:
    file = _text(node, "config")
    return Config.load(Path(file)) if file else Config()


def _text(node: RosNode, name: str) -> str:
    return str(node.parameter(name, ""))


def _shifted(sample: Sample, by_ns: int) -> Sample:
    changes: dict[str, Any] = {"t_ns": sample.t_ns + by_ns}
    if isinstance(sample, StereoFrame) and sample.left_t_ns is not None and sample.right_t_ns is not None:
        changes |= {"left_t_ns": sample.left_t_ns + by_ns, "right_t_ns": sample.right_t_ns + by_ns}
    return replace(sample, **changes)
