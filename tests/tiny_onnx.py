"""Writes ONNX models that answer every image with the same output, byte by byte: the tests need no `onnx` package."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

FLOAT, UINT8, DOUBLE, FLOAT16 = 1, 2, 11, 10
LEGACY_IR = 8


def constant_model(
    path: Path,
    output: np.ndarray,
    input_shape: Sequence[int | str] = (1, 3, 64, 64),
    metadata: dict[str, str] | None = None,
    input_type: int = FLOAT,
) -> Path:
    """A model with input `images` of ``input_shape`` (a name: any size) and the fixed answer ``output`` (float32)."""
    tensor = b"".join(_number(1, n) for n in output.shape) + _number(2, FLOAT)
    tensor += _text(8, "answer") + _bytes(9, output.astype("<f4").tobytes())
    node = _text(1, "answer") + _text(2, "output0") + _text(4, "Identity")
    graph = _bytes(1, node) + _text(2, "constant") + _bytes(5, tensor)
    graph += _bytes(11, _value("images", input_shape, input_type)) + _bytes(12, _value("output0", output.shape))
    model = _number(1, LEGACY_IR) + _bytes(7, graph) + _bytes(8, _text(1, "") + _number(2, 17))
    for key, value in (metadata or {}).items():
        model += _bytes(14, _text(1, key) + _text(2, value))
    path.write_bytes(model)
    return path


def _value(name: str, shape: Sequence[int | str], kind: int = FLOAT) -> bytes:
    dims = b"".join(_bytes(1, _text(2, n) if isinstance(n, str) else _number(1, n)) for n in shape)
    return _text(1, name) + _bytes(2, _bytes(1, _number(1, kind) + _bytes(2, dims)))


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _bytes(field: int, value: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(value)) + value


def _text(field: int, value: str) -> bytes:
    return _bytes(field, value.encode())
