"""`calibrate laser` and `calibrate range` from a dive to a rig file and what there is to say about it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from leadline.calibration.beam_fit import BeamFit
from leadline.calibration.board import Board, find_corners
from leadline.calibration.cameras import calibrate_cameras
from leadline.calibration.group_index import GROUP
from leadline.calibration.laser import LASER, calibrate_laser
from leadline.calibration.laser_board import (
    BoardBeamFit,
    BoardReading,
    calibrate_laser_board,
    require_boards,
    with_laser,
)
from leadline.calibration.range import RangeFit, calibrate_range
from leadline.calibration.refine import DISTANCES_M, PortGuess, Refinement, depth_sigmas, refine
from leadline.calibration.views import BoardView
from leadline.calibration.virtual_focal import VirtualFocal, virtual_focal
from leadline.errors import InputError
from leadline.evaluation.laser_charts import (
    board_figures,
    focal_figure,
    laser_figures,
    refinement_figure,
    station_figures,
)
from leadline.evaluation.laser_report import Figure, Table, write_laser_page
from leadline.files import make_folder
from leadline.pipeline.calibrate_cameras import now
from leadline.rig import Rig
from leadline.rig_derivatives import Medium
from leadline.samples import Sample, StereoFrame
from leadline.sources import Source, open_source
from leadline.water import WaterState
from leadline.wire.calibration_folder import read_image
from leadline.wire.camera_file import is_camera_file, read_camera, write_camera
from leadline.wire.range_folder import is_range_folder, read_range_folder

Tick = Callable[[int, int | None], object]
NEXT = {
    "laser": "a static dive in water: leadline calibrate range",
    "range": "check the rig on boards that it has not seen: leadline calibrate check",
    "refine": "check the rig on boards that it has not seen: leadline calibrate check",
}


@dataclass(frozen=True, eq=False)
class LaserReport:
    """The calibrated rig, remarks (one line each), tables and drawings."""

    rig: Rig
    lines: tuple[str, ...]
    tables: tuple[Table, ...]
    figures: tuple[Figure, ...]


def laser(
    dive: str,
    rig_file: str | None,
    out: Path,
    *,
    board: Board | None = None,
    medium: str = "air",
    air_port: str = "without",
    method: str = "ml",
    tick: Tick = lambda done, total: None,
) -> LaserReport:
    """Calibrate the laser of a rig and write the rig. InputError names the dive, or what is missing."""
    make_folder(out.parent)
    if is_range_folder(Path(dive)):
        report = _from_boards(Path(dive), rig_file, board, tick)
    else:
        report = _from_spots(dive, rig_file, medium, air_port, method, tick)
    _save(_with_provenance(report.rig, "laser", dive, report.lines), out)
    _write_page(report, out, "laser", "Laser calibration")
    return report


def water_range(
    dive: str,
    rig_file: str,
    out: Path,
    *,
    refined: bool = False,
    guess: PortGuess | None = None,
    water: WaterState | None = None,
    tick: Tick = lambda done, total: None,
) -> LaserReport:
    """Calibrate what readings mean in water, or refine port, water and laser together, and write the rig."""
    rig = Rig.load(rig_file)
    if rig.port is None and not refined:
        raise InputError("the rig has no port", rig_file, "calibrate the cameras in water, or add --refine")
    source = open_source(dive)
    make_folder(out.parent)
    with _of(dive):
        samples = _fitting(source, rig, tick)
        if refined:
            report = _refine_report(refine(samples, rig, guess=guess or PortGuess(), water=water), source)
        else:
            report = _range_report(calibrate_range(samples, rig), source)
    step = "refine" if refined else "range"
    _with_provenance(report.rig, step, dive, report.lines).save(out)
    _write_page(report, out, step, "Range calibration in water")
    return report


def port_guess(distance_m: float | None, thickness_m: float | None, index: float | None) -> PortGuess:
    """What the user says of the port, known well, and wide guesses of the rest. InputError if impossible."""
    for value, low, high, option, unit in [
        (distance_m, 0.0, 0.5, "--port-distance", "metres"),
        (thickness_m, 0.0, 0.1, "--port-thickness", "metres"),
        (index, 1.0, 2.5, "--port-index", "no unit"),
    ]:
        if value is not None and not low < value < high:
            raise InputError(f"{value:g} is not between {low:g} and {high:g}", option, f"check it ({unit})")
    guess = PortGuess()
    if distance_m is not None:
        guess = dataclasses.replace(guess, distance_m=distance_m, distance_sigma_m=0.002)
    if thickness_m is not None:
        guess = dataclasses.replace(guess, thickness_m=thickness_m, thickness_sigma_m=2e-5)
    if index is not None:
        guess = dataclasses.replace(guess, index=index, index_sigma=0.002)
    return guess


@contextmanager
def _of(where: str) -> Iterator[None]:
    """Name the dive in a complaint that does not yet say where."""
    try:
        yield
    except InputError as error:
        raise error if error.where else InputError(error.what, where, error.fix) from error


def _fitting(source: Source, rig: Rig, tick: Tick) -> Iterator[Sample]:
    """The samples; InputError if the images are not of the rig's size."""
    done = 0
    for sample in source:
        if isinstance(sample, StereoFrame):
            done += 1
            size = (sample.left.shape[1], sample.left.shape[0])
            if size != (rig.left.width, rig.left.height):
                what = f"the images are {size[0]}x{size[1]}, the rig's cameras {rig.left.width}x{rig.left.height}"
                raise InputError(what, source.name, "give the rig of these cameras at this image size")
            tick(done, source.frame_count)
        yield sample


def _write_page(report: LaserReport, out: Path, step: str, title: str) -> None:
    """rig.yaml -> rig-laser.html: the cameras' page keeps its own name."""
    page = out.with_name(f"{out.stem}-{step}.html")
    figures = (*report.figures, *laser_figures(report.rig))
    write_laser_page(page, title, report.lines, report.tables, figures, NEXT[step])


def _save(rig: Rig, out: Path) -> None:
    if rig.baseline_m > 0:
        rig.save(out)
    else:
        write_camera(out, rig)


def _from_spots(dive: str, rig_file: str | None, medium: str, air_port: str, method: str, tick: Tick) -> LaserReport:
    if rig_file is None:
        raise InputError("--rig is missing", dive, "give the rig of the cameras that saw the spot")
    rig = Rig.load(rig_file)
    source = open_source(dive)
    with _of(dive):
        fit = calibrate_laser(_fitting(source, rig, tick), rig, medium=medium, air_port=air_port, method=method)
    return _spot_report(fit, source, medium, method)


def _from_boards(folder: Path, rig_file: str | None, board: Board | None, tick: Tick) -> LaserReport:
    if board is None:
        raise InputError("--board and --square are missing", str(folder), "give the board that the laser was aimed at")
    table = read_range_folder(folder)
    readings, size = list[BoardReading](), (0, 0)
    for done, item in enumerate(table.images, start=1):
        image = read_image(item.path)
        if done > 1 and size != (image.shape[1], image.shape[0]):
            raise InputError("the images differ in size", str(item.path), "give the images of one camera")
        size = (image.shape[1], image.shape[0])
        corners = find_corners(image, board)
        if corners is not None:
            readings.append(BoardReading(item.name, corners, item.raw_m))
        tick(done, len(table.images))
    with _of(str(folder)):
        require_boards(len(readings), len(table.images))
        rig = _camera_rig(rig_file, readings, board, size)
        if (rig.left.width, rig.left.height) != size:
            what = f"the images are {size[0]}x{size[1]}, the rig's cameras {rig.left.width}x{rig.left.height}"
            raise InputError(what, "", "give the rig of this camera, or leave --rig out")
        fit = calibrate_laser_board(readings, board, rig.left, rig.covariance)
    found = f"board found in {len(readings)} of {len(table.images)} images"
    lines = (found, *_board_lines(fit), *(str(n) for n in table.notices))
    calibrated = with_laser(rig, fit)
    return LaserReport(calibrated, lines, (_beam_table(calibrated),), tuple(board_figures(fit)))


def _camera_rig(rig_file: str | None, readings: Sequence[BoardReading], board: Board, size: tuple[int, int]) -> Rig:
    """From a rig file or one camera's file; without one the camera is calibrated from the very same boards."""
    if rig_file is None:
        return calibrate_cameras([BoardView(r.name, Medium.AIR, r.corners) for r in readings], board, size).rig
    return read_camera(Path(rig_file)) if is_camera_file(Path(rig_file)) else Rig.load(rig_file)


def _board_lines(fit: BoardBeamFit) -> list[str]:
    lines = [
        f"{fit.used.sum()} of {len(fit.names)} readings used: residual {1e3 * fit.rms_m:.1f} mm rms in the fit, "
        f"{1e3 * fit.held_out_rms_m:.1f} mm on readings held out"
    ]
    if fit.minimum_m is not None:
        low = [name for name, raw_m in zip(fit.names, fit.raw_m, strict=True) if raw_m < fit.minimum_m]
        off = f"{len(low)} readings, off by {1e3 * fit.bias_m:+.0f} mm in the middle"
        lines.append(f"the device is wrong below {fit.minimum_m:.2f} m: {off}: {', '.join(low)}")
    if fit.outliers:
        lines.append(f"left out, off the fit of the others: {', '.join(fit.outliers)}")
    return lines


def _spot_report(fit: BeamFit, source: Source, medium: str, method: str) -> LaserReport:
    lines = [*_fit_lines(fit, source), f"beam measured in {medium}, method {method}"]
    if method == "ml":
        lines.append("where the laser begins on its beam and the offset are one number: see the covariance")
    tables = (_beam_table(fit.rig), _station_table(fit))
    return LaserReport(fit.rig, tuple(lines), tables, tuple(station_figures(fit)))


def _range_report(result: RangeFit, source: Source) -> LaserReport:
    gain, sigma = result.gain
    lines = [*_fit_lines(result.fit, source), f"scale x group index {gain:.5f} +- {sigma:.5f}"]
    for name, what in (("laser.range_scale", "the scale"), (GROUP, "the group index")):
        if result.learnt(name) < 0.1:
            lines.append(
                f"{what} by itself is not seen by this dive: it stays as known before, +- {result.fit.sigma(name):.5f}"
            )
    tables, figures = [_beam_table(result.fit.rig), _station_table(result.fit)], station_figures(result.fit)
    if result.focal is not None:
        tables.append(_focal_table(result.focal))
        figures.append(focal_figure(result.focal))
    return LaserReport(result.fit.rig, tuple(lines), tuple(tables), tuple(figures))


def _refine_report(result: Refinement, source: Source) -> LaserReport:
    rig = result.rig
    focal = virtual_focal(rig, result.fit.stations)
    tables = [_gain_table(result), _depth_table(result), _beam_table(rig), _station_table(result.fit)]
    figures = [refinement_figure(result), *station_figures(result.fit)]
    if focal is not None:
        rig = dataclasses.replace(rig, virtual_focal_px=(focal.fx_px, focal.fy_px))
        tables.append(_focal_table(focal))
        figures.append(focal_figure(focal))
    return LaserReport(rig, tuple(_fit_lines(result.fit, source)), tuple(tables), tuple(figures))


def _fit_lines(fit: BeamFit, source: Source) -> list[str]:
    reach = f"{min(s.raw_m for s in fit.stations):.2f}-{max(s.raw_m for s in fit.stations):.2f} m read"
    return [
        f"{len(fit.stations)} stations, {reach}: residual {fit.pixel_rms:.3f} px, {1e3 * fit.range_rms_m:.2f} mm rms",
        *(f"left out: {name}: {why}" for name, why in fit.left_out),
        *(str(notice) for notice in source.notices),
    ]


def _station_table(fit: BeamFit) -> Table:
    """Where the fit goes through its stations."""
    each = zip(fit.stations, fit.lengths_m, fit.pixel_residuals_px, fit.range_residuals_m, strict=True)
    rows = [
        (s.name, f"{length:.3f}", f"{s.raw_m:.4f}", f"{s.readings}", f"{1e3 * off:+.2f}", *(f"{px:+.3f}" for px in q))
        for s, length, q, off in each
    ]
    return "stations", ("frame", "L, m", "reading, m", "n", "off, mm", "left u, px", "v", "right u", "v"), rows


def _beam_table(rig: Rig) -> Table:
    assert rig.laser is not None
    beam = rig.laser
    values = [*beam.origin_m, *beam.direction, beam.range_scale, beam.range_offset_m]
    sigmas = np.sqrt(np.diag(rig.covariance.of(LASER)))
    rows = [(n, f"{v:.6f}", f"{s:.6f}") for n, v, s in zip(LASER, values, sigmas, strict=True)]
    rows.append(("laser.range_sigma_m", f"{beam.range_sigma_m:.6f}", ""))
    return "laser", ("parameter", "value", "sigma"), rows


def _focal_table(focal: VirtualFocal) -> Table:
    each = zip(focal.z_m, focal.fx_each_px, focal.fy_each_px, strict=True)
    rows = [(f"{z:.3f}", f"{x:.1f}", f"{y:.1f}") for z, x, y in each]
    scatter = focal.scatter_px
    rows += [
        ("mean", f"{focal.fx_px:.1f}", f"{focal.fy_px:.1f}"),
        ("scatter", f"{scatter[0]:.1f}", f"{scatter[1]:.1f}"),
    ]
    return "the paper's virtual focal length, px (eq. 11-12)", ("Z, m", "f'x", "f'y"), rows


def _gain_table(result: Refinement) -> Table:
    rows = [(n, f"{v:.6f}", f"{before:.6f}", f"{after:.6f}") for n, v, before, after in result.gained()]
    return "what the laser dive adds", ("parameter", "value", "sigma before", "sigma after"), rows


def _depth_table(result: Refinement) -> Table:
    before, after = 1e3 * depth_sigmas(result.before), 1e3 * depth_sigmas(result.rig)
    rows = [
        (f"{z:.1f}", *(f"{value:.2f}" for value in (b[0], a[0], b[1], a[1])))
        for z, b, a in zip(DISTANCES_M, before, after, strict=True)
    ]
    heads = ("m", "centre before", "centre after", "half field before", "half field after")
    return "sigma of a stereo depth from calibration, mm", heads, rows


def _with_provenance(rig: Rig, step: str, dive: str, lines: Sequence[str]) -> Rig:
    entry: dict[str, Any] = {"date": now(), "dive": dive, "said": list(lines)}
    return dataclasses.replace(rig, provenance={**rig.provenance, step: entry})
