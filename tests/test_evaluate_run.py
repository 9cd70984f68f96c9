"""`leadline evaluate run`: numbers that are known beforehand, and one line for every mistake."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from leadline.cli import main
from leadline.samples import NS_PER_S, Kind, Solution, Stage, Status, Truth
from leadline.sinks import SolutionsCsv
from leadline.wire.truth import write_truth

COUNT = 400
SIGMA_M = 0.004


def station(i: int) -> Truth:
    z = 2.2 - 2.0 * i / COUNT
    return Truth(i * NS_PER_S // 10, (0.0, 0.0, z), z)


def solved(i: int, error_m: np.ndarray, stated: float = 1.0) -> Solution:
    p = np.array(station(i).position_m) + error_m
    stage = Stage.BINOCULAR if i < COUNT // 2 else Stage.BOTH
    cov = np.eye(3) * (stated * SIGMA_M) ** 2
    return Solution(
        i * NS_PER_S // 10, stage, Status.VALID, p, cov, float(p[2]), stated * SIGMA_M, np.zeros(3), (Kind.STEREO,)
    )


def write_run(folder: Path, solutions: list[Solution], **about: str) -> Path:
    folder.mkdir()
    sink = SolutionsCsv(folder / "solutions.csv")
    for solution in solutions:
        sink.solution(solution)
    sink.close()
    (folder / "summary.json").write_text(json.dumps({"method": "fused", "target": "plane"} | about))
    return folder


@pytest.fixture
def dive(tmp_path: Path) -> tuple[Path, Path]:
    """A run with honest sigmas, a hole of 2 s, and its truth."""
    rng = np.random.default_rng(1)
    solutions = [solved(i, rng.normal(0, SIGMA_M, 3)) for i in range(COUNT)]
    for i in range(100, 120):
        solutions[i] = Solution(i * NS_PER_S // 10, Stage.SEARCHING, Status.LOST)
    solutions[300] = solved(300, np.array([0, 0, 0.05]))
    write_truth(tmp_path / "truth.csv", [station(i) for i in range(COUNT)])
    return write_run(tmp_path / "run", solutions), tmp_path / "truth.csv"


def test_numbers_tables_and_pictures(
    dive: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Bands of three sigma for the random ones; with half or twice the stated sigma they are missed by far."""
    out = tmp_path / "out"
    assert main(["evaluate", "run", str(dive[0]), "--truth", str(dive[1]), "--out", str(out)]) == 0
    metrics = json.loads((out / "metrics.json").read_text())
    row = metrics["by_stage"][-1]
    assert (row["name"], row["count"], row["silent"]) == ("all", COUNT - 20, 1)
    assert row["coverage"] == pytest.approx([0.683, 0.954, 0.997], abs=0.07)
    assert row["nees"] == pytest.approx(1 + 12.5**2 / 3 / 380, abs=3 * np.sqrt(2 / 3 / 380))
    assert sum(bin_["count"] for bin_ in metrics["by_distance"]) == COUNT - 20
    assert metrics["availability"][-1] == {"name": "all", "count": 400, "valid": 380, "coasting": 0, "lost": 20}
    assert metrics["longest_gap_s"] == pytest.approx(2.1)
    printed = capsys.readouterr().out
    assert "2 both" in printed
    assert "1.5-2.2 m" in printed
    for name in ("track.png", "errors.png"):
        assert (out / name).stat().st_size > 10_000
        assert str(out / name) in printed.replace("\n", "")


def test_the_papers_method_is_also_held_against_its_own_point(dive: tuple[Path, Path], tmp_path: Path) -> None:
    run = write_run(tmp_path / "paper", [solved(i, np.zeros(3)) for i in range(20)], method="paper")
    assert main(["evaluate", "run", str(run), "--truth", str(dive[1]), "--out", str(tmp_path / "out")]) == 0
    assert json.loads((tmp_path / "out" / "metrics.json").read_text())["own_point"]


def test_a_table_alone_is_enough(dive: tuple[Path, Path], tmp_path: Path) -> None:
    (dive[0] / "summary.json").unlink()
    table, out = str(dive[0] / "solutions.csv"), str(tmp_path / "out")
    assert main(["evaluate", "run", table, "--truth", str(dive[1]), "--out", out]) == 0


def test_lost_all_the_way_is_a_result(dive: tuple[Path, Path], tmp_path: Path) -> None:
    lost = [Solution(i * NS_PER_S // 10, Stage.SEARCHING, Status.LOST) for i in range(50)]
    run = write_run(tmp_path / "lost", lost)
    assert main(["evaluate", "run", str(run), "--truth", str(dive[1]), "--out", str(tmp_path / "out")]) == 0
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["by_stage"] == []
    assert metrics["longest_gap_s"] == pytest.approx(4.9)


TRUTH_HEAD = "t_s,x_m,y_m,z_m,range_m\n"


@pytest.mark.parametrize(
    ("truth", "said"),
    [
        (None, "truth.csv: no such file; give a CSV with the columns t_s,x_m"),
        ("", "the file is empty"),
        ("t_s,x_m,y_m,z_m\n0,0,0,1\n", "the header is"),
        (TRUTH_HEAD, "no row that can be read"),
        (TRUTH_HEAD + "a,0,0,1,1\n", "no row that can be read"),
        (TRUTH_HEAD + "900,0,0,1,1\n901,0,0,1,1\n", "no time in common"),
    ],
)
def test_a_truth_that_does_not_fit_is_one_line(
    dive: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], truth: str | None, said: str
) -> None:
    dive[1].unlink()
    if truth is not None:
        dive[1].write_text(truth)
    assert main(["evaluate", "run", str(dive[0]), "--truth", str(dive[1]), "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert told.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_run_that_is_none_is_one_line(
    dive: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty, bare = write_run(tmp_path / "empty", []), tmp_path / "bare"
    bare.mkdir()
    told = {
        tmp_path / "nowhere": "nowhere: no such run folder",
        empty: "no solutions",
        bare: "bare: no solutions.csv in it; give a folder that `leadline run --out` wrote",
    }
    for run, said in told.items():
        assert main(["evaluate", "run", str(run), "--truth", str(dive[1]), "--out", str(tmp_path / "out")]) == 2
        line = capsys.readouterr().err
        assert said in line
        assert line.count("\n") == 1
    beside = ["evaluate", "run", str(dive[0]), "--truth", str(dive[1]), "--out", str(dive[1])]
    assert main(beside) == 2
