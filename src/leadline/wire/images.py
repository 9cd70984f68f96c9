"""Image bytes to pixels and back. Pixels are (H, W, 3) uint8 BGR, or (H, W) uint8 where the file is grey."""

from __future__ import annotations

import os
import zlib

import cv2
import numpy as np

from leadline.samples import Image

_MAGIC = {b"\xff\xd8": "jpeg", b"\x89PNG": "png", b"BM": "bmp", b"II*\0": "tiff", b"MM\0*": "tiff"}
SUFFIX = {"jpeg": ".jpg", "png": ".png", "bmp": ".bmp", "tiff": ".tiff"}


def image_format(data: bytes) -> str:
    """ "jpeg", "png", "bmp" or "tiff", from the first bytes; "" if none of these."""
    return next((name for magic, name in _MAGIC.items() if data.startswith(magic)), "")


def quiet() -> None:
    """OpenCV and FFmpeg write no lines of their own, unless the environment asks for them.

    What is wrong with a picture, a camera or a stream is told by us, in one.
    """
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # AV_LOG_QUIET; read when the first stream is opened
    if "OPENCV_LOG_LEVEL" not in os.environ:
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)


def decode_image(data: bytes) -> Image:
    """Raises ValueError with one clear line. A JPEG that was cut off is refused, not filled up with grey."""
    if not data:
        raise ValueError("the image file is empty")
    # Older OpenCV decodes a cut JPEG without complaint. Not the first half: a thumbnail has an end marker too.
    if data.startswith(b"\xff\xd8") and data.find(b"\xff\xd9", len(data) // 2) < 0:
        raise ValueError("the JPEG is cut off")
    if data.startswith(b"\x89PNG"):
        _require_whole_png(data)
    quiet()
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYCOLOR)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise ValueError("not a readable image")
    return np.asarray(pixels, np.uint8)


def _require_whole_png(data: bytes) -> None:
    """By its checksums, before libpng sees it: that writes to stderr what it finds."""
    place, kind = 8, b""
    while kind != b"IEND":
        end = place + 8 + int.from_bytes(data[place : place + 4], "big")
        kind, checksum = data[place + 4 : place + 8], data[end : end + 4]
        whole = len(checksum) == 4
        needed = whole and not kind[0] & 0x20  # other chunks are notes
        if not whole or (needed and zlib.crc32(memoryview(data)[place + 4 : end]).to_bytes(4, "big") != checksum):
            raise ValueError("the PNG is cut off or damaged")
        place = end + 4


class SizeError(ValueError):
    """Left and right images of different size: a mistake of the whole dive if its first frame has it."""


def require_same_size(left: Image, right: Image) -> None:
    if left.shape[:2] != right.shape[:2]:
        sizes = " and ".join(f"{image.shape[1]}x{image.shape[0]}" for image in (left, right))
        raise SizeError(f"left and right differ in size: {sizes}")


def encode_png(image: Image) -> bytes:
    """Lossless; level 1, because a recording has to keep up with the cameras."""
    return bytes(cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes())


def encode_jpeg(image: Image, quality: int = 95) -> bytes:
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes())
