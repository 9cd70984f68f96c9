"""What a recording survives: kill -9, cuts, flipped bits, a full disk; and what a power cut may cost."""

from __future__ import annotations

import os
import random
import resource
import signal
import subprocess
import sys
import time
from bisect import bisect_right
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from rosbags.highlevel import AnyReader

from leadline.cli import main
from leadline.errors import InputError
from leadline.health import Health, Part, State
from leadline.pipeline.watch import Outlet
from leadline.rig import Rig
from leadline.samples import NS_PER_S, Detection, LaserRange, Sample, Solution, Stage, Status, StereoFrame
from leadline.sinks import McapSink, SolutionsCsv
from leadline.sources import open_source
from leadline.wire import mcap_records, spool
from leadline.wire.recording import RecordingReader, recover
from leadline.wire.ros2_definitions import DIAGNOSTICS, LEFT_IMAGE
from leadline.wire.solutions import read_solutions
from wire_helpers import picture, same

FPS = 15
LOST_AT_MOST_NS = NS_PER_S
FARM = Path(__file__).with_name("recorder_farm.py")


def dive(seconds: float = 4.0) -> list[Sample]:
    """Frames at 15 a second, readings at 3."""
    samples: list[Sample] = []
    for i in range(int(seconds * FPS)):
        t_ns = i * NS_PER_S // FPS
        if i % 5 == 0:
            samples.append(LaserRange(t_ns, 2.0 + i))
        samples.append(StereoFrame(t_ns, picture(i, (32, 24)), picture(i + 500, (32, 24))))
    return samples


def feed(sink: McapSink, samples: list[Sample]) -> None:
    for sample in samples:
        sink.sample(sample)
        if isinstance(sample, StereoFrame):
            sink.detections(sample, [Detection((1.0, 2.0, 3.0, 4.0), 0.5)])
            sink.solution(Solution(sample.t_ns, Stage.SEARCHING, Status.LOST))


def feed_one(sink: McapSink, sample: Sample) -> None:
    sink.sample(sample)
    sink._writer.flush()  # readings would wait for more


def recorded(path: Path, samples: list[Sample]) -> bytes:
    sink = McapSink(path, Rig.load("rendered"))
    feed(sink, samples)
    sink.close()
    return path.read_bytes()


def opens_in_rosbags(path: Path) -> int:
    """Messages, each deserialised."""
    with AnyReader([path]) as reader:
        messages = [reader.deserialize(data, one.msgtype) for one, _, data in reader.messages()]
        assert len(messages) == reader.message_count
    return len(messages)


# -- kill -9 -----------------------------------------------------------------------------------------------------------


class Death(NamedTuple):
    lost_s: float  # last sample that the recorder was given, less the last recovered
    before_death_s: float  # the same against the clock, at the moment of the kill


def kills(folder: Path, moments_s: list[float]) -> Iterator[Death]:
    with subprocess.Popen([sys.executable, str(FARM)], stdin=-1, stdout=-1, text=True) as farm:
        assert farm.stdin is not None
        assert farm.stdout is not None
        for number, moment_s in enumerate(moments_s):
            path = folder / f"{number}.mcap"
            farm.stdin.write(f"{path}\n")
            farm.stdin.flush()
            child = int(farm.stdout.readline())
            stamp = Path(f"{path}.stamp")
            while not (stamp.exists() and stamp.stat().st_size):  # it has begun
                time.sleep(0.01)
            time.sleep(moment_s)
            os.kill(child, signal.SIGKILL)
            died_ns = time.time_ns()
            yield death(path, int.from_bytes(stamp.read_bytes(), "little"), died_ns)
        farm.stdin.close()


def death(path: Path, given_ns: int, died_ns: int) -> Death:
    out = path.with_suffix(".recovered.mcap")
    try:
        recovery = recover(path, out)
    except InputError:
        assert not out.exists()
        return Death(0.0, 0.0)  # nothing was written yet: it must have been killed in its first second
    assert opens_in_rosbags(out) == sum(recovery.counts.values())
    source = open_source(out)
    samples = list(source)
    assert source.notices == []
    last_ns = samples[-1].t_ns
    rows = read_solutions(path.with_suffix(".csv"))
    assert (rows[-1].t_ns if rows else samples[0].t_ns) >= given_ns - LOST_AT_MOST_NS
    return Death((given_ns - last_ns) / NS_PER_S, (died_ns - last_ns) / NS_PER_S)


def moments(count: int, seed: int) -> list[float]:
    rng = random.Random(seed)
    return [rng.uniform(0.05, 2.0) for _ in range(count)]


def check_kills(folder: Path, count: int, seed: int) -> list[Death]:
    deaths = list(kills(folder, moments(count, seed)))
    assert len(deaths) == count
    assert max(one.lost_s for one in deaths) <= 1.0
    return deaths


def test_killed_five_times(tmp_path: Path) -> None:
    check_kills(tmp_path, 5, seed=1)


@pytest.mark.long
def test_killed_two_hundred_times(tmp_path: Path) -> None:
    deaths = check_kills(tmp_path, int(os.environ.get("LEADLINE_KILLS", "200")), seed=2)
    sys.stderr.write(f"kills: {len(deaths)}, lost at most {max(one.lost_s for one in deaths):.3f} s, ")
    sys.stderr.write(f"by the clock {max(one.before_death_s for one in deaths):.3f} s\n")


# -- cuts and flipped bits ---------------------------------------------------------------------------------------------


class Intact(NamedTuple):
    data: bytes
    samples: list[Sample]
    ends: list[int]  # where each chunk ends in the file,
    lasts_ns: list[int]  # and the last time in it


def intact(path: Path, samples: list[Sample]) -> Intact:
    data = recorded(path, samples)
    ends, lasts = [], []
    with path.open("rb") as stream:
        for opcode, offset, content in mcap_records.walk(stream, len(data), lambda _: None):
            if opcode == mcap_records.CHUNK:
                ends.append(offset + 9 + len(content))
                lasts.append(int.from_bytes(content[8:16], "little"))
    return Intact(data, samples, ends, lasts)


def damages(count: int, seed: int, size: int) -> Iterator[tuple[int | None, int | None]]:
    """Where it is cut, which bit is flipped: one or the other, every tenth both."""
    rng = random.Random(seed)
    for number in range(count):
        cut = rng.randrange(1, size) if number % 2 or number % 10 == 0 else None
        bit = rng.randrange(8 * (cut or size)) if number % 2 == 0 else None
        yield cut, bit


def check_damages(folder: Path, whole: Intact, count: int, seed: int) -> dict[str, float]:
    worst = {"lost_s": 0.0, "nothing": 0}
    for number, (cut, bit) in enumerate(damages(count, seed, len(whole.data))):
        data = bytearray(whole.data[:cut])
        if bit is not None:
            data[bit // 8] ^= 1 << bit % 8
        path, out = folder / f"{number}.mcap", folder / f"{number}.recovered.mcap"
        path.write_bytes(data)
        lost_s = lost_by(whole, path, out, cut)
        assert lost_s <= 1.0, (number, cut, bit)
        worst["lost_s"] = max(worst["lost_s"], lost_s)
        worst["nothing"] += not out.exists()
        path.unlink()
        out.unlink(missing_ok=True)
    return worst


def lost_by(whole: Intact, path: Path, out: Path, cut: int | None) -> float:
    """Seconds of samples that the file held, and what was recovered does not."""
    chunks = len(whole.ends) if cut is None else bisect_right(whole.ends, cut)
    until_ns = whole.lasts_ns[chunks - 1] if chunks else -1
    held = [one for one in whole.samples if one.t_ns <= until_ns]
    try:
        recovery = recover(path, out)
    except InputError:
        return len([one for one in held if isinstance(one, StereoFrame)]) / FPS
    assert opens_in_rosbags(out) == sum(recovery.counts.values())
    source = open_source(out)
    assert source.rig is not None
    back = list(source)
    assert {str(notice.kind) for notice in source.notices} <= {"skipped"}  # a frame whose chunk was cut in two
    missing = {(type(one), one.t_ns) for one in held} - {(type(one), one.t_ns) for one in back}
    by_time = {(type(one), one.t_ns): one for one in whole.samples}
    assert all(same(by_time[type(one), one.t_ns], one) for one in back)  # what is there is true
    assert not missing or recovery.lost
    return sum(kind is StereoFrame for kind, _ in missing) / FPS


def test_sixty_damages(tmp_path: Path) -> None:
    whole = intact(tmp_path / "dive.mcap", dive(2.0))
    check_damages(tmp_path, whole, 60, seed=3)


@pytest.mark.long
def test_a_thousand_damages(tmp_path: Path) -> None:
    whole = intact(tmp_path / "dive.mcap", dive(4.0))
    worst = check_damages(tmp_path, whole, int(os.environ.get("LEADLINE_DAMAGES", "1000")), seed=4)
    sys.stderr.write(f"damages: lost at most {worst['lost_s']:.3f} s; no message left in {worst['nothing']}\n")


def test_every_bit_of_what_describes_the_file(tmp_path: Path) -> None:
    """Header, attachments, schemas, channels and the first chunk's head: a bit in every 401st byte."""
    whole = intact(tmp_path / "dive.mcap", dive(0.4))
    for place in range(0, whole.ends[0] + 200, 401):
        data = bytearray(whole.data)
        data[place] ^= 1 << place % 8
        path, out = tmp_path / "bad.mcap", tmp_path / "good.mcap"
        path.write_bytes(data)
        assert lost_by(whole, path, out, None) <= 1 / FPS + 1e-9, place
        out.unlink()


def test_recover_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = recorded(tmp_path / "dive.mcap", dive(1.0))
    path = tmp_path / "cut.mcap"
    path.write_bytes(data[: len(data) // 2])
    assert main(["recover", str(path)]) == 0
    told = capsys.readouterr().out
    assert "cannot be read beyond byte" in told
    assert f"{tmp_path / 'cut.recovered.mcap'}: 0." in told
    assert main(["recover", str(path), "--out", str(tmp_path / "cut.recovered.mcap")]) == 2
    assert main(["recover", str(FARM)]) == 2
    assert main(["recover", str(tmp_path / "none.mcap")]) == 2
    assert capsys.readouterr().err.count("\n") == 3


# -- full disk ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 400 kB; skipped where one cannot be mounted."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=400k", "leadline", str(folder)], capture_output=True, check=False
    )
    if mount.returncode:
        pytest.skip("no right to mount a file system")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def test_a_full_disk_costs_nothing_written_and_recording_goes_on(small_disk: Path) -> None:
    ballast = small_disk / "ballast"
    ballast.write_bytes(bytes(250_000))
    samples = dive(4.0)
    sink, table = McapSink(small_disk / "dive.mcap"), SolutionsCsv(small_disk / "solutions.csv")
    refused = []
    for number, sample in enumerate(samples):
        try:
            sink.sample(sample)
        except OSError:
            refused.append(number)
            if len(refused) == 20:
                back = list(open_source(small_disk / "dive.mcap"))
                assert len(back) >= refused[0]
                ballast.unlink()  # somebody makes room
        assert (sink.check() is not None) >= (number in refused)
        table_row(table, sample)
    assert len(refused) == 20
    assert sink.check() is None
    sink.close()
    table.close()
    source = open_source(small_disk / "dive.mcap")
    assert all(same(before, after) for before, after in zip(samples, source, strict=True))
    assert source.notices == []
    opens_in_rosbags(small_disk / "dive.mcap")
    assert [one.t_ns for one in read_solutions(small_disk / "solutions.csv")] == [one.t_ns for one in samples]


def table_row(table: SolutionsCsv, sample: Sample) -> None:
    try:
        table.solution(Solution(sample.t_ns, Stage.SEARCHING, Status.LOST))
    except OSError:
        return


def test_a_disk_that_stays_full_keeps_what_was_written(small_disk: Path) -> None:
    samples = dive(4.0)
    (small_disk / "ballast").write_bytes(bytes(250_000))
    sink = McapSink(small_disk / "dive.mcap")
    written = 0
    for sample in samples:
        try:
            sink.sample(sample)
            written += 1
        except OSError:
            pass
    with pytest.raises(OSError, match="No space left"):
        sink.close()
    back = list(open_source(small_disk / "dive.mcap"))
    assert len([one for one in samples[: len(back)] if isinstance(one, StereoFrame)]) > 10
    assert len(back) <= written
    assert all(same(before, after) for before, after in zip(samples, back, strict=False))


def test_what_waits_for_room_is_bounded_and_its_loss_is_written_down(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sink = McapSink(tmp_path / "dive.mcap")
    sink._writer._spool._keep_bytes = 20_000
    samples = dive(2.0)
    feed(sink, samples[:6])
    old = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (sink._writer._spool.written[0] + 1000, limits[1]))
    try:
        for sample in samples[6:]:
            with pytest.raises(OSError, match="File too large"):
                feed_one(sink, sample)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, old)
    lost = sink._writer.lost
    assert lost > 5
    feed(sink, dive(2.1)[-1:])
    feed(sink, [LaserRange(3 * NS_PER_S, 1.0)])
    sink.close()
    reader = RecordingReader(tmp_path / "dive.mcap", lambda _: None)
    told = [one.message.status[0].message for one in reader.messages([DIAGNOSTICS])]
    assert f"{lost} parts before this one are lost: the disk had no room" in told
    assert (reader.count(LEFT_IMAGE) or 0) < 31


def test_a_live_run_goes_on_and_its_health_says_so(small_disk: Path) -> None:
    (small_disk / "ballast").write_bytes(bytes(300_000))
    health = Health()
    now_ns = 0
    outlet = Outlet(McapSink(small_disk / "dive.mcap"), health, lambda: now_ns, live=True, clock=time.perf_counter)
    for sample in dive(4.0):
        now_ns = sample.t_ns
        outlet.sample(sample)
        outlet.solution(Solution(now_ns, Stage.SEARCHING, Status.LOST))
        assert outlet.worker is not None
        assert outlet.worker.settle(10.0)
        outlet.collect()
    outlet.close()
    (disk,) = [one for one in health.conditions if one.part is Part.DISK]
    assert disk.state is State.OFF
    assert "No space left on device" in disk.why
    assert len(list(open_source(small_disk / "dive.mcap"))) > 5


def test_a_full_disk_is_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def full(path: Path, out: Path) -> None:
        raise OSError(28, "No space left on device", str(out))

    monkeypatch.setattr("leadline.wire.recording.recover", full)
    assert main(["recover", "dive.mcap"]) == 1
    assert capsys.readouterr().err.count("\n") == 1


# -- power cut ---------------------------------------------------------------------------------------------------------


def test_all_is_synced_within_a_second(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What stands in the file at a sync is safe; so is, a second later at the latest, whatever stood in it before."""
    safe: list[tuple[float, int]] = []
    monkeypatch.setattr(spool.os, "fsync", lambda file: safe.append((time.monotonic(), os.fstat(file).st_size)))
    sink = McapSink(tmp_path / "dive.mcap")
    written: list[tuple[float, int]] = []
    for number in range(60):
        if number < 40:
            sink.sample(LaserRange(number * 50_000_000, 2.0))  # then nothing comes any more
        time.sleep(0.05)
        written.append((time.monotonic(), (tmp_path / "dive.mcap").stat().st_size))
    sink.close()
    for when_s, size in written:
        first_s = next(synced_s for synced_s, synced in safe if synced >= size)
        assert first_s - when_s <= 1.0
    reader = RecordingReader(tmp_path / "dive.mcap", lambda _: None)
    assert reader.count("/leadline/laser/range") == 40


def test_an_error_of_the_sync_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sink = McapSink(tmp_path / "dive.mcap")

    def broken(file: int) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(spool.os, "fsync", broken)
    deadline_s = time.monotonic() + 5
    while sink.check() is None and time.monotonic() < deadline_s:
        time.sleep(0.05)
    told = sink.check()
    assert told is not None
    assert "Input/output error" in told[1]
    with pytest.raises(OSError, match="Input/output error"):
        sink.sample(dive(0.1)[1])
    monkeypatch.undo()
    sink.close()
