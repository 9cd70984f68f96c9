"""Where samples come from: a dive folder, a recording, a simulation, live devices."""

from __future__ import annotations

from pathlib import Path

from leadline.errors import InputError
from leadline.sources.base import Source, frame_size, require_size
from leadline.wire.notice import Notice, NoticeKind, count_notices

__all__ = ["Notice", "NoticeKind", "Source", "count_notices", "frame_size", "open_source", "require_size"]

LIVE = "live:"  # before a dive: as a live device gives it
_WANTED = "give a dive folder, an .mcap file, sim:SCENARIO or a live source (uvc:0+serial:/dev/ttyUSB0)"


def open_source(spec: str | Path, *, seed: int = 0, real_time: bool = False) -> Source:
    """A dive folder, an ``.mcap`` recording, ``sim:SCENARIO`` or live devices as a source of samples as they arrive.

    ``seed`` is the simulation's; with ``real_time`` samples come at their own pace, else as fast as they are taken.
    ``live:`` before a dive gives it as devices would: its frames do not wait for whoever is too slow for them.
    Raises InputError where there is no such dive or nothing in it can be read.
    """
    text = str(spec)
    if text.startswith("sim:"):
        from leadline.sources.simulated import SimulatedSource  # noqa: PLC0415  the renderer is not needed for a replay

        return SimulatedSource(text.removeprefix("sim:"), seed=seed, real_time=real_time)
    if text.startswith((LIVE, "uvc:", "rtsp:", "serial:", "mavlink:", "ros2:")):
        return _open_live(text, seed)
    path = _recording_inside(Path(spec))
    if path.is_dir():
        from leadline.sources.folder import FolderSource  # noqa: PLC0415

        return FolderSource(path, real_time=real_time)
    if path.suffix == ".mcap" and path.is_file():
        from leadline.sources.mcap import McapSource  # noqa: PLC0415

        return McapSource(path, real_time=real_time)
    raise InputError("not a dive" if path.exists() else "no such file or folder", text, _WANTED)


def _open_live(text: str, seed: int) -> Source:
    from leadline.sources.address import joined, makers, rig_of  # noqa: PLC0415  devices are not needed for a replay
    from leadline.sources.clock import LiveClock  # noqa: PLC0415
    from leadline.sources.live import LiveSource  # noqa: PLC0415
    from leadline.sources.mavlink import Mount  # noqa: PLC0415
    from leadline.sources.replay import live_dive  # noqa: PLC0415

    if text.startswith(LIVE):
        if len(joined(text)) > 1:
            raise InputError("live: stands alone, its dive has its own devices", text, "leave out what + joins to it")
        return live_dive(open_source(text.removeprefix(LIVE), seed=seed))
    clock, mount = LiveClock(), Mount()
    source = LiveSource(text, makers(text, clock, mount), clock, mount=mount)
    source.rig = rig_of(text)
    return source


def _recording_inside(path: Path) -> Path:
    """A ROS 2 bag is a folder with one ``.mcap`` in it; so is a run's folder made with ``--record`` once."""
    if not path.is_dir() or (path / "frames.csv").exists():
        return path
    inside = sorted(path.glob("*.mcap"))
    if len(inside) > 1:
        raise InputError(f"there are {len(inside)} recordings in it", str(path), f"name one of them: {inside[0]}")
    return inside[0] if inside else path
