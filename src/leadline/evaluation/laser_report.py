"""One page for a laser's calibration: what was said of it, charts (``laser_charts``), tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template

from leadline.files import write_whole

_TEMPLATE = Path(__file__).with_name("calibration_report.html")
_GREEN = "#2a7d4f"

Table = tuple[str, tuple[str, ...], Sequence[tuple[str, ...]]]
"""Title, heads, rows."""


@dataclass(frozen=True, slots=True)
class Figure:
    """A drawing (SVG) with its title and how to read it."""

    title: str
    drawing: str
    note: str


def write_laser_page(
    path: Path,
    title: str,
    lines: Sequence[str],
    tables: Sequence[Table],
    figures: Sequence[Figure],
    next_action: str,
) -> None:
    """Write the page, whole or not at all. InputError where the folder cannot be written."""
    page = Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        title=escape(title),
        subtitle="",
        colour=_GREEN,
        verdict=escape(lines[0]),
        doubts="<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines[1:]) + "</ul>" if lines[1:] else "",
        next_action=escape(next_action),
        sections="\n".join([*(_figure(f) for f in figures), *(_table(*table) for table in tables)]),
    )
    write_whole(path, page)


def _figure(figure: Figure) -> str:
    return f'<h2>{escape(figure.title)}</h2><p class="note">{escape(figure.note)}</p>{figure.drawing}'


def _table(title: str, heads: Sequence[str], rows: Sequence[tuple[str, ...]]) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in heads)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<h2>{escape(title)}</h2><table><tr>{head}</tr>{body}</table>"
