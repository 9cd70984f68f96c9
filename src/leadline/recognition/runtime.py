"""ONNX Runtime (the only file that imports it): a model's file, its input, and where it runs."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from leadline.config import Provider
from leadline.errors import InputError

Pixels = NDArray[np.float32] | NDArray[np.float16] | NDArray[np.uint8]
FREE_SIDE = 640  # px, the long side for a model of free size whose metadata say nothing
DTYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(uint8)": np.uint8}
NAMES = {
    "cpu": "CPUExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
}
WHEELS = {
    "cpu": "onnxruntime",
    "cuda": "onnxruntime-gpu",
    "tensorrt": "onnxruntime-gpu tensorrt",
    "openvino": "onnxruntime-openvino",
}
WANTED = "give a detector with input (1, 3, height, width): float32, float16 or uint8"


class Model:
    """A network for one colour image.

    ``size``: (width, height) of its input, None where free; ``long_side``: the longer one to use where both are free;
    ``dtype``: of its input; ``metadata``: what its maker wrote into it. ``threads``: on the CPU.
    Raises InputError where the file is missing, no ONNX model or one for other inputs, and where ``provider`` is not
    installed or does not start.
    """

    def __init__(self, path: str, provider: Provider, threads: int) -> None:
        self.path = path
        self._session = _open(path, provider, threads)
        self.metadata: dict[str, str] = dict(self._session.get_modelmeta().custom_metadata_map)
        inputs = self._session.get_inputs()
        if len(inputs) != 1:
            raise InputError(f"the model takes {len(inputs)} inputs", path, WANTED)
        self._input = inputs[0]
        self.size = _size(self._input.shape, path)
        if self._input.type not in DTYPES:
            raise InputError(f"the model takes {self._input.type}", path, WANTED)
        self.dtype: Any = DTYPES[self._input.type]
        self.long_side = max(int(v) for v in np.ravel(literal(self.metadata.get("imgsz"), FREE_SIDE)))

    def run(self, pixels: Pixels) -> NDArray[np.float32]:
        """The first output for an input (1, 3, height, width) of ``dtype``. InputError where the model refuses it."""
        try:
            return np.asarray(self._session.run(None, {self._input.name: pixels})[0], np.float32)
        except Exception as error:  # ONNX Runtime's own classes are not public
            width, height = pixels.shape[3], pixels.shape[2]
            what = f"the model does not run on a {width}x{height} image ({_first_line(error)})"
            raise InputError(what, self.path, "export it for one image (batch 1) of this size, or of any") from error


def literal(text: str | None, default: Any) -> Any:
    """A value written in the metadata as Python writes it, as the common exporters do."""
    try:
        return ast.literal_eval(text) if text else default
    except (ValueError, SyntaxError):
        return default


def _open(path: str, provider: Provider, threads: int) -> Any:
    if not Path(path).is_file():
        raise InputError("no such model file", path, "give an .onnx file, or leave --model out for the shipped one")
    if NAMES[provider] not in ort.get_available_providers():
        there = ", ".join(name for name, long in NAMES.items() if long in ort.get_available_providers())
        fix = f"pip uninstall onnxruntime; pip install {WHEELS[provider]}"
        raise InputError(f"this ONNX Runtime has no {provider}, but {there}", f"provider {provider}", fix)
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # who waits, sleeps
    options.log_severity_level = 4  # what is wrong is told in one line, below
    try:
        session = ort.InferenceSession(path, options, providers=_providers(provider, threads), enable_fallback=0)
    except Exception as error:  # ONNX Runtime's own classes are not public
        if provider == "cpu":
            raise InputError(
                f"not a readable ONNX model ({_first_line(error)})", path, "export it to ONNX again"
            ) from error
        raise InputError(f"{provider} does not run it ({_first_line(error)})", path, "try --provider cpu") from error
    if NAMES[provider] not in session.get_providers():
        fix = "check its driver and libraries, or use cpu"
        raise InputError(f"{provider} is installed and does not start", f"provider {provider}", fix)
    return session


def _providers(provider: Provider, threads: int) -> list[Any]:
    """The one asked for, then those that take over what it cannot do."""
    chain: dict[str, list[Any]] = {
        "cpu": [],
        "cuda": ["CUDAExecutionProvider"],
        "tensorrt": ["TensorrtExecutionProvider", "CUDAExecutionProvider"],
        "openvino": [("OpenVINOExecutionProvider", _openvino(threads))],
    }
    return [*chain[provider], "CPUExecutionProvider"]


def _openvino(threads: int) -> dict[str, str]:
    """32-bit numbers: left alone, it takes 16 where the processor has them, and boxes move by pixels."""
    settings = {"INFERENCE_PRECISION_HINT": "f32", "INFERENCE_NUM_THREADS": str(threads), "NUM_STREAMS": "1"}
    return {"device_type": "CPU", "load_config": json.dumps({"CPU": settings})}


def _first_line(error: Exception) -> str:
    first = (str(error).strip().splitlines() or [type(error).__name__])[0]
    return first.rpartition(" : ")[2][:160]  # it begins with its own codes


def _size(shape: list[Any], path: str) -> tuple[int | None, int | None]:
    """(width, height) of the input, None where the model takes any."""
    if len(shape) != 4 or (isinstance(shape[1], int) and shape[1] != 3):
        last = len(shape) == 4 and shape[3] == 3
        fix = "export it with the channels first: (1, 3, height, width)" if last else WANTED
        raise InputError(f"unknown model input {'x'.join(map(str, shape))}", path, fix)
    if isinstance(shape[0], int) and shape[0] != 1:
        raise InputError(f"the model takes {shape[0]} images at once", path, "export it with a batch of 1")
    width, height = (n if isinstance(n, int) else None for n in (shape[3], shape[2]))
    return width, height
