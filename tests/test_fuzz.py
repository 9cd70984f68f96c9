"""Whatever a file holds, a reader gives what there is or raises InputError (a decoder: ValueError), and nothing else.

Short forms here; the long ones are ``long``: LEADLINE_FUZZ scales them. Laser streams: test_laser_protocols.py.
"""

from __future__ import annotations

import os
import random
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from leadline.config import Config
from leadline.errors import InputError
from leadline.rig import Rig
from leadline.samples import LaserRange, Sample, Solution, Stage, Status, StereoFrame
from leadline.sinks import McapSink, SolutionsCsv
from leadline.sources import open_source
from leadline.wire.images import decode_image, encode_jpeg, encode_png
from leadline.wire.recording import recover
from leadline.wire.solutions import read_solutions
from leadline.wire.truth import parse_truth
from wire_helpers import picture, write_folder

WORDS = [b"nan", b"-inf", b"1e999", b"", b"null", b"~", b"[]", b"{}", b"-1", b"\xff\xfe", b"0x1f", b"\n", b",", b": ",
         b"\0", b"!!python/object:os.system", b"&a [*a]", b"9" * 40, b"'", b'"']  # fmt: skip


def scale(count: int) -> int:
    return max(1, round(count * float(os.environ.get("LEADLINE_FUZZ", "1"))))


def spoilt(data: bytes, rng: random.Random) -> bytes:
    """Bits flipped, pieces cut out, doubled, swapped for words that readers dislike, or the end missing."""
    out = bytearray(data)
    for _ in range(rng.randrange(1, 5)):
        place = rng.randrange(len(out) + 1)
        kind = rng.randrange(6)
        if kind == 0 and place < len(out):
            out[place] ^= 1 << rng.randrange(8)
        elif kind == 1:
            del out[place : place + rng.randrange(1, 40)]
        elif kind == 2:
            out[place:place] = out[place : place + rng.randrange(1, 200)]
        elif kind == 3:
            del out[place:]
        else:
            out[place : place + rng.randrange(0, 6)] = rng.choice(WORDS)
    return bytes(out)


def run(read: Callable[[bytes], object], whole: bytes, count: int, seed: int, *, allowed: type[Exception]) -> int:
    """How many were refused; any other exception fails, with what brought it about."""
    rng = random.Random(seed)
    refused, many_lines = 0, False
    for number in range(count):
        data = spoilt(whole, rng)
        try:
            read(data)
        except allowed as error:
            refused += 1
            many_lines = "\n" in str(error)
        except Exception as error:
            raise AssertionError(f"{type(error).__name__}: {error}; number {number}, seed {seed}: {data!r}") from error
        assert not many_lines, (number, seed)
    assert refused or count < 20
    return refused


def of_file(path: Path, read: Callable[[Path], object]) -> Callable[[bytes], object]:
    def from_bytes(data: bytes) -> object:
        path.write_bytes(data)
        return read(path)

    return from_bytes


def rig_text(tmp_path: Path) -> bytes:
    Rig.load("rendered").save(tmp_path / "whole.yaml")
    return (tmp_path / "whole.yaml").read_bytes()


def small_rig(tmp_path: Path) -> bytes:
    """Without its covariance, whose many numbers make the file slow to read."""
    data = yaml.safe_load(rig_text(tmp_path))
    data.pop("covariance", None)
    return yaml.safe_dump(data, sort_keys=False).encode()


def solutions_text(tmp_path: Path) -> bytes:
    sink = SolutionsCsv(tmp_path / "whole.csv")
    for i in range(20):
        vector = np.array([0.1, 0.2, i + 0.5])
        sink.solution(Solution(i * 10**8, Stage.BOTH, Status.VALID, vector, np.eye(3), 2.0, 0.01, vector))
    sink.close()
    return (tmp_path / "whole.csv").read_bytes()


# -- configs, rigs, tables ---------------------------------------------------------------------------------------------


def configs(tmp_path: Path, count: int, seed: int) -> None:
    read = of_file(tmp_path / "config.yaml", Config.load)
    run(read, Config().dump().encode(), count, seed, allowed=InputError)


def rigs(tmp_path: Path, count: int, seed: int) -> None:
    run(of_file(tmp_path / "rig.yaml", Rig.load), small_rig(tmp_path), count, seed, allowed=InputError)


def tables(tmp_path: Path, rows: int, seed: int) -> None:
    """Twenty rows a table."""
    count = max(2, rows // 60)
    run(of_file(tmp_path / "t.csv", read_solutions), solutions_text(tmp_path), count, seed, allowed=InputError)
    truth = b"t_s,x_m,y_m,z_m,range_m\n" + b"".join(b"%d.5,0.1,-0.2,%d,2.5\n" % (i, i) for i in range(20))

    def read_truth(data: bytes) -> object:
        return parse_truth(data.decode("utf-8", "replace"), "truth.csv", lambda notice: None)

    run(read_truth, truth, count, seed + 1, allowed=InputError)
    folder = write_folder(tmp_path / "dive", frames=1)
    laser = b"t_s,range_m,quality\n" + b"".join(b"%d.25,%d.5,0.9\n" % (i, i) for i in range(20))
    run(of_file(folder / "laser.csv", lambda _: list(open_source(folder))), laser, count, seed + 2, allowed=InputError)


def test_configs(tmp_path: Path) -> None:
    configs(tmp_path, 60, seed=1)


def test_rigs(tmp_path: Path) -> None:
    rigs(tmp_path, 60, seed=2)


def test_tables(tmp_path: Path) -> None:
    tables(tmp_path, 3000, seed=3)


@pytest.mark.long
def test_a_hundred_thousand_configs(tmp_path: Path) -> None:
    configs(tmp_path, scale(100_000), seed=11)


@pytest.mark.long
def test_a_hundred_thousand_rigs(tmp_path: Path) -> None:
    rigs(tmp_path, scale(100_000), seed=12)


@pytest.mark.long
def test_a_hundred_thousand_rows(tmp_path: Path) -> None:
    tables(tmp_path, scale(100_000), seed=13)


# -- images, recordings ------------------------------------------------------------------------------------------------


def images(count: int, seed: int) -> None:
    cv2.utils.logging.setLogLevel(0)  # what it says of damaged images is no news
    for number, whole in enumerate(
        (encode_png(picture(1)), encode_jpeg(picture(2)), encode_jpeg(picture(3, grey=True)))
    ):
        run(decode_image, whole, count // 3, seed + number, allowed=ValueError)


def recordings(tmp_path: Path, count: int, seed: int) -> None:
    """Read as a source and recovered: what comes out opens again."""
    path, out = tmp_path / "dive.mcap", tmp_path / "good.mcap"
    sink = McapSink(path)
    samples: list[Sample] = []
    for i in range(6):
        image = picture(i, (16, 12))
        samples += [LaserRange(i * 10**8, 2.0), StereoFrame(i * 10**8, image, image)]
    for sample in samples:
        sink.sample(sample)
    sink.close()
    whole = path.read_bytes()

    def read(data: bytes) -> None:
        path.write_bytes(data)
        out.unlink(missing_ok=True)
        recover(path, out)
        list(open_source(path))

    run(read, whole, count, seed, allowed=InputError)


def test_images() -> None:
    images(300, seed=4)


def test_recordings(tmp_path: Path) -> None:
    recordings(tmp_path, 60, seed=5)


@pytest.mark.long
def test_ten_thousand_images() -> None:
    images(scale(10_000), seed=14)


@pytest.mark.long
def test_ten_thousand_recordings(tmp_path: Path) -> None:
    recordings(tmp_path, scale(10_000), seed=15)
