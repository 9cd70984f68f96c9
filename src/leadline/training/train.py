"""The training loop: examples in, a network out. Needs the extra `train` (torch); nothing else of leadline does."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor

from leadline.training.augment import Picture, Rng, mosaic, single
from leadline.training.dataset import Example
from leadline.training.loss import detection_loss
from leadline.training.network import STRIDES, Network, cell_centres

KEPT_LONG_SIDE = 640  # larger images are kept at this size while training, unless told otherwise
LEARNT_PACE = 0.2  # of the learning rate, for what has been trained elsewhere


@dataclass(frozen=True, slots=True)
class Settings:
    """How to train. ``sizes`` (w, h) are drawn with ``size_weights``; ``batch`` holds at the first one."""

    steps: int = 1000
    batch: int = 16
    sizes: tuple[tuple[int, int], ...] = ((320, 256), (416, 256), (512, 320))
    size_weights: tuple[float, ...] = (0.4, 0.25, 0.35)
    learning_rate: float = 2e-3
    weight_decay: float = 0.02
    warm_up: int = 60
    mosaic: float = 0.3
    plain_end: float = 0.25  # the last part of the steps sees no mosaic
    average: float = 0.997  # the exported weights are a running mean
    seed: int = 0
    threads: int = 1


@dataclass(slots=True)
class Pool:
    """A named set of examples, drawn with ``weight``; files are read once and kept as encoded bytes."""

    examples: Sequence[Example]
    weight: float
    long_side: int = KEPT_LONG_SIDE  # larger images are kept at this size, pixels
    _bytes: dict[int, tuple[bytes, float]] = field(default_factory=dict)

    def draw(self, rng: Rng) -> Picture:
        k = int(rng.integers(len(self.examples)))
        example = self.examples[k]
        if k not in self._bytes:
            self._bytes[k] = _shrunk(example, self.long_side)
        encoded, scale = self._bytes[k]
        image = cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR)
        return Picture(np.asarray(image, np.uint8), example.boxes * np.float32(scale), example.classes)


def _shrunk(example: Example, long_side: int) -> tuple[bytes, float]:
    """The file's bytes, re-encoded smaller where it is large, and the factor."""
    data = example.image.read_bytes()
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise ValueError(f"{example.image}: not an image")
    scale = long_side / max(image.shape[:2])
    if scale >= 1:
        return data, 1.0
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes(), scale


class Trainer:
    """A network in training, a step at a time. Its whole state can be saved and put back: the steps that follow are
    the same, bit for bit, on the same machine with the same number of threads."""

    def __init__(
        self, pools: Sequence[Pool], classes: int = 1, settings: Settings | None = None, start: Network | None = None
    ) -> None:
        self.settings = settings or Settings()
        torch.set_num_threads(self.settings.threads)
        torch.manual_seed(self.settings.seed)
        self._pools = pools
        self._rng = np.random.default_rng(self.settings.seed)
        self.network: Network = copy.deepcopy(start) if start else Network(classes)
        self.network.train().to(memory_format=torch.channels_last)
        self.average: Network = copy.deepcopy(self.network).eval()  # what is tested and exported
        groups = _groups(self.network, self.settings.weight_decay)
        self._optimiser = torch.optim.AdamW(groups, lr=self.settings.learning_rate)
        self.steps = 0

    def step(self, place: float | None = None) -> float:
        """Learn from one batch; its loss. ``place``: where in the schedule of ``settings.steps`` this is, in steps."""
        settings = self.settings
        place = self.steps if place is None else place
        for group in self._optimiser.param_groups:
            group["lr"] = settings.learning_rate * _pace(place, settings) * group["pace"]
        plain = place >= settings.steps * (1 - settings.plain_end)
        images, boxes, names = draw_batch(self._rng, self._pools, settings, plain=plain)
        logits, predicted = self.network(images)
        loss = detection_loss(logits, predicted, _cells(images), boxes, names)
        self._optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 10.0)
        self._optimiser.step()
        _follow(self.average, self.network, min(settings.average, (1 + self.steps) / (20 + self.steps)))
        self.steps += 1
        return float(loss.detach())

    def state(self) -> dict[str, Any]:
        """Everything that the next step depends on, but the pictures."""
        return {
            "network": self.network.state_dict(),
            "average": self.average.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "rng": self._rng.bit_generator.state,
            "steps": self.steps,
        }

    def load(self, state: dict[str, Any]) -> None:
        self.network.load_state_dict(state["network"])
        self.average.load_state_dict(state["average"])
        self._optimiser.load_state_dict(state["optimiser"])
        self._rng.bit_generator.state = state["rng"]
        self.steps = state["steps"]


def train(
    pools: Sequence[Pool],
    classes: int = 1,
    settings: Settings | None = None,
    progress: Callable[[int, float], None] = lambda step, loss: None,
    start: Network | None = None,
) -> Network:
    """Train a network on pictures drawn from ``pools``; deterministic for a seed on the same machine."""
    trainer = Trainer(pools, classes, settings, start)
    for step in range(trainer.settings.steps):
        progress(step, trainer.step())
    return trainer.average


def _pace(step: float, settings: Settings) -> float:
    """Learning rate's factor: linear warm-up, then a cosine to 2 %."""
    if step < settings.warm_up:
        return (step + 1) / settings.warm_up
    part = (step - settings.warm_up) / max(1, settings.steps - settings.warm_up)
    return 0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * part))


def _groups(network: Network, decay: float) -> list[dict[str, Any]]:
    """Only weights of convolutions decay, not biases and normalisations; what is learnt already moves slowly."""
    groups: dict[tuple[bool, bool], list[Tensor]] = {}
    for name, parameter in network.named_parameters():
        if parameter.requires_grad:
            groups.setdefault((parameter.ndim > 1, name in network.learnt), []).append(parameter)
    return [
        {"params": some, "weight_decay": decay * heavy, "pace": LEARNT_PACE if learnt else 1.0}
        for (heavy, learnt), some in groups.items()
    ]


def _cells(images: Tensor) -> tuple[Tensor, Tensor]:
    """Every cell's centre (N, 2) and stride (N,), level by level."""
    height, width = images.shape[2:]
    centres = [cell_centres(height // s, width // s, s, images.device) for s in STRIDES]
    strides = [torch.full((len(c),), float(s)) for c, s in zip(centres, STRIDES, strict=True)]
    return torch.cat(centres), torch.cat(strides)


def _follow(average: Network, network: Network, keep: float) -> None:
    """Move the running mean of the weights (state_dict's tensors share the network's memory and are detached)."""
    for mean, value in zip(average.state_dict().values(), network.state_dict().values(), strict=True):
        if mean.dtype.is_floating_point:
            mean.lerp_(value, 1 - keep)
        else:
            mean.copy_(value)


def draw_batch(
    rng: Rng, pools: Sequence[Pool], settings: Settings, plain: bool
) -> tuple[Tensor, list[Tensor], list[Tensor]]:
    """Images (B, 3, h, w) in 0..1, and each image's boxes (M, 4) and classes (M,)."""
    weights = np.array([pool.weight for pool in pools])

    def draw() -> Picture:
        return pools[int(rng.choice(len(pools), p=weights / weights.sum()))].draw(rng)

    size = settings.sizes[int(rng.choice(len(settings.sizes), p=settings.size_weights))]
    first = settings.sizes[0]
    count = max(2, round(settings.batch * first[0] * first[1] / (size[0] * size[1])))
    pictures = [
        mosaic(rng, draw, size) if not plain and rng.random() < settings.mosaic else single(rng, draw, size)
        for _ in range(count)
    ]
    images = np.stack([p.image[..., ::-1] for p in pictures]).transpose(0, 3, 1, 2)
    tensor = torch.from_numpy(np.ascontiguousarray(images)).float().div_(255)
    tensor = tensor.contiguous(memory_format=torch.channels_last)
    return tensor, [torch.from_numpy(p.boxes) for p in pictures], [torch.from_numpy(p.classes) for p in pictures]
