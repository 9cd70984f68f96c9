"""The pictures of a run (the only file that imports matplotlib): range, stages, uncertainty, errors.

Colours are Okabe and Ito's, told apart by the colour-blind; every line also has its own style.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from leadline.evaluation.accuracy import Errors
from leadline.samples import NS_PER_S, Array, Solution, Stage, Status, Truth

BLACK, BLUE, VERMILION, PURPLE, GREY = "#000000", "#0072B2", "#D55E00", "#CC79A7", "#767676"
STAGE_COLOURS = {Stage.BINOCULAR: "#56B4E9", Stage.BOTH: "#009E73", Stage.LASER: "#E69F00"}
STAGE_LABELS = {Stage.BINOCULAR: "1 binocular", Stage.BOTH: "2 both", Stage.LASER: "3 laser"}
BAND_ALPHA = 0.12
BESIDE: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0), "fontsize": 9, "frameon": False}


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One method's solutions and, where the truth is known, their errors (``own_point``: against its own point)."""

    name: str
    solutions: Sequence[Solution]
    errors: Errors
    own_point: bool = False

    @property
    def error_m(self) -> Array:
        return self.errors.own_point_m if self.own_point else self.errors.range_m


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """What a run's picture shows. ``laser``: times and distances of lit points (N, 2); ``other``: a second method."""

    title: str
    main: Curve
    truth: Sequence[Truth] = ()
    laser: Array = field(default_factory=lambda: np.empty((0, 2)))
    other: Curve | None = None


def plot_run(path: Path, picture: Picture) -> None:
    """Write one PNG: range over time above, beneath it the error (without truth: the stated uncertainty)."""
    figure = Figure(figsize=(12, 7), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    start_s = _start_s(picture)
    span_s = _span_s(picture, start_s)
    for axes in (upper, lower):
        _stage_bands(axes, picture.main.solutions, start_s, span_s[1])
        axes.grid(visible=True, color="#DDDDDD", linewidth=0.6)
        axes.set_axisbelow(True)
    _ranges(upper, picture, start_s)
    known = len(picture.main.errors.t_s) or (picture.other is not None and len(picture.other.errors.t_s))
    (_errors if known else _uncertainty)(lower, picture, start_s)
    upper.set_xlim(*span_s)
    upper.set_title(picture.title, loc="left", fontsize=11)
    lower.set_xlabel("time since the start [s]" if start_s else "time [s]")
    figure.savefig(path)


def plot_by_distance(path: Path, curve: Curve, title: str) -> None:
    """Write one PNG: errors over true range, and beneath it in stated sigmas; colours are the stages."""
    figure = Figure(figsize=(12, 7), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    upper, lower = figure.subplots(2, 1, sharex=True)
    errors = curve.errors
    for stage, colour in STAGE_COLOURS.items():
        of = errors.stage == stage
        if of.any():
            style: dict[str, Any] = {"color": colour, "markersize": _dot(errors.t_s), "label": STAGE_LABELS[stage]}
            upper.plot(errors.truth_range_m[of], 1e3 * curve.error_m[of], "o", **style)
            lower.plot(errors.truth_range_m[of], curve.error_m[of] / errors.sigma_m[of], "o", **style)
    for sigmas, dash in ((1, "-"), (2, "--"), (3, ":")):
        for side in (sigmas, -sigmas):
            lower.axhline(side, color=GREY, linestyle=dash, linewidth=0.9)
    for axes, name in ((upper, "range error [mm]"), (lower, "range error [stated sigmas]")):
        axes.grid(visible=True, color="#DDDDDD", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.axhline(0, color=BLACK, linewidth=0.8)
        axes.set_ylabel(name)
    if len(errors.t_s):
        upper.legend(**BESIDE)
    upper.set_title(title, loc="left", fontsize=11)
    lower.set_xlabel("true range [m]")
    figure.savefig(path)


def _start_s(picture: Picture) -> float:
    """Wall-clock stamps are counted from the first solution, a dive's own from zero."""
    first = min((solution.t_s for solution in picture.main.solutions), default=0.0)
    return first if abs(first) > 1e4 else 0.0


def _span_s(picture: Picture, start_s: float) -> tuple[float, float]:
    """From the first to the last solution, with a little room: an interrupted run's truth goes on for longer."""
    times = [solution.t_s - start_s for solution in picture.main.solutions] or [0.0]
    room = 0.02 * (max(times) - min(times)) or 0.5
    return min(times) - room, max(times) + room


def _stage_bands(axes: Axes, solutions: Sequence[Solution], start_s: float, end_s: float) -> None:
    ordered = sorted(solutions, key=lambda s: s.t_ns)
    runs = [(stage, [s.t_s - start_s for s in group]) for stage, group in groupby(ordered, lambda s: s.stage)]
    for i, (stage, times) in enumerate(runs):
        end = runs[i + 1][1][0] if i + 1 < len(runs) else end_s
        if stage in STAGE_COLOURS:
            axes.axvspan(times[0], end, color=STAGE_COLOURS[stage], alpha=BAND_ALPHA, linewidth=0)


def _ranges(axes: Axes, picture: Picture, start_s: float) -> None:
    t, r, sigma = _track(picture.main.solutions)
    t = t - start_s
    if len(picture.laser):
        axes.plot(
            picture.laser[:, 0] - start_s,
            picture.laser[:, 1],
            ".",
            color=PURPLE,
            markersize=5,
            label="laser, lit point",
        )
    if picture.other is not None:
        other_t, other_r, _ = _track(picture.other.solutions)
        axes.plot(other_t - start_s, other_r, "x", color=VERMILION, markersize=4, alpha=0.8, label=picture.other.name)
    axes.fill_between(t, r - 2 * sigma, r + 2 * sigma, color=BLUE, alpha=0.3, linewidth=0, label="two stated sigmas")
    axes.plot(t, r, "-", color=BLUE, linewidth=1.6, marker="o", markersize=_dot(t), label=picture.main.name)
    if picture.truth:
        axes.plot(
            [station.t_ns / NS_PER_S - start_s for station in picture.truth],
            [station.range_m for station in picture.truth],
            "--", color=BLACK, linewidth=1.2, label="truth, nearest surface",
        )  # fmt: skip
    axes.set_ylabel("range [m]")
    axes.set_ylim(0, _top(np.concatenate([r, [station.range_m for station in picture.truth]])))
    present = {solution.stage for solution in picture.main.solutions}
    bands = [
        Patch(color=STAGE_COLOURS[stage], alpha=2 * BAND_ALPHA, label=f"stage {STAGE_LABELS[stage]}")
        for stage in STAGE_COLOURS
        if stage in present
    ]
    handles = [*axes.get_legend_handles_labels()[0], *bands]
    axes.legend(handles=handles, **BESIDE)


def _errors(axes: Axes, picture: Picture, start_s: float) -> None:
    t, _, sigma = _track(picture.main.solutions)
    axes.fill_between(
        t - start_s, -2e3 * sigma, 2e3 * sigma, color=BLUE, alpha=0.22, linewidth=0, label="two stated sigmas"
    )
    limit = _error_limit_mm(picture, sigma)
    axes.axhline(0, color=BLACK, linewidth=0.8)
    for curve, colour, marker in ((picture.other, VERMILION, "x"), (picture.main, BLUE, "o")):
        if curve is None or not len(curve.errors.t_s):
            continue
        error, when = 1e3 * curve.error_m, curve.errors.t_s - start_s
        size = 4 if marker == "x" else _dot(when)
        name = f"{curve.name}, own point" if curve.own_point else curve.name
        axes.plot(when, error, marker, color=colour, markersize=size, alpha=0.85, label=name)
        _beyond(axes, when, error, limit, colour)
    if picture.other is not None:  # centimetres beside millimetres
        axes.set_yscale("symlog", linthresh=10, linscale=1.5)
        axes.yaxis.set_major_formatter("{x:g}")
    axes.set_ylim(-limit, limit)
    axes.set_ylabel("range error [mm]" if picture.other is None else "range error [mm], log beyond 10")
    axes.legend(**BESIDE)


def _beyond(axes: Axes, when_s: Array, error_mm: Array, limit_mm: float, colour: str) -> None:
    """What does not fit is marked at the edge, not left out."""
    for sign, marker in ((1, "^"), (-1, "v")):
        off = sign * error_mm > limit_mm
        if off.any():
            edge = np.full(int(off.sum()), sign * 0.96 * limit_mm)
            axes.plot(when_s[off], edge, marker, color=colour, markersize=6)


def _error_limit_mm(picture: Picture, sigma_m: Array) -> float:
    sizes = [np.nanpercentile(2e3 * sigma_m, 90)] if np.isfinite(sigma_m).any() else []
    curves = [picture.main] if picture.other is None else [picture.main, picture.other]
    sizes += [np.percentile(np.abs(1e3 * c.error_m), 95) for c in curves if len(c.error_m)]
    return max(1.25 * max(sizes, default=1.0), 1.0)


def _uncertainty(axes: Axes, picture: Picture, start_s: float) -> None:
    t, _, sigma = _track(picture.main.solutions)
    axes.plot(t - start_s, 2e3 * sigma, "-", color=BLUE, marker="o", markersize=_dot(t), label=picture.main.name)
    axes.set_ylabel("two stated sigmas of range [mm]")
    axes.set_ylim(0, _top(2e3 * sigma))
    axes.legend(**BESIDE)


def _track(solutions: Sequence[Solution]) -> tuple[Array, Array, Array]:
    """t, range, sigma, each (N,); NaN where lost, so that lines break there."""
    nan = float("nan")
    rows = [
        (s.t_s, nan, nan)
        if s.status is Status.LOST or s.range_m is None
        else (s.t_s, s.range_m, s.range_sigma_m or nan)
        for s in sorted(solutions, key=lambda s: s.t_ns)  # a late sample's solution stands after newer ones
    ]
    columns = np.array(rows, dtype=np.float64).reshape(-1, 3).T
    return columns[0], columns[1], columns[2]


def _dot(t_s: Array) -> float:
    """Few points are seen one by one, many as a line."""
    return 4.0 if len(t_s) < 80 else 2.0


def _top(values: Array) -> float:
    return 1.12 * float(np.nanmax(values)) if np.isfinite(values).any() else 1.0
