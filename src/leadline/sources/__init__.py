"""Where samples come from: a dive folder, a recording, a simulation."""

from __future__ import annotations

from pathlib import Path

from leadline.errors import InputError
from leadline.sources.base import Source, frame_size, require_size
from leadline.wire.notice import Notice, NoticeKind, count_notices

__all__ = ["Notice", "NoticeKind", "Source", "count_notices", "frame_size", "open_source", "require_size"]

_LIVE = ("uvc:", "serial:", "ros2:")


def open_source(spec: str | Path, *, seed: int = 0, real_time: bool = False) -> Source:
    """A dive folder, an ``.mcap`` recording or ``sim:SCENARIO`` as a source of samples in arrival order.

    ``seed`` is the simulation's; with ``real_time`` samples come at their own pace, else as fast as they are taken.
    Raises InputError where there is no such dive or nothing in it can be read.
    """
    text = str(spec)
    if text.startswith("sim:"):
        from leadline.sources.simulated import SimulatedSource  # noqa: PLC0415  the renderer is not needed for a replay

        return SimulatedSource(text.removeprefix("sim:"), seed=seed, real_time=real_time)
    if text.startswith(_LIVE):
        raise InputError(
            "live sources come with live operation", text, "use a dive folder, an .mcap file or sim:SCENARIO"
        )
    path = _recording_inside(Path(spec))
    if path.is_dir():
        from leadline.sources.folder import FolderSource  # noqa: PLC0415

        return FolderSource(path, real_time=real_time)
    if path.suffix == ".mcap" and path.is_file():
        from leadline.sources.mcap import McapSource  # noqa: PLC0415

        return McapSource(path, real_time=real_time)
    what = "not a dive folder, an .mcap file or sim:SCENARIO" if path.exists() else "no such file or folder"
    raise InputError(what, text, "give a dive folder, an .mcap file or sim:SCENARIO")


def _recording_inside(path: Path) -> Path:
    """A ROS 2 bag is a folder with one ``.mcap`` in it; so is a run's folder made with ``--record``."""
    if path.is_dir() and not (path / "frames.csv").exists():
        inside = list(path.glob("*.mcap"))
        return inside[0] if len(inside) == 1 else path
    return path
