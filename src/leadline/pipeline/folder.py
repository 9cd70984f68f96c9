"""A run's folder: what is in it, and when an existing folder may be taken."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count
from pathlib import Path

from leadline import files
from leadline.errors import InputError

SOLUTIONS, CONFIG, RIG, SUMMARY, PICTURE, RECORDING, SMOOTHED, EVENTS = (
    "solutions.csv", "config.yaml", "rig.yaml", "summary.json", "run.png", "dive.mcap", "smoothed.csv", "events.csv"
)  # fmt: skip


def solutions_name(method: str) -> str:
    """The table of a method that runs beside the main one."""
    return f"solutions_{method}.csv"


OURS = (SOLUTIONS, SMOOTHED, solutions_name("paper"), EVENTS, CONFIG, RIG, SUMMARY, PICTURE)


def written(out: Path, recordings: Sequence[Path] = ()) -> list[Path]:
    """What stands there of a run, by now."""
    return [path for path in (*(out / name for name in OURS), *recordings) if path.exists()]


def free_recording(out: Path) -> Path:
    """``dive.mcap``, ``dive_2.mcap``, ...: the first that does not exist yet."""
    names = (RECORDING if number == 1 else f"dive_{number}.mcap" for number in count(1))
    return next(out / name for name in names if not (out / name).exists())


def keep_recording(out: Path) -> Path | None:
    """Give an earlier run's ``dive.mcap`` the next free name, which is returned: it may be all there is of a dive.

    None where there is none. InputError where it cannot be moved.
    """
    earlier = out / RECORDING
    if not earlier.exists():
        return None
    kept = free_recording(out)
    try:
        return earlier.rename(kept)
    except OSError as error:
        what = f"cannot be moved to {kept.name} ({error.strerror})"
        raise InputError(what, str(earlier), "give another folder to --out") from error


def check_folder(out: Path, source: str) -> None:
    """InputError unless ``out`` is new, empty, or holds an earlier run (its files are then replaced, others stay).

    Never the folder of the source itself.
    """
    if Path(source).exists() and (
        Path(source).resolve() == out.resolve() or Path(source).resolve().parent == out.resolve()
    ):
        raise InputError("this is where the source is", str(out), "give another folder to --out")
    if out.exists() and not out.is_dir():
        raise InputError("this is a file", str(out), "give a folder to --out")
    if out.is_dir() and any(out.iterdir()) and not (out / SOLUTIONS).is_file():
        raise InputError("this folder holds something that is not a run", str(out), "give a new folder to --out")


def make_folder(out: Path) -> None:
    """Make the folder and take an earlier run's files out of it, so that no files of two runs stand side by side.

    Its recordings stay.
    """
    files.make_folder(out, without=OURS)
