"""What the command line shows at the end of a run (Rich)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rich.table import Table

from leadline.evaluation.accuracy import STAGE_NAMES, Errors, Row, by_stage
from leadline.pipeline import Report
from leadline.recognition.boxes import KEY, NO_FRAME

MM = 1000.0
HEAD = (
    "n",
    "mean\n|error|",
    "mean",
    "RMS",
    "largest",
    "stated\nsigma",
    "within\n1/2/3 sigma",
    "NEES",
    "silent\nerrors",
)
NAMES = {"fused": "leadline", "paper": "the paper's method"}


def tables(report: Report) -> Iterator[Table]:
    """Errors by stage where the truth is known, ours and the paper's; else the stages with their stated sigma."""
    known = {name: errors for name, errors in report.errors.items() if len(errors.t_s)}
    if not known:
        yield _stages(report.summary)
        return
    for name, errors in known.items():
        if name == "paper":
            own = by_stage(errors, own_point=True)
            yield error_table(f"{NAMES[name]}: D against its own point of the surface, mm", own)
        yield error_table(f"{NAMES.get(name, name)}: range against the nearest surface, mm", by_stage(errors))


def beside(ours: Errors, paper: Errors) -> Table:
    """Ours beside the paper's method, each by the stage that it was in itself, millimetres."""
    table = Table(title="|range error| by stage in mm: ours beside the paper's method", title_justify="left")
    table.add_column("stage")
    for name in ("n", "ours\nnearest surface", "n", "paper\nits own point", "paper\nnearest surface"):
        table.add_column(name if name == "n" else f"{name}\nmean (max)", justify="right")
    a, own, near = (_by_name(rows) for rows in (by_stage(ours), by_stage(paper, own_point=True), by_stage(paper)))
    for name in [*STAGE_NAMES.values(), "all"]:
        if name in a or name in own:
            cells = [_count(a.get(name)), _mean(a.get(name)), _count(own.get(name))]
            table.add_row(name, *cells, _mean(own.get(name)), _mean(near.get(name)))
    return table


def _count(row: Row | None) -> str:
    return "" if row is None else str(row.count)


def _by_name(rows: list[Row]) -> dict[str, Row]:
    return {row.name: row for row in rows}


def _mean(row: Row | None) -> str:
    return "" if row is None else f"{MM * row.mean_m:.1f} ({MM * row.max_m:.1f})"


def error_table(title: str, rows: list[Row], what: str = "stage") -> Table:
    """Millimetres; an honest sigma holds 68/95/99.7 %, an honest covariance has a NEES of 1 a dimension."""
    table = Table(title=title, title_justify="left", box=None, padding=(0, 1, 0, 0))
    table.add_column(what, no_wrap=True)
    for name in HEAD:
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        numbers = [f"{MM * value:.1f}" for value in (row.mean_m, row.bias_m, row.rms_m, row.max_m, row.sigma_m)]
        within = "/".join(f"{100 * share:.0f}" for share in row.coverage)
        nees = "" if row.nees is None else f"{row.nees:.2f}"
        table.add_row(row.name, str(row.count), *numbers, within, nees, str(row.silent))
    return table


def _stages(summary: Mapping[str, Any]) -> Table:
    table = Table(title="solutions by stage", title_justify="left")
    for name in ("stage", "solutions"):
        table.add_column(name, justify="left" if name == "stage" else "right")
    for stage, name in STAGE_NAMES.items():
        count = summary["stages"][str(int(stage))]
        if count:
            table.add_row(name, str(count))
    return table


def remarks(summary: Mapping[str, Any]) -> Iterator[str]:
    """One line each: how many, how certain, how fast, what a pixel costs, what was skipped."""
    status = ", ".join(f"{count} {name}" for name, count in summary["status"].items() if count) or "none"
    yield f"{summary['frames']} frames, {summary['readings']} laser readings; solutions: {status}"
    sigma = summary["range_sigma_m"]
    if sigma is not None:
        yield f"stated range sigma: median {MM * sigma['median']:.2f} mm, largest {MM * sigma['max']:.2f} mm"
    cost = summary["pixel_cost"]
    if cost is not None:
        yield f"one pixel of disparity is {_length(cost['m_per_px'])} at the median range of {cost['range_m']:.2f} m"
    step = summary["step_ms"]
    if step is not None:
        yield f"{summary['wall_s']:.1f} s, {summary['frames_per_s']:.1f} frames/s; a step takes {step['median']:.0f} ms"
    for kind, count in summary["notices"]["counts"].items():
        if kind == "late":  # two sensors of different latency: as it should be, and counted in the summary
            continue
        first = next(text for text in summary["notices"]["first"] if text.startswith(kind))
        yield f"{count} {kind}, the first: {first.removeprefix(kind + ': ')}"
    boxes = summary["boxes"]
    if boxes is not None and not boxes["found"]:
        yield f"{NO_FRAME}; {KEY}" if boxes["images"] else "the file of boxes is empty: nothing was looked for"
    yield from summary["agreement"]
    if summary["interrupted"]:
        yield "interrupted: everything up to there is kept"


def _length(length_m: float) -> str:
    return f"{length_m:.2f} m" if length_m >= 1 else f"{MM * length_m:.3g} mm"
