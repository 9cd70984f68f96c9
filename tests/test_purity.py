"""From the localizer down: no clock, no file after construction, no global random state, no network, no print.

A short dive runs with all of these blocked, twice, and gives the same bits.
"""

from __future__ import annotations

import builtins
import datetime
import io
import os
import pathlib
import random
import socket
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from leadline.localizer import Localizer
from leadline.samples import Solution
from leadline.target import Cylinder, Plane, Sphere, Surface, Target
from short_dives import TrueBoxes, cut, samples

CLOCKS = ("time", "time_ns", "monotonic", "monotonic_ns", "perf_counter", "perf_counter_ns", "process_time", "sleep")
GLOBAL_RANDOM = ("seed", "rand", "randn", "random", "normal", "uniform", "randint", "choice", "shuffle", "permutation")
RANDOM = ("seed", "random", "uniform", "gauss", "randint", "choice", "shuffle", "sample")
BLOCKED: list[tuple[Any, tuple[str, ...]]] = [
    (time, CLOCKS),
    (datetime, ("datetime", "date")),
    (builtins, ("open", "print", "input")),
    (io, ("open",)),
    (os, ("open", "stat", "listdir", "scandir", "getenv", "urandom")),
    (pathlib.Path, ("open", "read_text", "read_bytes", "write_text", "write_bytes", "exists", "iterdir")),
    (socket, ("socket", "create_connection", "getaddrinfo")),
    (np.random, GLOBAL_RANDOM),
    (np.random, ("default_rng",)),  # without a seed it asks the system
    (random, RANDOM),
    (np, ("load", "save", "loadtxt", "savetxt", "fromfile")),
]
TARGETS: list[tuple[str, Target]] = [
    ("demo", Sphere(0.34)),
    ("demo", Sphere()),
    ("hull", Plane()),
    ("pile", Cylinder()),
    ("lump", Surface()),
]


def raiser(name: str) -> Callable[..., Any]:
    def blocked(*args: object, **kwargs: object) -> Any:
        raise AssertionError(f"{name} was called")

    return blocked


def block(patch: pytest.MonkeyPatch) -> None:
    for owner, names in BLOCKED:
        for name in names:
            patch.setattr(owner, name, raiser(f"{owner.__name__}.{name}"))


def bits(solution: Solution | None) -> tuple[Any, ...] | None:
    """Everything in a solution, arrays as their bytes."""
    if solution is None:
        return None
    values = [getattr(solution, name) for name in Solution.__slots__]
    return tuple(value.tobytes() if isinstance(value, np.ndarray) else value for value in values)


@pytest.mark.parametrize("filtered", [True, False])
@pytest.mark.parametrize(("scene", "target"), TARGETS, ids=lambda v: v if isinstance(v, str) else v.name)
def test_a_dive_needs_nothing_but_its_samples(scene: str, target: Target, filtered: bool) -> None:
    dive = cut(scene, 0.9, 0.7, 5.0)
    inputs = samples(dive)
    runs = []
    for _ in range(2):
        localizer = Localizer(dive.rig, target, TrueBoxes(dive), filtered=filtered)
        with pytest.MonkeyPatch.context() as patch:
            block(patch)
            solutions = [localizer.step(sample) for sample in inputs]
        runs.append([bits(solution) for solution in solutions])
    assert runs[0] == runs[1]
    assert sum(solution is not None and solution.range_m is not None for solution in solutions) >= 3


@pytest.mark.parametrize("name", ["time.time", "builtins.open", "numpy.random.normal", "builtins.print"])
def test_what_is_blocked_would_be_noticed(name: str) -> None:
    owner, _, attribute = name.rpartition(".")
    with pytest.MonkeyPatch.context() as patch:
        block(patch)
        called = getattr({"time": time, "builtins": builtins, "numpy.random": np.random}[owner], attribute)
        with pytest.raises(AssertionError, match="was called"):
            called()
