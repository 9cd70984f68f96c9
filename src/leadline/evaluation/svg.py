"""A few drawings as inline SVG, without a plotting library: a page of them opens anywhere and weighs little."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from leadline.samples import Array

INK = {"air": "#c77d0a", "water": "#0b6fa4", "grey": "#8a8f98", "red": "#c0392b", "green": "#2e7d4f", "dark": "#24303c"}
_FONT = 'font-family="system-ui, sans-serif" font-size="12" fill="#24303c"'


def frame(width: float, height: float, parts: Sequence[str], title: str) -> str:
    """A drawing with a title for those who cannot see it."""
    size = f'viewBox="0 0 {width:g} {height:g}" width="{width:g}" height="{height:g}"'
    return f'<svg {size} role="img" xmlns="http://www.w3.org/2000/svg"><title>{escape(title)}</title>{"".join(parts)}</svg>'


def text(x: float, y: float, words: str, anchor: str = "start") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" {_FONT}>{escape(words)}</text>'


def line(x1: float, y1: float, x2: float, y2: float, colour: str = "#d5d9de", width: float = 1) -> str:
    at = f'x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"'
    return f'<line {at} stroke="{colour}" stroke-width="{width:g}"/>'


def dots(points: Array, colour: str, radius: float = 1.2) -> str:
    """Points (N, 2) as one path: thousands of circles would make the page heavy."""
    moves = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in points)
    style = f'stroke="{colour}" stroke-width="{2 * radius:g}" stroke-linecap="round" stroke-opacity="0.55" fill="none"'
    return f'<path d="{moves}" {style}/>'


def picture(size: tuple[int, int], width: float, sets: Sequence[tuple[Array, str]], title: str) -> str:
    """Where corners (N, 2), px, lie in an image of ``size``, in one colour for each set."""
    scale = width / size[0]
    height = size[1] * scale
    parts = [f'<rect width="{width:g}" height="{height:.1f}" fill="#f6f7f9" stroke="#d5d9de"/>']
    parts += [line(width * i / 6, 0, width * i / 6, height) for i in range(1, 6)]
    parts += [line(0, height * i / 4, width, height * i / 4) for i in range(1, 4)]
    parts += [dots((pixels + 0.5) * scale, colour) for pixels, colour in sets]
    return frame(width, height, parts, title)


def arrows(size: tuple[int, int], width: float, pixels: Array, vectors: Array, longest_px: float, title: str) -> str:
    """Vectors (N, 2), px, at pixels (N, 2) of an image; one of ``longest_px`` is drawn 30 wide."""
    scale, gain = width / size[0], 30 / longest_px
    height = size[1] * scale
    parts = [f'<rect width="{width:g}" height="{height:.1f}" fill="#f6f7f9" stroke="#d5d9de"/>']
    for q, v in zip((pixels + 0.5) * scale, vectors * gain, strict=True):
        colour = INK["red"] if np.hypot(*v) > 15 else INK["dark"]
        parts.append(line(q[0], q[1], q[0] + v[0], q[1] + v[1], colour, 1.5))
        parts.append(dots(q[None], colour, 2.5))
    parts += [line(10, height - 10, 40, height - 10, INK["red"], 2), text(46, height - 6, f"{longest_px:.2g} px")]
    return frame(width, height, parts, title)


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """y (N,) over x (N,); a dashed one is another model's."""

    name: str
    x: Array
    y: Array
    colour: str
    dashed: bool = False


def log_chart(curves: Sequence[Curve], x_label: str, y_label: str, title: str, size: tuple[int, int]) -> str:
    """Curves on a logarithmic vertical axis: models differ by a factor of a thousand."""
    width, height = size
    left, right, top, bottom = 52.0, width - 190.0, 26.0, height - 36.0
    values = np.concatenate([c.y[np.isfinite(c.y) & (c.y > 0)] for c in curves])
    low, high = np.floor(np.log10(values.min())), np.ceil(np.log10(values.max()))
    x_high = max(float(c.x.max()) for c in curves)

    def place(x: Array, y: Array) -> tuple[Array, Array]:
        across = left + (right - left) * x / x_high
        return across, bottom - (bottom - top) * (np.log10(y) - low) / (high - low)

    parts = []
    for power in np.arange(low, high + 1):
        y = float(place(np.zeros(1), np.array([10.0**power]))[1][0])
        parts += [line(left, y, right, y), text(left - 6, y + 4, f"{10.0**power:g}", "end")]
    for tick in np.arange(0, x_high + 0.01, 0.5):
        x = float(place(np.array([tick]), np.ones(1))[0][0])
        parts += [line(x, bottom, x, bottom + 4), text(x, bottom + 17, f"{tick:g}", "middle")]
    ends: list[float] = []
    for c in sorted(curves, key=lambda curve: -float(np.nan_to_num(curve.y[-1]))):
        known = np.isfinite(c.y) & (c.y > 0)
        across, up = place(c.x[known], c.y[known])
        path = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(across, up, strict=True))
        dash = ' stroke-dasharray="5 4"' if c.dashed else ""
        parts.append(f'<path d="{path}" fill="none" stroke="{c.colour}" stroke-width="2"{dash}/>')
        at = max(float(up[-1]) + 4, ends[-1] + 14 if ends else -np.inf)
        ends.append(at)
        parts.append(text(right + 6, at, c.name))
    parts += [text((left + right) / 2, height - 4, x_label, "middle"), text(4, 12, y_label)]
    return frame(width, height, parts, title)


@dataclass(frozen=True, slots=True, eq=False)
class Marks:
    """Points x (N,), y (N,); with sigma (N,) each has a bar of one standard deviation; hollow ones stand apart."""

    name: str
    x: Array
    y: Array
    colour: str
    sigma: Array | None = None
    hollow: bool = False


def chart(
    marks: Sequence[Marks],
    x_label: str,
    y_label: str,
    title: str,
    size: tuple[int, int],
    *,
    curves: Sequence[Curve] = (),
    zero: bool = True,
) -> str:
    """Points and curves on plain axes; ``zero``: the vertical one has its zero, drawn as a line."""
    width, height = size
    left, right, top, bottom = 60.0, width - 190.0, 26.0, height - 36.0
    x_ticks = _ticks(np.concatenate([m.x for m in marks] + [c.x for c in curves]))
    ends = [m.y + s for m in marks for s in ((0,) if m.sigma is None else (m.sigma, -m.sigma))]
    y_ticks = _ticks(np.concatenate([*ends, *(c.y for c in curves), *([np.zeros(1)] if zero else [])]))

    def place(x: Array, y: Array) -> Array:
        across = left + (right - left) * (x - x_ticks[0]) / (x_ticks[-1] - x_ticks[0])
        return np.column_stack([across, bottom - (bottom - top) * (y - y_ticks[0]) / (y_ticks[-1] - y_ticks[0])])

    parts = []
    for tick in y_ticks:
        y = place(x_ticks[:1], np.array([tick]))[0, 1]
        strong = zero and abs(tick) < 1e-12
        parts += [
            line(left, y, right, y, INK["grey"] if strong else "#e4e7eb"),
            text(left - 6, y + 4, f"{tick:g}", "end"),
        ]
    for tick in x_ticks:
        x = place(np.array([tick]), y_ticks[:1])[0, 0]
        parts += [line(x, bottom, x, bottom + 4), text(x, bottom + 17, f"{tick:g}", "middle")]
    for c in curves:
        path = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in place(c.x, c.y))
        dash = ' stroke-dasharray="5 4"' if c.dashed else ""
        parts.append(f'<path d="{path}" fill="none" stroke="{c.colour}" stroke-width="1.5"{dash}/>')
    for m in marks:
        parts += _drawn(m, place)
    keys = [(m.name, m.colour, m.hollow) for m in marks] + [(c.name, c.colour, False) for c in curves]
    for i, (name, colour, hollow) in enumerate(keys):
        fill = "#ffffff" if hollow else colour
        at = f'x="{right + 12:.0f}" y="{top + 20 * i:.0f}" width="10" height="10"'
        parts.append(f'<rect {at} fill="{fill}" stroke="{colour}"/>')
        parts.append(text(right + 28, top + 20 * i + 10, name))
    parts += [text((left + right) / 2, height - 4, x_label, "middle"), text(4, 12, y_label)]
    return frame(width, height, parts, title)


def _drawn(m: Marks, place: Callable[[Array, Array], Array]) -> list[str]:
    known = np.isfinite(m.x) & np.isfinite(m.y)
    parts = []
    if m.sigma is not None:
        low, high = (place(m.x[known], m.y[known] + s * m.sigma[known]) for s in (-1, 1))
        parts += [line(a[0], a[1], b[0], b[1], m.colour, 1) for a, b in zip(low, high, strict=True)]
    fill = "#ffffff" if m.hollow else m.colour
    for x, y in place(m.x[known], m.y[known]):
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{fill}" stroke="{m.colour}" stroke-width="1.5"/>')
    return parts


def _ticks(values: Array) -> Array:
    """Four to eight round numbers that take in all values."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    span = max(high - low, 1e-9 * max(abs(high), 1.0)) or 1.0
    step = 10.0 ** np.floor(np.log10(span / 4))
    step *= next(k for k in (1, 2, 5, 10) if span / (k * step) <= 6)
    ticks: Array = np.arange(np.floor(low / step + 1e-9), np.ceil(high / step - 1e-9) + 1) * step
    return ticks if len(ticks) > 1 else np.array([ticks[0] - step, ticks[0] + step])


def bars(values: Sequence[tuple[str, float, str]], width: float, unit: str, title: str) -> str:
    """Horizontal bars: (name, value, colour)."""
    longest = max((value for _, value, _ in values), default=0.0) or 1.0
    left = max(230.0, 10 + 6.5 * max((len(name) for name, _, _ in values), default=0))
    parts = []
    for i, (name, value, colour) in enumerate(values):
        y = 20.0 * i
        length = (width - left - 100) * max(value, 0.0) / longest
        parts.append(text(0, y + 14, name))
        parts.append(f'<rect x="{left:.0f}" y="{y + 3:.0f}" width="{length:.1f}" height="13" fill="{colour}"/>')
        parts.append(text(left + 6 + length, y + 14, f"{value:.3g} {unit}"))
    return frame(width, 20.0 * len(values) + 4, parts, title)
