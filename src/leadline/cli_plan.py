"""The command line of planning: `leadline plan`. Parses, calls, prints."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from leadline.errors import InputError

if TYPE_CHECKING:
    from leadline.evaluation.plan_report import Plan
    from leadline.evaluation.plan_rig import Drawing
    from leadline.rig import Rig

NUMBERS = 3  # of a place or a direction


def plan(
    rig: Annotated[str | None, typer.Argument(help="Rig file or a shipped rig; or draw one with the options.")] = None,
    target: Annotated[str, typer.Option(help="As in `leadline run`.")] = "sphere:0.34",
    out: Annotated[Path | None, typer.Option(help="Folder for plan.html, plan.svg and plan.json.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the numbers as JSON instead of tables.")] = False,
    at: Annotated[float, typer.Option(min=0.05, max=10, help="Distance, m, for which advice is given.")] = 2.2,
    baseline: Annotated[float | None, typer.Option(help="Of a rig to be drawn, metres.")] = None,
    focal: Annotated[float | None, typer.Option(help="Its lenses in air, pixels.")] = None,
    size: Annotated[str, typer.Option(help="Its images, WIDTHxHEIGHT.")] = "1920x1080",
    port: Annotated[float, typer.Option(help="From its pupils to the glass, metres; 0: in air, no port.")] = 0.01,
    glass: Annotated[float, typer.Option(help="Thickness of the glass, metres.")] = 0.002,
    laser: Annotated[str | None, typer.Option(help="Its laser's origin and direction: x,y,z[:dx,dy,dz].")] = None,
    laser_sigma: Annotated[float, typer.Option(help="Noise of its readings, metres.")] = 0.003,
    index: Annotated[float | None, typer.Option(help="Of the water; default: fresh at 20 C.")] = None,
    boards: Annotated[int, typer.Option(min=0, help="Of the calibration, in air and in water; 0: exact.")] = 25,
    noise: Annotated[float | None, typer.Option(help="Of the pictures, grey levels a pixel.")] = None,
    texture: Annotated[float | None, typer.Option(help="Of the target, grey levels a pixel.")] = None,
    attenuation: Annotated[float | None, typer.Option(help="Of the texture by water and lens, 1/m.")] = None,
    spot: Annotated[float | None, typer.Option(help="Noise of the spot's centre, pixels.")] = None,
    config: Annotated[Path | None, typer.Option(help="Settings (see `leadline config dump`).")] = None,
) -> None:
    """What accuracy will a rig have, where do its measurements hand over, and what would improve it most?"""
    from leadline.config import Config  # noqa: PLC0415  heavy imports wait until they are needed
    from leadline.evaluation.plan_report import make_plan  # noqa: PLC0415
    from leadline.evaluation.plan_sight import Conditions  # noqa: PLC0415
    from leadline.target import parse_target  # noqa: PLC0415

    drawn = None
    if baseline is not None or focal is not None:
        drawn = _drawing(baseline, focal, size, port, glass, index, laser, laser_sigma)
    given = {"noise_grey": noise, "texture_grey_px": texture, "attenuation_per_m": attenuation, "spot_px": spot}
    conditions = Conditions(**{name: _positive(name, value) for name, value in given.items() if value is not None})
    try:
        shape = parse_target(target)
    except ValueError as error:
        raise InputError(str(error), "--target") from error
    planned_rig, name = _rig(rig, drawn)
    settings = Config() if config is None else Config.load(config)
    try:
        result = make_plan(planned_rig, name, shape, conditions, settings, boards, at)
    except ValueError as error:
        raise InputError(str(error), name, "change the rig, or what is asked of it") from error
    if as_json:
        typer.echo(json.dumps(result.plain(), indent=1))
    else:
        _print(result)
    if out is not None:
        _write(result, out, quiet=as_json)


def _rig(source: str | None, drawn: Drawing | None) -> tuple[Rig, str]:
    from leadline.rig import Rig, shipped_rigs  # noqa: PLC0415

    if (source is None) == (drawn is None):
        shipped = ", ".join(shipped_rigs())
        raise InputError(
            "give a rig or draw one", "", f"a rig file, one of {shipped}, or --baseline and --focal with the rest"
        )
    if source is not None:
        return Rig.load(source), source
    assert drawn is not None
    try:
        return drawn.rig(), f"a drawing: baseline {drawn.baseline_m:g} m, {drawn.focal_px:g} px"
    except ValueError as error:
        raise InputError(str(error), "the drawn rig", "correct its options") from error


def _drawing(
    baseline: float | None,
    focal: float | None,
    size: str,
    port: float,
    glass: float,
    index: float | None,
    laser: str | None,
    laser_sigma: float,
) -> Drawing:
    from leadline.evaluation.plan_rig import Drawing  # noqa: PLC0415

    if baseline is None or focal is None:
        raise InputError("--baseline and --focal go together", "", "give both, or a rig file")
    width, by, height = size.lower().partition("x")
    if not (by and width.isdigit() and height.isdigit() and int(width) >= 64 and int(height) >= 64):
        raise InputError(f"{size!r} is not a size of images", "--size", "give WIDTHxHEIGHT, such as 1920x1080")
    origin, direction = (None, (0.0, 0.0, 1.0)) if laser is None else _laser(laser)
    return Drawing(
        baseline_m=_positive("--baseline", baseline),
        focal_px=_positive("--focal", focal),
        size=(int(width), int(height)),
        port_m=port if port > 0 else None,
        glass_m=glass,
        index=index,
        laser_origin_m=origin,
        laser_direction=direction,
        laser_sigma_m=_positive("--laser-sigma", laser_sigma),
    )


def _positive(name: str, value: float) -> float:
    if not 0 < value < float("inf"):
        raise InputError(f"{value:g} is not above 0", name)
    return value


Vector = tuple[float, float, float]


def _laser(given: str) -> tuple[Vector, Vector]:
    origin, colon, direction = given.partition(":")
    return _vector(origin), _vector(direction) if colon else (0.0, 0.0, 1.0)


def _vector(given: str) -> Vector:
    try:
        x, y, z = (float(part) for part in given.split(","))
    except ValueError:
        fix = "give x,y,z or x,y,z:dx,dy,dz, such as -0.039,0.088,0.02"
        raise InputError(f"{given!r} is not three numbers", "--laser", fix) from None
    return x, y, z


def _print(result: Plan) -> None:
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415

    from leadline.evaluation.plan_page import HEADS, by_place, values  # noqa: PLC0415
    from leadline.evaluation.plan_report import lines  # noqa: PLC0415

    console = Console(highlight=False)

    def show(title: str, heads: tuple[str, ...], rows: list[list[str]]) -> None:
        table = Table(title=title, title_justify="left", box=None, padding=(0, 1, 0, 0))
        for head in heads:
            table.add_column(head, justify="right", no_wrap=True)
        for row in rows:
            table.add_row(*row)
        console.print(table)

    heads = tuple(head.replace(" ", "\n") for head in HEADS)
    rows = [[f"{cell.distance_m:g}", *values(result, cell)] for cell in result.aimed()]
    show(f"{result.name}, {result.target}: sigma of the range, mm", ("m", *heads), rows)
    show("over the field of view: one frame alone / filtered, mm", *by_place(result))
    for line in (*lines(result), *(f"assumed: {one}" for one in result.assumptions)):
        typer.echo(line)


def _write(result: Plan, out: Path, *, quiet: bool) -> None:
    from leadline.evaluation.plan_page import write  # noqa: PLC0415

    for file in write(out, result):
        if not quiet:
            typer.echo(str(file))
