"""The drawings of a laser's calibration: where it fits, where it does not, and what it adds."""

from __future__ import annotations

import numpy as np

from leadline.calibration.beam_fit import BeamFit
from leadline.calibration.information import laser_limits
from leadline.calibration.laser_board import BoardBeamFit
from leadline.calibration.refine import Refinement, depth_sigmas
from leadline.calibration.virtual_focal import VirtualFocal
from leadline.evaluation.laser_report import Figure
from leadline.evaluation.svg import INK, Curve, Marks, arrows, bars, chart, log_chart
from leadline.ranging.calibration_error import beam_cov
from leadline.rig import Rig
from leadline.samples import Array

_SIZE = (900, 300)
_DISTANCES_M = tuple(np.linspace(0.2, 2.2, 21))


def station_figures(fit: BeamFit) -> list[Figure]:
    """Readings against distance, and the spots' residuals in both images."""
    readings = Marks(
        "readings (mean, 1 sigma)", fit.lengths_m, 1e3 * fit.range_residuals_m, INK["water"], 1e3 * fit.range_sigmas_m
    )
    off = chart([readings], "distance along the beam, m", "off the fit, mm", "readings off the fit", _SIZE)
    return [
        Figure("Readings", off, "Measured minus predicted. A good model leaves them about zero at every distance."),
        Figure("Spots", _vectors(fit), "Measured minus predicted, left image and right image."),
    ]


def board_figures(fit: BoardBeamFit) -> list[Figure]:
    """Readings to a board against distance: used, seen by no fit of theirs, and those that are wrong."""
    low = fit.raw_m < (fit.minimum_m or 0.0)
    stray = ~fit.used & ~low
    off = 1e3 * fit.residual_m
    marks = [
        Marks("used", fit.raw_m[fit.used], off[fit.used], INK["water"]),
        Marks("used, held out in turn", fit.raw_m[fit.used], 1e3 * fit.held_out_m, INK["air"], hollow=True),
    ]
    if low.any():
        marks.append(Marks("below the true minimum", fit.raw_m[low], off[low], INK["red"]))
    if stray.any():
        marks.append(Marks("left out", fit.raw_m[stray], off[stray], INK["grey"]))
    drawing = chart(marks, "reading, m", "off the fit, mm", "readings off the fit", _SIZE)
    note = "Measured minus predicted. Hollow: predicted by a fit that has not seen the reading."
    return [Figure("Readings", drawing, note)]


def laser_figures(rig: Rig) -> list[Figure]:
    """What the calibration leaves uncertain of the laser's point, by distance, and which part of it that is."""
    beam = rig.laser
    assert beam is not None
    x, d = np.array(_DISTANCES_M), beam.direction
    cov = [beam_cov(rig, beam.raw_m(length)) for length in x]
    along = np.array([np.sqrt(d @ c @ d) for c in cov])
    across = np.array([np.sqrt(max(np.trace(c) - d @ c @ d, 0.0)) for c in cov])
    curves = [Curve("along the beam", x, 1e3 * along, INK["water"]), Curve("across it", x, 1e3 * across, INK["air"])]
    band = chart([], "distance along the beam, m", "sigma, mm", "the laser point's uncertainty", _SIZE, curves=curves)
    note = "One standard deviation from the calibration alone; each reading adds its own noise."
    figures = [Figure("The laser's point", band, note)]
    shares = sorted(laser_limits(rig, _DISTANCES_M).items(), key=lambda item: -item[1])
    if shares:
        drawing = bars([(name, 100 * share, INK["water"]) for name, share in shares], 640, "%", "what limits it")
        note = "How much of that variance would go if this part were known exactly (parts overlap)."
        figures.append(Figure("What limits it", drawing, note))
    return figures


def focal_figure(focal: VirtualFocal) -> Figure:
    """The paper's f' by distance: one number for all distances is what it claims to be."""
    marks = [
        Marks("f'x", focal.z_m, focal.fx_each_px, INK["water"]),
        Marks("f'y", focal.z_m, focal.fy_each_px, INK["air"]),
    ]
    ends = np.array([focal.z_m.min(), focal.z_m.max()])
    curves = [
        Curve(f"mean {mean:.1f} +-{scatter:.1f}", ends, np.full(2, mean), colour, dashed=True)
        for mean, scatter, colour in zip(
            (focal.fx_px, focal.fy_px), focal.scatter_px, (INK["water"], INK["air"]), strict=True
        )
    ]
    drawing = chart(marks, "distance, m", "f', px", "f' by distance", _SIZE, curves=curves, zero=False)
    note = "Equations 11-12 at each station. What depends on the distance is what refraction does and f' does not."
    return Figure("The paper's virtual focal length", drawing, note)


def refinement_figure(result: Refinement) -> Figure:
    """The calibration's part of a stereo depth's uncertainty, before and after the laser dive."""
    x = np.array(_DISTANCES_M)
    curves = []
    for name, rig, colours in (
        ("before", result.before, ("#c77d0a", "#e3b778")),
        ("after", result.rig, ("#0b6fa4", "#7fb3d1")),
    ):
        sigma = 1e3 * depth_sigmas(rig, _DISTANCES_M)
        curves += [
            Curve(f"{name}, {place}", x, sigma[:, i], colours[i], dashed=name == "before")
            for i, place in enumerate(("centre", "half field"))
        ]
    drawing = log_chart(curves, "distance, m", "sigma of depth, mm", "what the laser dive adds", (900, 340))
    note = "One standard deviation of a stereo point's depth from the calibration alone."
    return Figure("What the laser dive adds", drawing, note)


def _vectors(fit: BeamFit) -> str:
    size = (fit.rig.left.width, fit.rig.left.height)
    longest = max(float(np.abs(fit.pixel_residuals_px).max()), 0.05)
    drawings = []
    for side, columns in (("left", slice(0, 2)), ("right", slice(2, 4))):
        spots: Array = np.array([(s.left if side == "left" else s.right).q_px for s in fit.stations])
        residuals = fit.pixel_residuals_px[:, columns]
        drawings.append(arrows(size, 430, spots, residuals, longest, f"spots' residuals, {side} image"))
    return f'<div class="row">{"".join(drawings)}</div>'
