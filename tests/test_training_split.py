"""Whole clips on each side of a split."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from leadline.errors import InputError
from leadline.training.dataset import Example
from leadline.training.split import Split, split_by_clip


def examples(clips: dict[str, int], part: str | None = None, number: int = 0, empty: bool = False) -> list[Example]:
    boxes = np.zeros((0, 4), np.float32) if empty else np.array([[1, 2, 30, 40]], np.float32)
    classes = np.full(len(boxes), number)
    return [
        Example(Path(f"{name}/{k}.png"), boxes, classes, clip=name, part=part)
        for name, count in clips.items()
        for k in range(count)
    ]


def sizes(split: Split) -> tuple[int, int, int]:
    return len(split.train), len(split.val), len(split.test)


def shared_clips(split: Split) -> set[str]:
    counted = Counter(clip for part in (split.train, split.val, split.test) for clip in {e.clip for e in part})
    return {clip for clip, count in counted.items() if count > 1}


@pytest.mark.parametrize("seed", range(5))
def test_clips_stay_whole_and_shares_come_near_8_1_1(seed: int) -> None:
    rng = np.random.default_rng(seed)
    given = examples({f"clip{k}": int(rng.integers(3, 40)) for k in range(25)})
    split = split_by_clip(given, seed)
    assert not shared_clips(split)
    assert sum(sizes(split)) == len(given)
    for count in sizes(split)[1:]:
        assert count / len(given) == pytest.approx(0.1, abs=0.02)
    assert split.notices[0].startswith("25 clips: ")
    assert sizes(split_by_clip(given[::-1], seed)) == sizes(split)  # the order of the files does not matter


def test_each_class_is_in_each_part() -> None:
    common = examples({f"a{k}": 10 for k in range(20)})
    rare = examples({f"b{k}": 4 for k in range(4)}, number=1)
    split = split_by_clip([*common, *rare])
    for part in (split.train, split.val, split.test):
        assert {int(k) for e in part for k in e.classes} == {0, 1}


def test_one_long_clip_is_cut_into_runs_and_told() -> None:
    split = split_by_clip(examples({"dive": 200}))
    assert all(10 <= count <= 40 for count in sizes(split)[1:])
    for part in (split.val, split.test):
        numbers = sorted(int(e.image.stem) for e in part)
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))  # a run of neighbours
    assert any("too few clips to keep them whole: dive cut" in line for line in split.notices)


def test_six_clips_are_not_cut() -> None:
    split = split_by_clip(examples({f"clip{k}": 6 for k in range(6)}))
    assert sizes(split) == (24, 6, 6)
    assert not any("cut" in line for line in split.notices)


def test_the_sets_own_split_is_kept() -> None:
    train, val = examples({"a": 20, "b": 20}, "train"), examples({"b": 4, "c": 4}, "val")
    split = split_by_clip([*train, *val])
    assert sizes(split) == (40, 8, 0)
    told = " ".join(split.notices)
    assert "the set's own split is kept" in told
    assert "it has no test part" in told
    assert "clip b and others stand in several parts" in told


def test_validation_is_taken_from_training_where_the_set_has_none() -> None:
    split = split_by_clip([*examples({f"a{k}": 10 for k in range(10)}, "train"), *examples({"t": 10}, "test")])
    assert sizes(split) == (90, 10, 10)
    assert not shared_clips(split)


def test_sets_that_cannot_be_split_are_refused() -> None:
    with pytest.raises(InputError, match=r"1 labelled image\(s\); label at least 10"):
        split_by_clip(examples({"a": 1}))
    with pytest.raises(InputError, match=r"the validation part .* shows no target"):
        split_by_clip([*examples({"a": 20}, "train"), *examples({"b": 4}, "val", empty=True)])


def test_parts_without_a_target_are_not_drawn() -> None:
    """Only three of 20 clips show the target: each part gets one."""
    given = [*examples({f"e{k}": 10 for k in range(17)}, empty=True), *examples({f"t{k}": 10 for k in range(3)})]
    split = split_by_clip(given)
    assert all(any(len(e.boxes) for e in part) for part in (split.train, split.val, split.test))
