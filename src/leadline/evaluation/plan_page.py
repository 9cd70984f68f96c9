"""The page of a plan: accuracy by distance, where each measurement can be had, what would improve it."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from string import Template

import numpy as np

from leadline.evaluation.html import items, section, table
from leadline.evaluation.plan import AIMED, DISTANCES_M, Cell
from leadline.evaluation.plan_report import KINDS, Plan, lines
from leadline.evaluation.plan_view import FINE_M, HandOvers
from leadline.evaluation.svg import INK, Curve, bars, frame, line, log_chart, text
from leadline.files import write_whole

_TEMPLATE = Path(__file__).with_name("calibration_report.html")
SAME_M = 1e-6
PAGE, CHART, NUMBERS = "plan.html", "plan.svg", "plan.json"
HEADS = ("stereo", "outline", "spot", "laser", "one frame", "filtered", "without laser", "calibration", "3D")
SHORT = {"stereo": "stereo", "size": "outline", "spot": "spot", "laser": "laser"}
_COLOURS = {"stereo": INK["water"], "size": INK["air"], "spot": INK["green"], "laser": INK["red"]}


def write(out: Path, plan: Plan) -> list[Path]:
    """Page, chart and numbers in a folder. InputError where that cannot be written."""
    contents = {PAGE: page(plan), CHART: chart(plan) + "\n", NUMBERS: json.dumps(plan.plain(), indent=1) + "\n"}
    for name, content in contents.items():
        write_whole(out / name, content)
    return [out / name for name in contents]


def page(plan: Plan) -> str:
    """The whole page."""
    told = list(lines(plan))
    gains = [(gain.change.rstrip(","), 1e3 * gain.after_m, INK["water"]) for gain in plan.gains]
    if plan.gains:
        gains.insert(0, ("as it is", 1e3 * plan.gains[0].before_m, INK["grey"]))
        ranked = section(f"What would improve it: sigma of the range at {plan.gains[0].distance_m:g} m", _bars(gains))
    else:
        ranked = ""
    sections = [
        section("Accuracy by distance", chart(plan)),
        section("With all that the rig has, mm", table(*_by_distance(plan))),
        section("Over the field of view: one frame alone / filtered, mm", table(*by_place(plan))),
        section("From where to where", spans(plan.hand_overs)),
        ranked,
        section("What this rests on", items(plan.assumptions)),
    ]
    return Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        title="Plan",
        subtitle=escape(f"{plan.name} · {plan.target}"),
        colour=INK["water"],
        verdict=escape(told[0].capitalize()),
        doubts=items(told[1:]),
        next_action=escape(str(plan.advice()[0])) if plan.advice() else "no single change helps much",
        sections="\n".join(section for section in sections if section),
    )


def chart(plan: Plan) -> str:
    """Sigma of the range over distance, as inline SVG."""
    aimed = plan.aimed()

    def of(kind: str) -> Callable[[Cell], float | None]:
        return lambda cell: cell.each.get(kind)

    kinds = [
        Curve(f"{SHORT[kind]}, one frame", *_curve(aimed, of(kind)), colour, dashed=True)
        for kind, colour in _COLOURS.items()
    ]
    whole = [
        Curve("one frame, all of it", *_curve(aimed, lambda c: c.alone_m), INK["grey"]),
        Curve("filtered", *_curve(aimed, lambda c: c.filtered_m), INK["dark"]),
        Curve(
            "filtered, without laser",
            *_curve(plan.without_laser, lambda c: c.filtered_m),
            "#8e5ea2",
        ),
        Curve("calibration's part", *_curve(aimed, lambda c: c.calibration_m or None), "#b08968", dashed=True),
    ]
    shown = [curve for curve in (*whole, *kinds) if len(curve.x)]
    if not shown:
        return ""
    return log_chart(shown, "distance, m", "sigma of the range, mm", "sigma of the range by distance", (900, 380))


def _curve(cells: Sequence[Cell], value: Callable[[Cell], float | None]) -> tuple[np.ndarray, np.ndarray]:
    known = [(cell.distance_m, 1e3 * v) for cell in cells if (v := value(cell)) is not None]
    return np.array([x for x, _ in known]), np.array([y for _, y in known])


def spans(hand: HandOvers, width: float = 760) -> str:
    """From where to where each measurement can be had, over the logarithm of the distance."""
    left, right = 210.0, width - 20
    low, high = np.log(FINE_M[0]), np.log(FINE_M[-1])

    def across(distance_m: float) -> float:
        return float(left + (right - left) * (np.log(distance_m) - low) / (high - low))

    rows = [(KINDS[kind], span, _COLOURS[kind]) for kind, span in hand.spans_m.items()]
    if hand.fills_until_m is not None:
        rows.append(("the target fills the view", (FINE_M[0], hand.fills_until_m), INK["grey"]))
    height = 22.0 * len(rows) + 24
    parts = []
    for tick in (0.05, 0.1, 0.2, 0.5, 1, 2, 5):
        parts += [
            line(across(tick), 0, across(tick), height - 20),
            text(across(tick), height - 6, f"{tick:g} m", "middle"),
        ]
    for i, (name, (first, last), colour) in enumerate(rows):
        parts.append(text(0, 22 * i + 15, name))
        parts.append(line(across(first), 22 * i + 11, across(last), 22 * i + 11, colour, 9))
    return frame(width, height, parts, "from where to where each measurement can be had")


def _by_distance(plan: Plan) -> tuple[list[str], list[list[str]]]:
    return ["m", *HEADS], [[f"{cell.distance_m:g}", *values(plan, cell)] for cell in plan.aimed()]


def values(plan: Plan, cell: Cell) -> list[str]:
    """The cells of a row under ``HEADS``, millimetres."""
    bare = next((other for other in plan.without_laser if abs(other.distance_m - cell.distance_m) < SAME_M), None)
    numbers = [cell.each.get(kind) for kind in _COLOURS]
    numbers += [cell.alone_m, cell.filtered_m, None if bare is None else bare.filtered_m, cell.calibration_m]
    numbers.append(None if cell.filtered is None else cell.filtered.position_m)
    return [millimetres(number) for number in numbers]


def millimetres(value_m: float | None) -> str:
    if value_m is None:
        return ""
    return f"{1e3 * value_m:.2f}" if value_m < 0.00995 else f"{1e3 * value_m:.1f}"


def by_place(plan: Plan) -> tuple[tuple[str, ...], list[list[str]]]:
    """Heads and rows: one frame alone / filtered over the field of view."""
    names = list(dict.fromkeys(cell.place for cell in plan.cells if cell.place != AIMED))
    return ("m", *names), [[f"{z:g}", *_places_row(plan, z, names)] for z in DISTANCES_M]


def _places_row(plan: Plan, distance_m: float, names: Sequence[str]) -> list[str]:
    here = {cell.place: cell for cell in plan.cells if abs(cell.distance_m - distance_m) < SAME_M}
    found = [here.get(name) for name in names]
    return ["" if cell is None else f"{millimetres(cell.alone_m)} / {millimetres(cell.filtered_m)}" for cell in found]


def _bars(gains: list[tuple[str, float, str]]) -> str:
    return bars(gains, 860, "mm", "sigma after each change")
