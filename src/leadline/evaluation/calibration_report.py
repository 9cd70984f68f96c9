"""One page for a calibration: verdict, what was found and how well, where the boards were, residuals, depth error."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from string import Template

import cv2
import numpy as np

from leadline.calibration.cameras import CameraCalibration
from leadline.calibration.comparison import DISTANCES_M, ModelError, calibration_sigma_mm, field_points
from leadline.calibration.verdict import Verdict, band_mm, depth_limits
from leadline.calibration.views import SIDES
from leadline.evaluation.html import items, table
from leadline.evaluation.svg import INK, Curve, arrows, bars, log_chart, picture
from leadline.files import write_whole
from leadline.rig import Side
from leadline.rig_derivatives import Medium

_TEMPLATE = Path(__file__).with_suffix(".html")
_CURVE_M = tuple(np.linspace(0.2, 2.2, 21))
_CELLS = (16, 9)
_NAMES = {
    "port.distance_m": ("port's distance", 1e3, "mm"),
    "port.normal[0]": ("port's tilt, x", 180 / np.pi, "deg"),
    "port.normal[1]": ("port's tilt, y", 180 / np.pi, "deg"),
    "port.layers[0].thickness_m": ("glass, thickness", 1e3, "mm"),
    "port.layers[0].index": ("glass, index", 1.0, ""),
    "water.index": ("water's index", 1.0, ""),
    "board.warp_m[0]": ("board, bent along its rows", 1e3, "mm"),
    "board.warp_m[1]": ("board, bent along its columns", 1e3, "mm"),
    "T_right_left.t_m[0]": ("right camera, x", 1e3, "mm"),
    "T_right_left.t_m[1]": ("right camera, y", 1e3, "mm"),
    "T_right_left.t_m[2]": ("right camera, z", 1e3, "mm"),
    **{
        f"T_right_left.rotation_rad[{i}]": (f"right camera, turn about {'xyz'[i]}", 180 / np.pi, "deg")
        for i in range(3)
    },
    **{
        f"{side}.{key}": (f"{side} {key.removesuffix('_px')}", 1.0, "px")
        for side in SIDES
        for key in ("fx_px", "fy_px", "cx_px", "cy_px")
    },
}


def write_page(
    path: Path,
    calibration: CameraCalibration,
    models: Sequence[ModelError],
    verdict: Verdict,
    remarks: Sequence[str],
) -> None:
    """Write the page, whole or not at all. InputError where the folder cannot be written."""
    sections = [
        _coverage(calibration),
        _residuals(calibration),
        _depth(calibration, models),
        _comparison(calibration, models),
        _limits(calibration),
        _parameters(calibration),
        _images(calibration),
        _list("Remarks", remarks),
    ]
    board = calibration.board
    counts = ", ".join(
        f"{sum(v.medium is m for v in calibration.views)} boards in {m}" for m in sorted(calibration.media())
    )
    page = Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        title="Camera calibration",
        subtitle=f"{counts}; {board.columns}x{board.rows} corners of {board.square_m * 1e3:g} mm; "
        f"{calibration.fit.rms_px:.3f} px rms, corners' noise {calibration.fit.sigma_px:.3f} px",
        colour=INK["green"] if verdict.good else INK["red"],
        verdict=escape(verdict.line.capitalize()),
        doubts=items(verdict.doubts if verdict.good else verdict.doubts[1:]),
        next_action=escape(verdict.next_action),
        sections="\n".join(section for section in sections if section),
    )
    write_whole(path, page)


def _section(title: str, body: str, note: str = "") -> str:
    told = f'<p class="note">{note}</p>' if note else ""
    return f"<h2>{escape(title)}</h2>{told}{body}"


def _list(title: str, lines: Sequence[str]) -> str:
    return _section(title, items(lines)) if lines else ""


def _figure(drawing: str, caption: str) -> str:
    return f"<figure>{drawing}<figcaption>{escape(caption)}</figcaption></figure>"


def _row(figures: Sequence[str]) -> str:
    return f'<div class="row">{"".join(figures)}</div>'


def _size(calibration: CameraCalibration) -> tuple[int, int]:
    return calibration.rig.left.width, calibration.rig.left.height


def _sides(calibration: CameraCalibration) -> tuple[Side, ...]:
    return SIDES[:1] if calibration.mono else SIDES


def _coverage(calibration: CameraCalibration) -> str:
    figures = []
    for side in _sides(calibration):
        sets = []
        for medium in sorted(calibration.media()):
            pixels = [s.pixels for s in calibration.problem.sights if s.side == side and s.medium is medium]
            if pixels:
                sets.append((np.concatenate(pixels), INK["water" if medium is Medium.WATER else "air"]))
        figures.append(_figure(picture(_size(calibration), 480, sets, f"corners in the {side} image"), f"{side} image"))
    return _section("Where the boards were", _row(figures), "Corners in air are orange, in water blue.")


def _residuals(calibration: CameraCalibration) -> str:
    """Mean residual of each cell: noise averages out, what the model cannot explain stays."""
    figures = []
    for side in _sides(calibration):
        members = [i for i, s in enumerate(calibration.problem.sights) if s.side == side]
        if not members:
            continue
        pixels = np.concatenate([calibration.problem.sights[i].pixels for i in members])
        residuals = np.concatenate([calibration.fit.residuals[i] for i in members])
        width, height = _size(calibration)
        column = np.clip(pixels[:, 0] / width * _CELLS[0], 0, _CELLS[0] - 1).astype(int)
        cell = column + _CELLS[0] * np.clip(pixels[:, 1] / height * _CELLS[1], 0, _CELLS[1] - 1).astype(int)
        used = [c for c in np.unique(cell) if np.sum(cell == c) >= 5]
        if not used:
            continue
        places = np.array([pixels[cell == c].mean(axis=0) for c in used])
        means = np.array([residuals[cell == c].mean(axis=0) for c in used])
        drawing = arrows((width, height), 480, places, means, calibration.fit.sigma_px, f"mean residuals, {side}")
        figures.append(_figure(drawing, f"{side} image"))
    note = "Mean of each cell. A good model leaves short arrows in no order; long ones that agree show what it lacks."
    return _section("Residuals", _row(figures), note)


def _depth(calibration: CameraCalibration, models: Sequence[ModelError]) -> str:
    if not len(band_mm(calibration)):
        return ""
    points = field_points(calibration.rig, _CURVE_M)
    sigma = calibration_sigma_mm(calibration.rig, points.reshape(-1, 3))[0].reshape(points.shape[:2])
    x = np.array(_CURVE_M)
    curves = [
        Curve("ours, corner (1 sigma)", x, sigma[:, 2], "#7fb3d1"),
        Curve("ours, half field", x, sigma[:, 1], "#3d93c2"),
        Curve("ours, centre", x, sigma[:, 0], INK["water"]),
    ]
    colours = (INK["red"], INK["air"], INK["grey"])
    for model, colour in zip(models, colours, strict=False):
        curves.append(Curve(f"{model.name}, centre", np.array(DISTANCES_M), abs(model.depth_mm[:, 0]), colour, True))
    drawing = log_chart(curves, "distance, m", "depth error, mm", "depth error by distance", (900, 340))
    note = "From the calibration alone; every measurement adds its own noise. Dashed: what simpler models would cost."
    return _section("Depth error by distance", drawing, note)


def _comparison(calibration: CameraCalibration, models: Sequence[ModelError]) -> str:
    if not models:
        return ""
    band = band_mm(calibration)
    points = field_points(calibration.rig).reshape(-1, 3)
    whole = calibration_sigma_mm(calibration.rig, points)[1].reshape(band.shape)

    def row(name: str, depth: np.ndarray, total: np.ndarray, sign: str) -> list[str]:
        cells = [f"{_short(depth[i, 0], sign)} / {_short(total[i, 2])}" for i in range(len(DISTANCES_M))]
        return [name, *cells]

    rows = [row("ours (1 sigma)", band, whole, "")]
    rows += [row(model.name, model.depth_mm, model.total_mm, "+") for model in models]
    head = ["mm, depth at the centre / 3D in the corner", *(f"{z:g} m" for z in DISTANCES_M)]
    note = "The refractive rig is taken for the truth: what each simpler model would be wrong by."
    return _section("What simpler models would cost", table(head, rows), note)


def _short(value_mm: float, sign: str = "") -> str:
    return f"{value_mm:{sign}.{2 if abs(value_mm) < 20 else 0}f}"


def _limits(calibration: CameraCalibration) -> str:
    shares = depth_limits(calibration)
    if not shares:
        return ""
    values = [(name, 100 * share, INK["water"]) for name, share in sorted(shares.items(), key=lambda item: -item[1])]
    note = "How much of the depth's variance would go if this part were known exactly (parts overlap)."
    return _section("What limits it", bars(values, 640, "%", "what limits the depth"), note)


def _parameters(calibration: CameraCalibration) -> str:
    rows = []
    for name in calibration.fit.names:
        label, factor, unit = _NAMES.get(name, (name, 1.0, ""))
        value, sigma = calibration.fit.value(name) * factor, calibration.fit.sigma(name) * factor
        if "rotation_rad" in name:  # the file's parameter is a small turn, 0 by definition
            value = float(np.degrees(cv2.Rodrigues(calibration.rig.T_right_left.R)[0].ravel()[int(name[-2])]))
        prior = calibration.priors.get(name)
        known = prior is not None and (name == "water.index" or "layers" in name or "warp" in name)
        before = f"{prior.mean * factor:.5g} +-{prior.sigma * factor:.2g}" if prior is not None and known else ""
        rows.append([label, f"{value:.6g}", f"{sigma:.2g}", unit, before])
    return _section("What was found", table(["", "value", "sigma", "", "before the images"], rows))


def _images(calibration: CameraCalibration) -> str:
    rms: dict[int, list[float]] = {}
    for sight, r in zip(calibration.problem.sights, calibration.fit.residuals, strict=True):
        rms.setdefault(sight.view, []).append(float(np.sqrt((r**2).sum(axis=1).mean())))
    values = []
    for view, parts in rms.items():
        v = calibration.views[view]
        colour = INK["water" if v.medium is Medium.WATER else "air"]
        values.append((f"{v.name} ({v.medium})", float(np.mean(parts)), colour))
    body = bars(values, 760, "px", "rms of each image")
    left_out = [f"{o.name} ({o.side}): {o.why} ({o.median_px:.2f} px)" for o in calibration.left_out]
    return _section("Images", body + (f"<p>Left out:</p>{items(left_out)}" if left_out else ""))
