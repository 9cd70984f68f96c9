"""Network -> one ONNX file with everything in it: weights, class names, size, provenance, licence."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import torch

from leadline.training.network import LARGEST_STRIDE, Exported, Network

OPSET = 17


def export_onnx(network: Network, path: Path, names: Sequence[str], long_side: int, about: dict[str, str]) -> None:
    """Write ``network`` as ONNX: input `images` (1, 3, H, W), output `output0` (1, 4 + classes, N).

    H and W are free multiples of 32; the metadata hold the long side it is meant for (`imgsz`), `names`, `stride` and
    ``about`` (author, licence, data ...). The keys are those that Ultralytics' exports use, so that tools find them.
    """
    model = Exported(network).eval()
    with warnings.catch_warnings():
        # The tracing exporter is deprecated, but its successor does not take sizes that are multiples of a stride.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            model,
            (torch.zeros(1, 3, 256, 320),),
            str(path),
            input_names=["images"],
            output_names=["output0"],
            dynamic_axes={"images": {2: "height", 3: "width"}, "output0": {2: "boxes"}},
            opset_version=OPSET,
            dynamo=False,
        )
    entries = {
        "names": str(dict(enumerate(names))),
        "imgsz": str([long_side, long_side]),
        "stride": str(LARGEST_STRIDE),
        "task": "detect",
        **about,
    }
    add_metadata(path, entries)


def add_metadata(path: Path, entries: dict[str, str]) -> None:
    """Put ``entries`` beside those that the model already has; the file is replaced whole."""
    import onnx  # noqa: PLC0415  (the extra `train`)

    graph = onnx.load(str(path))
    there = {entry.key: entry.value for entry in graph.metadata_props}
    onnx.helper.set_model_props(graph, there | entries)
    onnx.checker.check_model(graph)
    beside = path.with_suffix(".writing")
    onnx.save(graph, str(beside))
    beside.replace(path)
