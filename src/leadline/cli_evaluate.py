"""The command line of evaluation: `leadline evaluate ...`. Parses, calls, prints."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from leadline.evaluation.run_metrics import RunMetrics

app = typer.Typer(no_args_is_help=True, help="How good was it? Against a truth that was measured otherwise.")


@app.callback()
def _group() -> None:
    """Commands by name, though there be only one."""


@app.command("run")
def run(
    source: Annotated[Path, typer.Argument(metavar="RUN", help="A run's folder, or one of its tables.")],
    truth: Annotated[Path, typer.Option(help="CSV with the columns t_s,x_m,y_m,z_m,range_m.")],
    out: Annotated[Path, typer.Option(help="Folder for metrics.json and the pictures.")],
) -> None:
    """A run's errors by stage and by distance, whether its sigma was honest, and how often it had an answer."""
    from rich.console import Console  # noqa: PLC0415  heavy imports wait until they are needed

    from leadline.cli_tables import error_table  # noqa: PLC0415
    from leadline.evaluation.run_metrics import evaluate_run  # noqa: PLC0415

    result = evaluate_run(source, truth, out)
    console = Console(highlight=False)
    for line in result.ignored[:1]:
        typer.echo(f"{len(result.ignored)} rows of the truth ignored, the first: {line}")
    if result.own_point:
        console.print(error_table("D against its own point of the surface, mm", result.own_point))
    if result.by_stage:
        console.print(error_table("range against the nearest surface, by stage, mm", result.by_stage))
        console.print(error_table("range against the nearest surface, by distance, mm", result.by_distance, "distance"))
    console.print(_availability(result))
    for file in result.files:
        typer.echo(str(file))


def _availability(result: RunMetrics) -> Table:
    from rich.table import Table  # noqa: PLC0415

    title = f"availability; longest time without a valid solution {result.longest_gap_s:.2f} s"
    table = Table(title=title, title_justify="left", box=None, padding=(0, 1, 0, 0))
    table.add_column("distance", no_wrap=True)
    for name in ("solutions", "valid", "coasting", "lost"):
        table.add_column(name, justify="right")
    for row in result.availability:
        shares = [f"{count / row.count:.0%}" for count in (row.valid, row.coasting, row.lost)]
        table.add_row(row.name, str(row.count), *shares)
    return table
