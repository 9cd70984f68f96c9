"""What the calibration commands print: plain lines, numbers with their units and standard deviations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from leadline.calibration.comparison import DISTANCES_M
from leadline.calibration.heldout import by_distance

if TYPE_CHECKING:
    from collections.abc import Iterator

    from leadline.calibration.board import Board
    from leadline.calibration.heldout import HeldOut
    from leadline.calibration.verdict import Verdict
    from leadline.pipeline.calibrate_cameras import CameraReport


def camera_lines(report: CameraReport) -> Iterator[str]:
    """The result of `calibrate cameras`, line by line."""
    from leadline.calibration.verdict import band_mm  # noqa: PLC0415
    from leadline.calibration.warp import warp_of  # noqa: PLC0415
    from leadline.pipeline.calibrate_cameras import remarks  # noqa: PLC0415

    calibration = report.calibration
    fit, rig = calibration.fit, calibration.rig
    yield from (line for boards in report.sets for line in remarks(boards))
    for o in calibration.left_out:
        yield f"left out: {o.name} ({o.side}): {o.why} ({o.median_px:.2f} px)"
    counts = [f"{sum(v.medium is m for v in calibration.views)} boards in {m}" for m in sorted(calibration.media())]
    yield f"{', '.join(counts)}: {fit.rms_px:.3f} px rms, corners' noise {fit.sigma_px:.3f} px"
    yield f"fx {rig.left.fx:.2f} +-{fit.sigma('left.fx_px'):.2f} px"
    if not calibration.mono:
        yield f"baseline {rig.baseline_m * 1e3:.3f} +-{fit.sigma('T_right_left.t_m[0]') * 1e3:.3f} mm"
    if rig.port is not None:
        tilt = np.degrees(np.arccos(min(1.0, rig.port.normal[2])))
        sigma = np.degrees(max(fit.sigma("port.normal[0]"), fit.sigma("port.normal[1]")))
        distance, spread = rig.port.distance_m * 1e3, fit.sigma("port.distance_m") * 1e3
        yield f"port {distance:.2f} +-{spread:.2f} mm, tilted {tilt:.3f} +-{sigma:.3f} degrees"
        if "water.index" in fit.names:
            prior, after = calibration.priors["water.index"], fit.sigma("water.index")
            share = 1 - min(1.0, (after / prior.sigma) ** 2)
            yield (
                f"water's index {rig.port.outside_index:.5f} +-{after:.5f}, before the images {prior.mean:.4f} "
                f"+-{prior.sigma:.4f}: {share:.0%} of it from the images"
            )
    if calibration.settings.warp:
        yield f"board bent by {warp_of(calibration)}"
    band = band_mm(calibration)
    if len(band):
        yield "depth error in mm at " + "  ".join(f"{z:g} m" for z in DISTANCES_M) + "  (centre)"
        yield "  ours, 1 sigma        " + "  ".join(f"{v:7.2f}" for v in band[:, 0])
        for model in report.models:
            yield f"  {model.name:21}" + "  ".join(f"{v:+7.2f}" for v in model.depth_mm[:, 0])
    yield from verdict_lines(report.verdict)
    yield from (str(file) for file in report.files)


def check_lines(held_out: HeldOut, board: Board) -> Iterator[str]:
    """The result of `calibrate check`, line by line."""
    fit = held_out.found.fit
    counted = f"{len(held_out.found.views)} boards that the calibration has not seen"
    noise = f"{fit.sigma_px:.3f} px a coordinate (calibration: {held_out.expected_px:.3f})"
    yield f"{counted}: {fit.rms_px:.3f} px rms, {noise}"
    yield "distance m  boards  square off by mm  scatter mm"
    for distance, count, off, scatter in by_distance(held_out.lengths, board):
        yield f"{distance:10.2f}  {count:6d}  {off:+16.4f}  {scatter:10.3f}"
    mean, sigma = held_out.scale
    yield f"size of the boards {mean:+.3%} +-{sigma:.3%}"
    if held_out.halves is not None:
        h = held_out.halves
        yield f"near {h.near:+.3%}, far {h.far:+.3%} of their size: {h.sigmas:.1f} sigma apart"
    if held_out.focal is not None:
        f = held_out.focal
        yield f"near boards want a focal length {f.near:+.3%}, far ones {f.far:+.3%}: {f.sigmas:.1f} sigma apart"
    yield from verdict_lines(held_out.verdict)


def verdict_lines(verdict: Verdict) -> Iterator[str]:
    """Good or not, why, and what to do."""
    yield f"verdict: {verdict.line}"
    yield from (f"  {doubt}" for doubt in (verdict.doubts if verdict.good else verdict.doubts[1:]))
    yield f"next: {verdict.next_action}"
