"""A small anchor-free detector in plain torch: residual backbone, top-down neck, one head at strides 8, 16 and 32.

Written for this project (Apache-2.0), so that its weights may be shipped; 0.80 M parameters. Boxes are regressed as
distances from the cell's centre to the four sides (FCOS, arXiv:1904.01355).
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

STRIDES = (8, 16, 32)
LARGEST_STRIDE = STRIDES[-1]


class ConvBlock(nn.Sequential):  # type: ignore[misc]  # torch is not typed here
    """Convolution, batch normalisation, ReLU."""

    def __init__(self, channels_in: int, channels_out: int, kernel: int = 3, stride: int = 1) -> None:
        super().__init__(
            nn.Conv2d(channels_in, channels_out, kernel, stride, kernel // 2, bias=False),
            nn.BatchNorm2d(channels_out, eps=1e-3, momentum=0.03),
            nn.ReLU(inplace=True),
        )


class Residual(nn.Module):  # type: ignore[misc]  # torch is not typed here
    """x + conv3x3(conv1x1(x)), through half the channels."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.body = nn.Sequential(ConvBlock(channels, channels // 2, 1), ConvBlock(channels // 2, channels))

    def forward(self, x: Tensor) -> Tensor:
        return x + self.body(x)


class Context(nn.Module):  # type: ignore[misc]  # torch is not typed here
    """Three chained 5x5 maxima beside the input: each cell sees the whole view, as a target that fills it needs."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.squeeze = ConvBlock(channels, channels // 2, 1)
        self.pool = nn.MaxPool2d(5, 1, 2)
        self.merge = ConvBlock(channels * 2, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        levels = [self.squeeze(x)]
        for _ in range(3):
            levels.append(self.pool(levels[-1]))
        return self.merge(torch.cat(levels, 1))


class Head(nn.Module):  # type: ignore[misc]  # torch is not typed here
    """Scores' logits (B, classes, h, w) and side distances in strides (B, 4, h, w) of one level."""

    def __init__(self, channels: int, classes: int) -> None:
        super().__init__()
        self.shared = ConvBlock(channels, channels)
        self.score = nn.Sequential(ConvBlock(channels, channels), nn.Conv2d(channels, classes, 1))
        self.sides = nn.Sequential(ConvBlock(channels, channels), nn.Conv2d(channels, 4, 1))
        nn.init.constant_(self.score[-1].bias, math.log(0.01 / 0.99))
        nn.init.constant_(self.sides[-1].bias, math.log(2.0))

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        x = self.shared(x)
        return self.score(x), self.sides(x).clamp(max=5.0).exp()


class Plain(nn.Module):  # type: ignore[misc]  # torch is not typed here
    """Backbone for training from scratch: image (B, 3, H, W) RGB in 0..1 -> features of strides 8, 16, 32."""

    channels = (64, 96, 128)
    learnt: tuple[str, ...] = ()

    def __init__(self) -> None:
        super().__init__()
        self.stage4 = nn.Sequential(ConvBlock(3, 16, stride=2), ConvBlock(16, 32, stride=2), Residual(32))
        self.stage8 = nn.Sequential(ConvBlock(32, 64, stride=2), Residual(64), Residual(64))
        self.stage16 = nn.Sequential(ConvBlock(64, 96, stride=2), Residual(96), Residual(96))
        self.stage32 = nn.Sequential(ConvBlock(96, 128, stride=2), Residual(128), Residual(128), Context(128))

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        f8 = self.stage8(self.stage4(image))
        f16 = self.stage16(f8)
        return f8, f16, self.stage32(f16)


class Network(nn.Module):  # type: ignore[misc]  # torch is not typed here
    """Image (B, 3, H, W) RGB in 0..1, H and W multiples of 32 -> logits (B, N, classes), boxes (B, N, 4) x0 y0 x1 y1.

    Pixels here are the network's, with (0, 0) at the outer corner of the first one. ``backbone``: as ``Plain``.
    ``learnt``: names of parameters that have been trained elsewhere and shall move slowly.
    """

    def __init__(self, classes: int = 1, backbone: nn.Module | None = None) -> None:
        super().__init__()
        self.classes = classes
        self.backbone = backbone or Plain()
        self.learnt = frozenset(f"backbone.{name}" for name in self.backbone.learnt)
        self.lateral8, self.lateral16, self.lateral32 = (ConvBlock(c, 48, 1) for c in self.backbone.channels)
        self.smooth8, self.smooth16, self.smooth32 = (ConvBlock(48, 48) for _ in range(3))
        self.heads = nn.ModuleList(Head(48, classes) for _ in STRIDES)

    def levels(self, image: Tensor) -> list[Tensor]:
        """Features of strides 8, 16, 32, each with what the coarser levels know."""
        f8, f16, f32 = self.backbone(image)
        f32 = self.lateral32(f32)
        f16 = self.lateral16(f16) + functional.interpolate(f32, scale_factor=2.0, mode="nearest")
        f16 = self.smooth16(f16)
        f8 = self.lateral8(f8) + functional.interpolate(f16, scale_factor=2.0, mode="nearest")
        return [self.smooth8(f8), f16, self.smooth32(f32)]

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        logits, boxes = [], []
        for feature, head, stride in zip(self.levels(image), self.heads, STRIDES, strict=True):
            score, sides = head(feature)
            centres = cell_centres(feature.shape[2], feature.shape[3], stride, feature.device)
            sides = sides.flatten(2).transpose(1, 2) * stride
            boxes.append(torch.cat([centres - sides[..., :2], centres + sides[..., 2:]], -1))
            logits.append(score.flatten(2).transpose(1, 2))
        return torch.cat(logits, 1), torch.cat(boxes, 1)


def cell_centres(rows: int, columns: int, stride: int, device: torch.device) -> Tensor:
    """(rows * columns, 2) x, y of the cells' centres in pixels, row by row."""
    y = (torch.arange(rows, device=device) + 0.5) * stride
    x = (torch.arange(columns, device=device) + 0.5) * stride
    yy, xx = torch.meshgrid(y, x, indexing="ij")
    return torch.stack([xx.flatten(), yy.flatten()], -1)


class Exported(nn.Module):  # type: ignore[misc]  # torch is not typed here
    """The network with the output that common tools expect: (B, 4 + classes, N), cx cy w h in pixels and scores."""

    def __init__(self, network: Network) -> None:
        super().__init__()
        self.network = network

    def forward(self, image: Tensor) -> Tensor:
        logits, boxes = self.network(image)
        corner, far = boxes[..., :2], boxes[..., 2:]
        return torch.cat([(corner + far) / 2, far - corner, logits.sigmoid()], -1).transpose(1, 2)
