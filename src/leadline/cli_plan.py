"""The command line of planning: `leadline plan`. Parses, calls, prints."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from leadline.errors import InputError

if TYPE_CHECKING:
    from leadline.evaluation.plan_report import Plan
    from leadline.evaluation.plan_rig import Drawing
    from leadline.rig import Rig

Vector = tuple[float, float, float]

RANGES = {  # beyond them a plan says nothing, or nobody can mean it: millimetres for metres, a slip of the point
    "--at": (0.05, 10.0, " m"),
    "--baseline": (0.005, 9.0, " m"),
    "--port": (0.0, 1.0, " m (0: in air)"),
    "--glass": (0.0, 0.1, " m"),
    "--index": (1.3, 1.5, " (water: 1.33 to 1.35)"),
    "--laser-sigma": (1e-5, 1.0, " m"),
    "--noise": (0.01, 100.0, " grey levels"),
    "--texture": (0.01, 100.0, " grey levels a pixel"),
    "--attenuation": (0.0, 10.0, " 1/m"),
    "--spot": (0.001, 10.0, " px"),
}
CONDITIONS = {
    "noise_grey": "--noise",
    "texture_grey_px": "--texture",
    "attenuation_per_m": "--attenuation",
    "spot_px": "--spot",
}
FOCAL_WIDTHS = (0.2, 20.0)  # of the images: fields of view of 136 and of 3 degrees
SIDE_PX = (64, 20000)
FARTHEST_M = 10.0  # of a laser from the camera
AHEAD: Vector = (0.0, 0.0, 1.0)


def plan(
    rig: Annotated[str | None, typer.Argument(help="Rig file or a shipped rig; or draw one with the options.")] = None,
    target: Annotated[str, typer.Option(help="As in `leadline run`.")] = "sphere:0.34",
    out: Annotated[Path | None, typer.Option(help="Folder for plan.html, plan.svg and plan.json.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the numbers as JSON instead of tables.")] = False,
    at: Annotated[float, typer.Option(help="Distance, m, for which advice is given.")] = 2.2,
    baseline: Annotated[float | None, typer.Option(help="Of a rig to be drawn, metres.")] = None,
    focal: Annotated[float | None, typer.Option(help="Its lenses in air, pixels.")] = None,
    size: Annotated[str | None, typer.Option(help="Its images, WIDTHxHEIGHT; 1920x1080.")] = None,
    port: Annotated[float | None, typer.Option(help="From its pupils to the glass, metres; 0.01; 0: in air.")] = None,
    glass: Annotated[float | None, typer.Option(help="Thickness of the glass, metres; 0.002.")] = None,
    laser: Annotated[str | None, typer.Option(help="Its laser's origin and direction: x,y,z[:dx,dy,dz].")] = None,
    laser_sigma: Annotated[float | None, typer.Option(help="Noise of its readings, metres; 0.003.")] = None,
    index: Annotated[float | None, typer.Option(help="Of the water around it; fresh at 20 C.")] = None,
    boards: Annotated[int, typer.Option(min=0, max=1000, help="Of the calibration, in air and in water; 0: exact.")] = (
        25
    ),
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
    from leadline.rig import Rig  # noqa: PLC0415
    from leadline.target import parse_target  # noqa: PLC0415

    at = _within("--at", at)
    given = {"noise_grey": noise, "texture_grey_px": texture, "attenuation_per_m": attenuation, "spot_px": spot}
    conditions = Conditions(
        **{name: _within(CONDITIONS[name], value) for name, value in given.items() if value is not None}
    )
    try:
        shape = parse_target(target)
    except ValueError as error:
        raise InputError(str(error), "--target") from error
    if rig is None:
        planned_rig, name = _drawn(_drawing(baseline, focal, size, port, glass, index, laser, laser_sigma))
    else:
        numbers = {"--baseline": baseline, "--focal": focal, "--port": port, "--glass": glass, "--index": index}
        _refuse(rig, numbers | {"--size": size, "--laser": laser, "--laser-sigma": laser_sigma})
        planned_rig, name = Rig.load(rig), rig
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


def _refuse(rig: str, given: Mapping[str, object]) -> None:
    """A rig is planned as it is: an option that would draw one must not be taken for a change of it."""
    options = ", ".join(option for option, value in given.items() if value is not None)
    if options:
        fix = f"leave that out: {rig} is planned as its file says, its water too; or give a changed copy of the file"
        raise InputError("give a rig or draw one, not both", options, fix)


def _drawn(drawing: Drawing) -> tuple[Rig, str]:
    try:
        return drawing.rig(), f"a drawing: baseline {drawing.baseline_m:g} m, {drawing.focal_px:g} px"
    except ValueError as error:
        raise InputError(str(error), "the drawn rig", "correct its options") from error


def _drawing(
    baseline: float | None,
    focal: float | None,
    size: str | None,
    port: float | None,
    glass: float | None,
    index: float | None,
    laser: str | None,
    laser_sigma: float | None,
) -> Drawing:
    from leadline.evaluation.plan_rig import Drawing  # noqa: PLC0415
    from leadline.rig import shipped_rigs  # noqa: PLC0415

    if baseline is None and focal is None:
        fix = f"a rig file, one of {', '.join(shipped_rigs())}, or --baseline and --focal with the rest"
        raise InputError("give a rig or draw one", fix=fix)
    if baseline is None or focal is None:
        raise InputError("--baseline and --focal go together", fix="give both, or a rig file")
    width, height = _size(size or "1920x1080")
    least, most = (share * width for share in FOCAL_WIDTHS)
    if not least <= focal <= most:
        fix = f"give {least:g} to {most:g}: {FOCAL_WIDTHS[0]:g} to {FOCAL_WIDTHS[1]:g} times the images' width"
        raise InputError(f"{focal:g} px is no lens before images {width} px wide", "--focal", fix)
    for option, value in (("--index", index), ("--glass", glass)):
        if port == 0 and value is not None:
            raise InputError("a rig in air (--port 0) has none", option, "leave it out, or give a --port above 0")
    if laser is None and laser_sigma is not None:
        raise InputError("there is no laser", "--laser-sigma", "give --laser, too, or leave it out")
    origin, direction = (None, AHEAD) if laser is None else _laser(laser)
    usual = Drawing(_within("--baseline", baseline), focal, (width, height))
    return replace(
        usual,
        port_m=usual.port_m if port is None else _within("--port", port) or None,
        glass_m=usual.glass_m if glass is None else _within("--glass", glass),
        index=None if index is None else _within("--index", index),
        laser_origin_m=origin,
        laser_direction=direction,
        laser_sigma_m=usual.laser_sigma_m if laser_sigma is None else _within("--laser-sigma", laser_sigma),
    )


def _size(given: str) -> tuple[int, int]:
    width, by, height = given.lower().partition("x")
    low, high = SIDE_PX
    if not (by and all(side.isdecimal() and low <= int(side) <= high for side in (width, height))):
        fix = f"give WIDTHxHEIGHT, such as 1920x1080, each from {low} to {high}"
        raise InputError(f"{given!r} is not a size of images", "--size", fix)
    return int(width), int(height)


def _within(option: str, value: float) -> float:
    """A number that there can be; NaN is none."""
    low, high, unit = RANGES[option]
    if not low <= value <= high:
        raise InputError(f"{value:g} is not from {low:g} to {high:g}{unit}", option, "give a number in this range")
    return value


def _laser(given: str) -> tuple[Vector, Vector]:
    origin, colon, direction = given.partition(":")
    x, y, z = _vector(direction) if colon else AHEAD
    if not z > 0:
        raise InputError(f"a beam along {x:g},{y:g},{z:g} does not go ahead", "--laser", "the third number is above 0")
    return _vector(origin), (x, y, z)


def _vector(given: str) -> Vector:
    try:
        x, y, z = (float(part) for part in given.split(","))
        if not max(abs(x), abs(y), abs(z)) <= FARTHEST_M:
            raise ValueError
    except ValueError:
        fix = "give x,y,z or x,y,z:dx,dy,dz, metres, such as -0.039,0.088,0.02"
        raise InputError(f"{given!r} is not three numbers of {FARTHEST_M:g} at most", "--laser", fix) from None
    return x, y, z


def _print(result: Plan) -> None:
    from rich.table import Table  # noqa: PLC0415

    from leadline.cli_console import open_console  # noqa: PLC0415
    from leadline.evaluation.plan_page import HEADS, by_place, values  # noqa: PLC0415
    from leadline.evaluation.plan_report import lines  # noqa: PLC0415

    console = open_console()

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
