"""Image bytes to pixels."""

from __future__ import annotations

import numpy as np
import pytest

from leadline.wire.images import decode_image, encode_jpeg, encode_png, image_format
from wire_helpers import picture


@pytest.mark.parametrize("grey", [False, True])
def test_png_is_lossless_and_keeps_the_channels(grey: bool) -> None:
    image = picture(1, grey=grey)
    data = encode_png(image)
    assert image_format(data) == "png"
    assert np.array_equal(decode_image(data), image)


def test_jpeg_is_close() -> None:
    image = np.full((48, 64, 3), (10, 120, 240), np.uint8)
    data = encode_jpeg(image)
    assert image_format(data) == "jpeg"
    assert np.abs(decode_image(data).astype(int) - image).max() <= 3


@pytest.mark.parametrize("thumbnail", [b"", b"\xff\xe1\x00\x06\xff\xd8\xff\xd9"])
def test_a_cut_jpeg_is_refused_whatever_opencv_makes_of_it(thumbnail: bytes) -> None:
    """OpenCV before 5 fills it up with grey. A thumbnail in front brings an end marker of its own."""
    data = encode_jpeg(picture(1))
    data = data[:2] + thumbnail + data[2:]
    assert decode_image(data).shape == (48, 64, 3)
    with pytest.raises(ValueError, match="cut off"):
        decode_image(data[: len(data) * 2 // 3])


def damaged(data: bytes, place: int) -> bytes:
    return data[:place] + bytes([data[place] ^ 0x55]) + data[place + 1 :]


def test_a_damaged_or_cut_picture_is_one_line_of_ours_and_none_of_a_librarys(capfd: pytest.CaptureFixture[str]) -> None:
    png = encode_png(picture(1))
    broken = [damaged(png, place) for place in (9, 20, 40, len(png) // 2, len(png) - 20)]
    broken += [png[:size] for size in (5, 20, 60, len(png) // 2, len(png) - 2)]
    broken += [b"II*\0" + png[4:], b"\xff\xd8" + png[2:] + b"\xff\xd9"]
    for data in broken:
        with pytest.raises(ValueError, match=r"cut off or damaged|not a readable image"):
            decode_image(data)
    assert capfd.readouterr().err == ""


def test_a_note_in_a_png_may_be_damaged_and_something_may_follow() -> None:
    png = encode_png(picture(1))
    note = b"\0\0\0\5tEXta\0bcd" + b"wrong"[:4]
    assert np.array_equal(decode_image(png[:33] + note + png[33:] + b"more"), picture(1))


@pytest.mark.parametrize(
    ("data", "why"), [(b"", "empty"), (b"\x00" * 100, "not a readable"), (b"BM", "not a readable")]
)
def test_no_image(data: bytes, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        decode_image(data)
