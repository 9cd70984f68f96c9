"""``leadline evaluate run``: a run's solutions against a truth that was measured otherwise, as numbers and pictures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from leadline.errors import InputError
from leadline.evaluation.accuracy import (
    SILENT_M,
    SILENT_SIGMAS,
    Availability,
    Row,
    availability,
    by_distance,
    by_stage,
    compare,
)
from leadline.evaluation.plot import Curve, Picture, plot_by_distance, plot_run
from leadline.files import write_whole
from leadline.samples import NS_PER_S, Solution, Status, Truth
from leadline.target import Target, parse_target
from leadline.wire.notice import Notice
from leadline.wire.solutions import read_solutions
from leadline.wire.truth import read_truth

METRICS, PICTURE, BY_DISTANCE = "metrics.json", "track.png", "errors.png"


@dataclass(frozen=True, slots=True)
class RunMetrics:
    """Tables of errors and of availability; ``own_point`` (paper's method only): D against its own point.

    longest_gap_s: without a valid solution, between the first and the last solution of known truth. ignored: rows of
    the truth that could not be read.
    """

    method: str
    target: str | None
    by_stage: list[Row]
    by_distance: list[Row]
    own_point: list[Row]
    availability: list[Availability]
    longest_gap_s: float
    ignored: list[str]
    files: list[Path]


def evaluate_run(run: Path, truth_file: Path, out: Path) -> RunMetrics:
    """Compare, and write ``metrics.json`` and two pictures. InputError where the two do not go together."""
    solutions_file = run / "solutions.csv" if run.is_dir() else run
    if not solutions_file.is_file():
        what = "no solutions.csv in it" if run.is_dir() else "no such run folder, nor table"
        raise InputError(what, str(run), "give a folder that `leadline run --out` wrote, or its solutions.csv")
    if not truth_file.is_file():
        raise InputError("no such file", str(truth_file), "give a CSV with the columns t_s,x_m,y_m,z_m,range_m")
    solutions = read_solutions(solutions_file)
    ignored: list[Notice] = []
    truth = read_truth(truth_file, ignored.append)
    about = _summary(solutions_file.parent)
    target = _target(about)
    _require(solutions, truth, solutions_file, truth_file)
    errors = compare(solutions, truth, target)
    method = str(about.get("method", "fused"))
    result = RunMetrics(
        method=method,
        target=None if target is None else target.name,
        by_stage=by_stage(errors),
        by_distance=by_distance(errors),
        own_point=by_stage(errors, own_point=True) if method == "paper" else [],
        availability=availability(solutions, truth),
        longest_gap_s=_longest_gap_s(solutions, truth),
        ignored=[str(notice) for notice in ignored],
        files=[out / name for name in (METRICS, PICTURE, BY_DISTANCE)],
    )
    write_whole(out / METRICS, json.dumps(_plain(result, run, truth_file), indent=1) + "\n")
    curve = Curve(method, solutions, errors, own_point=method == "paper")
    title = f"{run.resolve().name} · {result.target or 'target not stated'} · {method}"
    plot_run(out / PICTURE, Picture(title, curve, truth))
    plot_by_distance(out / BY_DISTANCE, curve, title)
    return result


def _summary(folder: Path) -> dict[str, Any]:
    """What the run says of itself; nothing where that is missing: solutions.csv alone is enough."""
    try:
        about = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return about if isinstance(about, dict) else {}


def _target(about: dict[str, Any]) -> Target | None:
    try:
        return parse_target(str(about.get("target", "")))
    except ValueError:
        return None


def _require(solutions: list[Solution], truth: list[Truth], solutions_file: Path, truth_file: Path) -> None:
    if not solutions:
        raise InputError("there are no solutions", str(solutions_file), "give a run that found something to solve")
    if not truth:
        raise InputError("there is no row that can be read", str(truth_file), "write t_s,x_m,y_m,z_m,range_m rows")
    if not availability(solutions, truth):
        what = f"the truth ({_span(truth)}) and the solutions ({_span(_ordered(solutions))}) have no time in common"
        raise InputError(what, str(truth_file), "give the truth of this dive, on its clock")


def _span(ordered: Sequence[Truth | Solution]) -> str:
    return f"{ordered[0].t_ns / NS_PER_S:.3f} to {ordered[-1].t_ns / NS_PER_S:.3f} s"


def _ordered(solutions: list[Solution]) -> list[Solution]:
    return sorted(solutions, key=lambda solution: solution.t_ns)


def _longest_gap_s(solutions: list[Solution], truth: list[Truth]) -> float:
    within = [s for s in _ordered(solutions) if truth[0].t_ns <= s.t_ns <= truth[-1].t_ns]
    if not within:
        return 0.0
    stamps = [within[0].t_ns, *(s.t_ns for s in within if s.status is Status.VALID), within[-1].t_ns]
    return max(after - before for before, after in pairwise(stamps)) / NS_PER_S


def _plain(result: RunMetrics, run: Path, truth: Path) -> dict[str, Any]:
    return {
        "run": str(run),
        "truth": str(truth),
        "silent_error": {"sigmas": SILENT_SIGMAS, "m": SILENT_M},
        **{name: value for name, value in asdict(result).items() if name != "files"},
    }
