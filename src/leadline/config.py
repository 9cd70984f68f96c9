"""Settings of a run: every number that a user may change, with its default and its bounds.

``leadline config dump`` prints them, ``--config FILE`` reads them, a run saves the effective ones as ``config.yaml``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from leadline.errors import InputError
from leadline.files import read_yaml

Positive = Annotated[float, Field(gt=0)]
Provider = Literal["cpu", "cuda", "tensorrt", "openvino"]


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class DetectorConfig(Section):
    """Finding the target's box in the left image."""

    score: float = Field(default=0.3, ge=0, le=1, description="a box below this score is not a detection")
    nms_iou: float = Field(default=0.5, gt=0, le=1, description="of two boxes that overlap more, the better one stays")
    threads: int = Field(default=2, ge=1, description="threads of the ONNX runtime")
    provider: Provider = Field(default="cpu", description="what it runs on; all but cpu need another ONNX runtime")
    long_side_px: int | None = Field(
        default=None, ge=32, description="of the network's input, for models of free size; none: the model's own"
    )


class TrackConfig(Section):
    """Which detection is the target, from frame to frame."""

    reach: Positive = Field(default=0.6, description="a detection this far from where it is expected goes on, in sizes")
    least_reach_px: float = Field(default=16.0, ge=0, description="but never less than this")
    hold_s: float = Field(default=1.0, ge=0, description="so long it is looked for where it must be, without any")


class PaperConfig(Section):
    """What the paper leaves open (`--method paper`); reasons in docs/paper-method.md."""

    smooth_px: Positive = Field(default=2.0, description="sigma of the blur that takes the noise off before matching")
    block_px: int = Field(default=41, ge=5, le=201, description="side of the matched block")
    least_score: float = Field(default=0.7, ge=0, le=1, description="a correlation below this is no match")
    nearest_m: Positive = Field(default=0.15, description="greatest disparity searched")
    farthest_m: Positive = Field(default=20.0, description="least disparity searched")
    disparity_sigma_px: Positive = Field(default=0.29, description="rounding to a whole pixel, 1/sqrt(12); sigma_1")
    laser_sigma_m: Positive = Field(default=0.003, description="the rangefinder's accuracy; sigma_2")
    laser_hold_s: Positive = Field(default=0.36, description="the laser works while its last reading is no older")
    spot_grey: float = Field(default=180.0, gt=0, lt=255, description="the spot is brighter than this grey level")
    spot_circularity: float = Field(default=0.7, ge=0, le=1, description="4 pi A / P^2 of the spot's outline")
    spot_area_px: tuple[float, float] = Field(default=(9.0, 4000.0), description="least and greatest area of the spot")
    spot_rows_px: float = Field(default=4.0, ge=0, description="rows between the left and the right spot")
    fills_view: float = Field(
        default=0.95, gt=0, le=1, description="a box this much of the image high or wide fills the view"
    )


class StereoConfig(Section):
    """Matching patches of the target between the two images."""

    patches: int = Field(120, ge=20, description="about how many patches are matched on the target")
    half_px: int = Field(
        11, ge=4, le=40, description="a patch is a square of 2 half + 1 pixels, on a small target less"
    )
    min_half_px: int = Field(4, ge=3, le=40, description="but not less than this")
    target_px: int = Field(175, ge=60, description="a larger target is matched in a smaller image, about this size")
    max_sigma_px: float = Field(0.6, gt=0, description="a match less certain than this is no match")
    min_correlation: float = Field(0.3, ge=0, le=1, description="nor is one that correlates less")
    min_agreed: int = Field(6, ge=4, description="patches that must agree on one shape")
    roughness_m: float = Field(0.0005, ge=0, description="how far the real surface stands off its ideal shape")


class OutlineConfig(Section):
    """Ranging a ball of known size by its outline."""

    reach: tuple[Positive, ...] = Field((0.15, 0.05), description="how far off the outline is looked for, in radii")
    min_edges: int = Field(16, ge=6, description="edges that must agree, of 60 in each image")
    edge_sigma_px: float = Field(0.3, gt=0, description="noise of one edge")
    bias_sigma_px: float = Field(0.4, ge=0, description="error common to all edges (shading, blur)")


class BeamConfig(Section):
    """The laser and its spot."""

    spot_radius_m: float = Field(0.003, gt=0, description="radius of the lit spot on the target")
    nearest_m: float = Field(0.05, gt=0, description="shorter beams are not looked for")
    farthest_m: float = Field(6.0, gt=0, description="nor longer ones")
    reading_age_s: float = Field(0.2, gt=0, description="a reading this far from a frame still counts with --no-filter")


class FilterConfig(Section):
    """One state for both sensors: position, velocity, shape."""

    model: Literal["velocity", "acceleration"] = Field("velocity", description="what is constant but for noise")
    manoeuvre_s: Positive = Field(1.0, description="how long an acceleration lasts, for the model of that name")
    acceleration_psd: float = Field(0.01, gt=0, description="how the target's motion changes, m^2/s^3")
    adapt: bool = Field(True, description="whether noises follow what the measurements show, from what is stated")
    initial_speed_m_s: float = Field(0.4, gt=0, description="speed expected of a target just found")
    gate_sigmas: float = Field(5.0, gt=1, description="a measurement farther off than this is turned away")
    student_nu: float = Field(4.0, gt=2, description="degrees of freedom of the noise; small: heavy tails")
    horizon_s: float = Field(2.0, gt=0, description="a sample later than this is too late to be replayed")
    recover_after: int = Field(3, ge=2, description="turned-away positions that agree before starting again")
    recover_after_s: float = Field(0.3, ge=0, description="and how long they must go on")
    laser_clock_sigma_s: float = Field(0.05, ge=0, description="offset of the laser's clock; 0: it has none")


class StatusConfig(Section):
    """When a solution counts as what."""

    recent_s: float = Field(1.0, gt=0, description="a sensor used within this time is available (the stages)")
    coast_after_s: float = Field(1.0, gt=0, description="without any measurement for so long: coasting")
    lost_after_s: float = Field(3.0, gt=0, description="and then: lost")
    blind_after_s: float = Field(0.3, gt=0, description="a target not seen for so long may have gone aside")
    wander_m: float = Field(0.04, gt=0, description="how far an unseen target strays sideways: station keeping")
    drift_m_s: float = Field(0.01, ge=0, description="and how much more with every second")
    alone_s: float = Field(3.0, ge=0, description="so long a target that one sensor alone speaks for is not yet valid")
    alone_px: float = Field(1.0, ge=0, description="and then, how far the cameras may be out of place unnoticed")
    bias_px: float = Field(0.03, ge=0, description="matching error that no averaging removes")
    laser_bias_m: float = Field(0.0005, ge=0, description="laser error that no averaging removes")


class GuidanceConfig(Section):
    """What a pilot is told (page, ROS 2, MAVLink)."""

    standoff_m: Positive = Field(0.5, description="where the approach shall end; the time until then is told")
    safety_m: float = Field(0.2, ge=0, description="an alarm is given when the target may be nearer than this")
    reach_m: Positive = Field(0.63, description="the manipulator's envelope, from the camera")
    accuracy_m: Positive = Field(0.1, description="two sigmas of the position that the work allows")


class Config(Section):
    detector: DetectorConfig = DetectorConfig()
    track: TrackConfig = TrackConfig()
    stereo: StereoConfig = StereoConfig()
    outline: OutlineConfig = OutlineConfig()
    beam: BeamConfig = BeamConfig()
    filter: FilterConfig = FilterConfig()
    status: StatusConfig = StatusConfig()
    guidance: GuidanceConfig = GuidanceConfig()
    paper: PaperConfig = PaperConfig()

    @classmethod
    def load(cls, path: Path) -> Config:
        """Read a YAML file; InputError names the key that is wrong."""
        try:
            return cls.model_validate(read_yaml(path) or {})
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(str(part) for part in first["loc"]) or "the file"
            raise InputError(f"{key}: {first['msg']}", str(path), "see `leadline config dump` for the keys") from error

    def dump(self) -> str:
        return yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False)
