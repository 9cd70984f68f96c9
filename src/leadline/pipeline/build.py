"""From a user's options to a source, a rig and a localizer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from leadline.config import Config
from leadline.errors import InputError
from leadline.evaluation.drawing import draw_detections
from leadline.guidance import Guide, camera_on_body
from leadline.localizer import Localizer, SmoothingLocalizer
from leadline.paper import PaperLocalizer
from leadline.pipeline.watch import WatchedFinder
from leadline.recognition.boxes import KEY, NO_FRAME, Boxes
from leadline.recognition.finder import Finder
from leadline.rig import Rig, shipped_rigs
from leadline.samples import Detection, Sample, Solution
from leadline.sinks import Sink
from leadline.sources import Source, open_source, require_size
from leadline.sources.live import LiveSource
from leadline.sources.simulated import SimulatedSource
from leadline.target import Cylinder, Plane, Sphere, Surface, Target, parse_target
from leadline.water import Water, WaterState

Method = Literal["fused", "paper"]


class Steps(Protocol):
    """What the loop drives: ``Localizer`` or ``PaperLocalizer``."""

    detections: list[Detection]

    @property
    def notices(self) -> list[str]: ...

    def step(self, sample: Sample) -> Solution | None: ...


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """A run about to start. ``methods``: the main one first, others are run beside it for comparison."""

    source: Source
    rig: Rig
    target: Target
    config: Config
    methods: dict[str, Steps]
    seed: int
    filtered: bool = True
    detector: WatchedFinder | None = None
    boxes: Boxes | None = None  # where they are what finds the target
    outputs: tuple[Sink, ...] = ()  # beside the run's folder; the run closes them


def build_job(
    spec: str | Source,
    *,
    rig_file: str | None = None,
    target: str | None = None,
    methods: tuple[Method, ...] = ("fused",),
    model: Path | None = None,
    boxes: Path | None = None,
    config: Config | None = None,
    water_state: str | None = None,
    filtered: bool = True,
    smoothed: bool = False,
    real_time: bool = False,
    seed: int = 0,
    mavlink: str | None = None,
    ros2: bool = False,
) -> Job:
    """Open and check everything that a run needs before it writes its first file. InputError says what is wrong."""
    if model is not None and boxes is not None:
        raise InputError("--model and --boxes are two answers to one question", fix="give one of them")
    if smoothed and (not filtered or methods[0] == "paper"):
        raise InputError("--smooth smooths our filter", fix="leave --no-filter and --method paper out")
    config = config or Config()
    source = spec if isinstance(spec, Source) else open_source(spec, seed=seed, real_time=real_time)
    rig = _rig(source, rig_file, water_state)
    if isinstance(source, LiveSource):
        source.mount.T_body_left = camera_on_body(rig)
    require_size(rig, source)
    shape = _target(source, target)
    given = None if boxes is None else _boxes(boxes, source)
    finder = given or _finder(shape, rig, model, config)
    watched = None if finder is None else WatchedFinder(finder, live=source.live)
    return Job(
        source=source,
        rig=rig,
        target=shape,
        config=config,
        methods={name: _localizer(name, rig, shape, watched, config, filtered, smoothed) for name in methods},
        seed=seed,
        filtered=filtered,
        detector=watched,
        boxes=given,
        outputs=_outputs(mavlink, ros2, rig, config),
    )


def _outputs(mavlink: str | None, ros2: bool, rig: Rig, config: Config) -> tuple[Sink, ...]:
    guide = Guide(rig, config.guidance)
    return (*([] if mavlink is None else [_mavlink(mavlink, guide)]), *([_ros2(rig, guide)] if ros2 else []))


def _ros2(rig: Rig, guide: Guide) -> Sink:
    from leadline.sinks.ros2 import Ros2Sink  # noqa: PLC0415
    from leadline.wire.ros2_node import Ros  # noqa: PLC0415

    ros = Ros()
    node = ros.node("leadline_run")
    ros.start()
    return Ros2Sink(node, rig, guide, draw_detections, ros.close)


def _mavlink(url: str, guide: Guide) -> Sink:
    from leadline.sinks.mavlink import MavlinkSink  # noqa: PLC0415  an extra
    from leadline.wire.mavlink import MavlinkLink  # noqa: PLC0415

    try:
        return MavlinkSink(MavlinkLink(url), guide)
    except OSError as error:
        raise InputError(f"cannot be opened ({error})", f"--mavlink {url}", "check the address or the port") from error


def _rig(source: Source, rig_file: str | None, water_state: str | None) -> Rig:
    if rig_file is None and source.rig is None:
        names = ", ".join(shipped_rigs())
        raise InputError("the source has no rig", source.name, f"give --rig with a rig file, or one of {names}")
    rig = source.rig if rig_file is None else Rig.load(rig_file)
    assert rig is not None
    if water_state is None:
        return rig
    try:
        return rig.in_water(Water.from_state(parse_water_state(water_state), rig.laser_wavelength_nm))
    except ValueError as error:
        fix = "use salinity=0,temperature=20,depth=0"
        raise InputError(str(error), f"--water-state {water_state}", fix) from error


def parse_water_state(text: str) -> WaterState:
    """`salinity=35,temperature=12,depth=30` (psu, C, m), in any order; what is left out is 0, but the temperature."""
    values: dict[str, float] = {}
    for part in text.split(","):
        name, equals, number = part.strip().partition("=")
        if not equals or name not in ("salinity", "temperature", "depth") or name in values:
            raise ValueError(f"'{part}' is not one of salinity=, temperature=, depth=")
        try:
            values[name] = float(number)
        except ValueError:
            raise ValueError(f"'{number}' is not a number") from None
    if "temperature" not in values:
        raise ValueError("the temperature is missing")
    return WaterState(values["temperature"], values.get("salinity", 0.0), values.get("depth", 0.0))


def stated_water(text: str | None) -> WaterState | None:
    """`salinity=35,temperature=12,depth=30`. InputError for anything else."""
    try:
        return None if text is None else parse_water_state(text)
    except ValueError as error:
        fix = "give --water-state salinity=PSU,temperature=C,depth=M"
        raise InputError(str(error), f"--water-state {text}", fix) from error


def stated_target(text: str) -> Target:
    """What the user says. InputError for what is none."""
    try:
        return parse_target(text)
    except ValueError as error:
        raise InputError(str(error), "--target") from error


def _target(source: Source, text: str | None) -> Target:
    """What the user says; else what is in the simulated scene; else nothing is assumed."""
    if text is not None:
        return stated_target(text)
    source = (source.of or source) if isinstance(source, LiveSource) else source
    if not isinstance(source, SimulatedSource):
        return Surface()
    part = source.dive.scenario.target
    match part.shape:
        case "sphere":
            return Sphere(part.diameter_m)
        case "cylinder":
            return Cylinder(part.diameter_m)
        case "plane":
            return Plane()
    return Surface()


def _boxes(file: Path, source: Source) -> Boxes:
    boxes = Boxes(file)
    if source.frame_names is not None and not boxes.belong_to(source.frame_names):
        raise InputError(NO_FRAME, str(file), KEY)
    return boxes


def _finder(target: Target, rig: Rig, model: Path | None, config: Config) -> Finder | None:
    """A model where given; the shipped ball and buoy detector, but for a hull or a pile: they are the view."""
    if model is None and isinstance(target, Plane | Cylinder):
        return None
    from leadline.recognition.detector import Detector  # noqa: PLC0415  not loaded where boxes are given

    detector = Detector(model, **config.detector.model_dump())
    detector.warm_up(rig.left.width, rig.left.height)
    return detector


def _localizer(
    method: Method, rig: Rig, target: Target, finder: Finder | None, config: Config, filtered: bool, smoothed: bool
) -> Steps:
    if method == "paper":
        return PaperLocalizer(rig, target, finder, config)
    if smoothed:
        return SmoothingLocalizer(rig, target, finder, config)
    return Localizer(rig, target, finder, config, filtered=filtered)
