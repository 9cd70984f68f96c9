"""The command line: parses, calls, prints. Exit status 0 done, 1 the job failed, 2 the call or a file is wrong."""

from __future__ import annotations

import errno
import sys
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from leadline import (
    cli_calibrate,
    cli_capture,
    cli_dataset,
    cli_doctor,
    cli_evaluate,
    cli_plan,
    cli_rangefinder,
    cli_recover,
    cli_train,
)
from leadline.cli_console import open_console
from leadline.cli_progress import progress
from leadline.cli_view import ViewAt, ViewFlag, watched_run
from leadline.errors import InputError

if TYPE_CHECKING:
    from leadline.config import Config
    from leadline.pipeline.loop import Report

# Typer carries its own click in newer versions: the base of its errors is found, not imported.
UsageProblem: type[Exception] = next(base for base in typer.BadParameter.__mro__ if base.__name__ == "ClickException")

app = typer.Typer(
    name="leadline",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Underwater ranging of large, close targets with a stereo camera behind a flat port and a laser rangefinder.",
)
config_app = typer.Typer(no_args_is_help=True, help="The settings of a run.")
app.add_typer(config_app, name="config")
app.add_typer(cli_calibrate.app, name="calibrate")
app.add_typer(cli_evaluate.app, name="evaluate")

DISK_TROUBLES = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO)


class MethodName(StrEnum):
    FUSED = "fused"
    PAPER = "paper"


class ProviderName(StrEnum):
    CPU = "cpu"
    CUDA = "cuda"
    TENSORRT = "tensorrt"
    OPENVINO = "openvino"


class ImageFormat(StrEnum):
    PNG = "png"
    JPEG = "jpeg"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; its exit status. A user's mistake is one line on stderr, a bug a traceback."""
    try:
        command = typer.main.get_command(app)
        status = command.main(
            None if arguments is None else list(arguments), prog_name="leadline", standalone_mode=False
        )
    except InputError as error:
        return _complain(str(error))
    except UsageProblem as error:
        if type(error).__name__ == "NoArgsIsHelpError":
            sys.stderr.write(f"{error}\n")
            return 2
        return _complain(f"{error.format_message()} (see --help)")  # type: ignore[attr-defined]
    except OSError as error:
        if error.errno not in DISK_TROUBLES:
            raise
        return _complain(f"{error.filename or 'the disk'}: {error.strerror}; what was written until then is kept", 1)
    except (KeyboardInterrupt, typer.Abort):
        return _complain("interrupted", 1)
    return status if isinstance(status, int) else 0


def _complain(line: str, status: int = 2) -> int:
    sys.stderr.write(f"leadline: {' '.join(line.split())}\n")
    return status


def _version(wanted: bool) -> None:
    if wanted:
        from leadline import __version__  # noqa: PLC0415

        typer.echo(f"leadline {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    pass


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for what the demo writes.")] = Path("out/demo"),
    seed: Annotated[int, typer.Option(min=0, help="Of the simulation.")] = 0,
    headless: Annotated[bool, typer.Option("--headless", help="Never open a window or a browser.")] = False,
    view: ViewFlag = False,
    view_at: ViewAt = None,
) -> None:
    """A simulated dive through the whole chain, ours beside the paper's method. Needs nothing."""
    from leadline.cli_tables import beside  # noqa: PLC0415  heavy imports wait until a command needs them
    from leadline.pipeline.demo import demo_job  # noqa: PLC0415

    what = "simulating and locating"
    job = demo_job(seed=seed, real_time=view or view_at is not None)
    with watched_run(job, out, what, record=False, view=view, at=view_at, headless=headless) as report:
        _print_report(report, detailed=False)
        open_console().print(beside(report.errors["fused"], report.errors["paper"]))
        _print_files(report)


@app.command()
def run(
    source: Annotated[
        str, typer.Argument(help="A dive folder, an .mcap, sim:SCENARIO or live devices (docs/live.md).")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the solutions.")],
    rig: Annotated[str | None, typer.Option(help="Rig file or a shipped rig; default: the source's own.")] = None,
    target: Annotated[
        str | None, typer.Option(help="sphere[:DIAMETER], plane, cylinder[:DIAMETER] or surface (diameter in metres).")
    ] = None,
    model: Annotated[Path | None, typer.Option(help="Detector (ONNX); default: the shipped one for balls.")] = None,
    method: Annotated[MethodName, typer.Option(help="Ours, or the paper's own chain.")] = MethodName.FUSED,
    boxes: Annotated[Path | None, typer.Option(help="Detections (COCO results) instead of a model.")] = None,
    water_state: Annotated[
        str | None, typer.Option(help="salinity=PSU,temperature=C,depth=M; default: the rig's water.")
    ] = None,
    no_filter: Annotated[bool, typer.Option("--no-filter", help="Take every frame alone.")] = False,
    smooth: Annotated[
        bool,
        typer.Option("--smooth", help="Also write smoothed.csv: each solution from all that came before and after."),
    ] = False,
    record: Annotated[bool, typer.Option("--record", help="Also write dive.mcap.")] = False,
    headless: Annotated[bool, typer.Option("--headless", help="Never open a window or a browser.")] = False,
    view: ViewFlag = False,
    view_at: ViewAt = None,
    real_time: Annotated[bool, typer.Option("--real-time", help="At the dive's own pace.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of a simulation.")] = 0,
    mavlink: Annotated[
        str | None, typer.Option(metavar="URL", help="Tell an autopilot: udpout:HOST:PORT or /dev/ttyACM0?baud=115200.")
    ] = None,
    ros2: Annotated[
        bool, typer.Option("--ros2", help="Also publish the results as ROS 2 topics (docs/ros2.md).")
    ] = False,
    provider: Annotated[ProviderName | None, typer.Option(help="What the detector runs on; default: cpu.")] = None,
    config: Annotated[Path | None, typer.Option(help="Settings (see `leadline config dump`).")] = None,
) -> None:
    """Locate the target in a dive: solutions.csv, a summary and a picture."""
    from leadline.pipeline import build_job  # noqa: PLC0415

    job = build_job(
        source,
        rig_file=rig,
        target=target,
        methods=(method.value,),
        model=model,
        boxes=boxes,
        config=_config(config, provider),
        water_state=water_state,
        filtered=not no_filter,
        smoothed=smooth,
        real_time=real_time or view or view_at is not None,
        seed=seed,
        mavlink=mavlink,
        ros2=ros2,
    )
    with watched_run(job, out, "locating", record=record, view=view, at=view_at, headless=headless) as report:
        _print_report(report, detailed=True)
        _print_files(report)


@app.command()
def sim(
    scenario: Annotated[str, typer.Argument(help="A shipped scenario's name or a YAML file.")],
    out: Annotated[Path, typer.Option(help="New folder for the dive.")],
    seed: Annotated[int, typer.Option(min=0)] = 0,
    images: Annotated[ImageFormat, typer.Option(help="Lossless PNG, or smaller JPEG.")] = ImageFormat.PNG,
) -> None:
    """Write a simulated dive with its truth."""
    from leadline.pipeline.simulate import write_simulated_dive  # noqa: PLC0415

    with progress("rendering") as tick:
        frames = write_simulated_dive(scenario, out, seed=seed, images=images.value, progress=tick)
    typer.echo(f"{frames} frames: {out}")


@app.command()
def detect(
    source: Annotated[Path, typer.Argument(metavar="INPUT", help="An image, a folder, a dive or a video.")],
    out: Annotated[Path, typer.Option(help="Folder for detections.json and the drawn images.")],
    model: Annotated[Path | None, typer.Option(help="Detector (ONNX); default: the shipped one for balls.")] = None,
    provider: Annotated[ProviderName | None, typer.Option(help="What the detector runs on; default: cpu.")] = None,
    config: Annotated[Path | None, typer.Option(help="Settings (see `leadline config dump`).")] = None,
) -> None:
    """Find targets in images: detections.json (COCO results) and drawn images."""
    from leadline.evaluation.detect import detect_images  # noqa: PLC0415
    from leadline.recognition.detector import Detector  # noqa: PLC0415

    detector = Detector(model, **_config(config, provider).detector.model_dump())
    with progress("detecting") as tick:
        report = detect_images(source, out, detector, tick)
    typer.echo(f"{report.detections} targets in {report.with_target} of {report.images} images: {report.results}")
    if report.skipped:
        name, why = report.skipped[0]
        typer.echo(f"{len(report.skipped)} skipped, the first: {name}: {why}")


@config_app.command()
def dump() -> None:
    """Print all settings with their defaults, as a file for --config."""
    from leadline.config import Config  # noqa: PLC0415

    typer.echo(Config().dump(), nl=False)


@config_app.command()
def check(file: Annotated[Path, typer.Argument(help="Settings to look through.")]) -> None:
    """Say whether a settings file is good."""
    _config(file)
    typer.echo(f"{file}: good")


def _config(file: Path | None, provider: ProviderName | None = None) -> Config:
    from leadline.config import Config  # noqa: PLC0415

    config = Config() if file is None else Config.load(file)
    if provider is None:
        return config
    return config.model_copy(update={"detector": config.detector.model_copy(update={"provider": provider.value})})


def _print_report(report: Report, *, detailed: bool) -> None:
    from leadline.cli_tables import remarks, tables  # noqa: PLC0415

    console = open_console()
    for line in remarks(report.summary):
        console.print(line)
    if detailed:
        for table in tables(report):
            console.print(table)


def _print_files(report: Report) -> None:
    for file in report.files:
        typer.echo(str(file))
    for line in report.summary["unfinished"]:
        _complain(line)


for _command in (
    cli_calibrate.board,
    cli_plan.plan,
    cli_capture.capture,
    cli_dataset.dataset,
    cli_train.train,
    cli_doctor.doctor,
    cli_recover.recover,
    cli_rangefinder.rangefinder,
):  # after those of this file, so that `--help` begins with what is used most
    app.command()(_command)
