"""The page of a detector's evaluation: verdict, curve, tables by size, water and class, what went wrong."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from itertools import cycle
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

import numpy as np

from leadline.evaluation.detection import RECALLS
from leadline.evaluation.detection_tables import MISSED, NOTHING, Outcome, Row
from leadline.evaluation.html import items, section, table
from leadline.evaluation.svg import INK, Curve, Marks, chart

if TYPE_CHECKING:
    from leadline.evaluation.detector_report import DetectorReport

_TEMPLATE = Path(__file__).with_name("calibration_report.html")
MOST_CLIPS = 40
IOUS_DRAWN = {0: "IoU 0.5", 5: "IoU 0.75", 8: "IoU 0.9"}
COLOURS = (INK["water"], INK["air"], INK["green"], INK["red"], "#8e5ea2", INK["grey"])
_HEADS = ("labelled", "found", "recall", "false boxes", "precision", "centre error, px: mean", "RMS", "95 %")
_SHEETS = {
    "misses.jpg": ("Worst misses", "The largest ones. Green: labelled. Red: claimed. Beneath: the box that lies best."),
    "false_boxes.jpg": (
        "Surest false boxes",
        "A target here that nobody labelled is a label to add. Those with an IoU of 0.1 to 0.5 with a labelled "
        "box are found, but badly placed.",
    ),
}


def page(report: DetectorReport, curve_svg: str, sheets: Mapping[str, bytes], title: str) -> str:
    """The whole page, its pictures in it."""
    told = lines(report)
    sections = [
        section("Precision and recall", curve_svg + table(*_scores(report))),
        section(
            "By box size", table(("side of the box", *_HEADS), [row_cells(r) for r in report.recall_by_size]), SIZE
        ),
        section("By water", table(*_water(report)), WATER),
        section("What was taken for what", table(*_confusion(report))),
        _clips(report),
        *(section(_SHEETS[n][0], _picture(data, _SHEETS[n][0]), _SHEETS[n][1]) for n, data in sheets.items()),
    ]
    return Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        title="Detector",
        subtitle=escape(title),
        colour=INK["water"],
        verdict=escape(told[0]),
        doubts=items([*told[1:-1], *report.notices]),
        next_action=escape(told[-1]),
        sections="\n".join(section for section in sections if section),
    )


SIZE = "Side: the root of the box's area, of a false box its own. Found: IoU of 0.5 and more, class included."
WATER = (
    "The images in thirds by their local contrast (deviation over mean of the grey levels around a place, where the "
    "image has most): veiling light and blur lower it. Cells: found of labelled boxes, and false boxes."
)


def lines(report: DetectorReport) -> list[str]:
    """The verdict, more of it, and last what to do next."""
    aps = f"AP50 {report.ap50:.3f}, AP75 {report.ap75:.3f}, AP50-95 {report.ap50_95:.3f}"
    every, best = report.all, report.best_score
    at = (
        f"at score {report.score:g}: {every.found} of {every.truths} boxes found (recall {_share(every.recall)}), "
        f"{every.false} false ones (precision {_share(every.precision)})"
    )
    out = [f"{aps} on {_count(report.images, 'image')} with {_count(report.boxes, 'box')}", at]
    if (c := every.centres) is not None:
        out.append(f"centres off by {c.mean_px:.2f} px on average, RMS {c.rms_px:.2f}, 95 % within {c.p95_px:.2f}")
    out.append(_advice(report, best))
    return out


def _count(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}{'es' if what.endswith('x') else 's'}"


def _advice(report: DetectorReport, best: tuple[float, float, float]) -> str:
    score, precision, recall = best
    if recall == 0:
        return "nothing is found: train longer, on images like these"
    return f"precision and recall are best together at score {score:g}: {precision:.2f} and {recall:.2f}"


def curve(outcome: Outcome) -> str:
    """Precision over recall as SVG: of one class at three IoUs, of several at IoU 0.5 each."""
    labelled = {name: quality for name, quality in outcome.by_class.items() if quality.truths}
    if len(labelled) == 1:
        quality = next(iter(labelled.values()))
        drawn = [(f"{what}: AP {quality.ap[k]:.3f}", quality.curves[k]) for k, what in IOUS_DRAWN.items()]
    else:
        drawn = [(f"{name}: AP50 {quality.ap50:.3f}", quality.curves[0]) for name, quality in labelled.items()]
    curves = [Curve(name, RECALLS, y, colour) for (name, y), colour in zip(drawn, cycle(COLOURS), strict=False)]
    marks = []
    if len(labelled) == 1:
        precision, recall = quality.at_score(outcome.score)
        marks = [Marks(f"score {outcome.score:g}", np.array([recall]), np.array([precision]), INK["dark"])]
    return chart(marks, "recall", "precision", "precision over recall", (760, 340), curves=curves)


def _scores(report: DetectorReport) -> tuple[Sequence[str], list[list[str]]]:
    """Every second of the scores that were looked at, as a table that lies on its side."""
    shown = [one for one in report.by_score if round(one[0] * 20) % 2 == 0]
    head = ("score", *(f"{score:g}" for score, _, _ in shown))
    return head, [["precision", *(f"{p:.2f}" for _, p, _ in shown)], ["recall", *(f"{r:.2f}" for _, _, r in shown)]]


def row_cells(row: Row) -> list[str]:
    """A row as text: name, labelled, found, recall, false, precision, centre errors (px): mean, RMS, 95 %."""
    centres = row.centres
    errors = [] if centres is None else [f"{v:.2f}" for v in (centres.mean_px, centres.rms_px, centres.p95_px)]
    return [
        row.name, str(row.truths), str(row.found), _share(row.recall), str(row.false), _share(row.precision),
        *(errors or [""] * 3),
    ]  # fmt: skip


def _water(report: DetectorReport) -> tuple[Sequence[str], list[list[str]]]:
    sizes = [row.name for row in report.by_water[0].by_size]
    head = ("images", "number", "AP50", "recall", "precision", *sizes)
    rows = [
        [
            row.name, str(row.images), _figure(row.ap50), _share(row.all.recall), _share(row.all.precision),
            *(f"{one.found}/{one.truths}, {one.false} false" for one in row.by_size),
        ]
        for row in report.by_water
    ]  # fmt: skip
    return head, rows


def _confusion(report: DetectorReport) -> tuple[Sequence[str], list[list[str]]]:
    names, counts = report.confusion
    rows = [[name, *(str(n) for n in row)] for name, row in zip((*names, NOTHING), counts, strict=True)]
    rows[-1][-1] = ""
    return ("labelled, claimed as", *names, MISSED), rows


def _clips(report: DetectorReport) -> str:
    if len(report.by_clip) < 2:
        return ""
    worst = sorted(report.by_clip, key=lambda row: (row.truths - row.found + row.false) / max(row.truths, 1))[::-1]
    more = len(worst) - MOST_CLIPS
    note = f"The worst {MOST_CLIPS}; {more} more are in summary.json." if more > 0 else "The worst first."
    return section("By clip", table(("clip", *_HEADS), [row_cells(row) for row in worst[:MOST_CLIPS]]), note)


def _share(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _figure(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.3f}"


def _picture(data: bytes, title: str) -> str:
    inside = base64.b64encode(data).decode("ascii")
    return f'<img style="max-width:100%" alt="{escape(title)}" src="data:image/jpeg;base64,{inside}">'
